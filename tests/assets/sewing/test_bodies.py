"""All drafts on bodies of several makers, as they stand, and moved by 1 m and turned by 30 degrees.

`python -m pytest -m proof -s tests/assets/sewing/test_bodies.py -k "heavy and elsewhere"` sews five garments and prints
a line for each: seconds, and whole or the reason.
"""

from __future__ import annotations

import sys
import time

import pytest

from assets.anthropometry import measure
from assets.patterns.drafts import DRAFTS, draft
from assets.sewing.body import closed_body
from assets.sewing.sewing import SewingError, sew
from pbd.errors import InputError
from tests.assets.real_bodies import BODIES, SHELLS, raw
from tests.assets.shell_figure import moved

PLACES = {"as it stands": ((0.0, 0.0, 0.0), 0.0), "elsewhere": ((1.0, 0.0, 0.0), 30.0)}
LEAST_WHOLE = {True: 4, False: 5}  # of five garments, on bodies of many shells and on closed ones
MOST_SECONDS = 180.0


@pytest.mark.proof
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("name", BODIES)
def test_drafts_are_sewn_on_any_body_anywhere(name: str, place: str) -> None:
    body = moved(raw(BODIES[name]), *PLACES[place])
    body, whole = closed_body(name, body.vertices, body.faces), 0
    for title in DRAFTS:
        began, reason = time.monotonic(), ""
        try:
            sew(draft(title, measure(body)), body)
        except (SewingError, InputError) as error:
            reason = str(error)
            assert "may mend it" in reason or "expected" in reason  # says the remedy
        seconds = time.monotonic() - began
        whole += not reason and seconds <= MOST_SECONDS
        sys.stdout.write(f"{name} {place}: {title} {seconds:5.1f} s {reason or 'whole'}\n")
        sys.stdout.flush()
    assert whole >= LEAST_WHOLE[name in SHELLS]
