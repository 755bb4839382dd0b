"""Twenty garments of each draft and body, and of two patterns from files: as many as are asked for come out whole.

`python -m pytest -m proof -s tests/assets/sewing/test_variants.py -k "tshirt and woman"` prints the table of one of
them: parameters, seconds, and whole or the reason.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from assets.anthropometry import measure
from assets.loading import load_standing_body
from assets.patterns.drafts import DRAFTS, draft
from assets.patterns.load import load_pattern
from assets.patterns.pattern import Panel, Pattern
from assets.sewing.body import StandingBody
from assets.sewing.sewing import COARSE_EDGE, SewingError, sew
from pbd.errors import InputError
from tests.data import data_path

BODIES = {"mannequin": "builtin:mannequin", "woman": "characters/mh_female_bandai_NC.glb"}
FILES = ("shirt_mean", "dress_pencil")
COUNT, LEAST_WHOLE = 20, 19
LENGTHENED = 0.15  # of a panel from a file, above its hem [m]

Variant = tuple[dict[str, float], StandingBody, Callable[[], Pattern]]


@cache
def standing(name: str) -> StandingBody:
    return load_standing_body(name if name.startswith("builtin") else data_path(name))


def scaled(body: StandingBody, around: float, upwards: float) -> StandingBody:
    return replace(body, vertices=body.vertices * [around, upwards, around])


def drafted(name: str, body: str, seed: int) -> Variant:
    """A draft as a pattern maker could ask for it, for a body of another size."""
    rng = np.random.default_rng([seed, DRAFTS.index(name)])
    size = {"around": rng.uniform(0.92, 1.12), "upwards": rng.uniform(0.94, 1.06)}
    figure = scaled(standing(BODIES[body]), **size)
    m = measure(figure)
    neck = float(m.landmarks.neck_side[1])
    hip, crotch, knee = (float(place[1]) for place in (m.landmarks.hip, m.landmarks.crotch, m.landmarks.knee))
    waist, floor = float(m.landmarks.waist[1]), m.landmarks.floor
    if name in ("tshirt", "shirt"):  # from the middle of waist and hip to a hand below the crotch
        parameters = {
            "ease": rng.uniform(0.04, 0.20),
            "length": neck - rng.uniform(crotch - 0.08, 0.5 * (waist + hip)),
            "sleeve_length": m.arm_length * (rng.uniform(0.3, 0.6) if name == "tshirt" else rng.uniform(0.92, 1.04)),
            "neck_depth": rng.uniform(0.06, 0.12),
        }
    elif name == "trousers":  # from the knee to 3 cm above the floor
        length = waist - rng.uniform(floor + 0.03, knee)
        parameters = {
            "ease": rng.uniform(0.04, 0.16),
            "length": length,
            "leg_width": m.knee + rng.uniform(0.06, 0.18),
            "rise_ease": rng.uniform(0.005, 0.03),
        }
    else:  # from a hand below the hip to the shin
        length = waist - rng.uniform(0.5 * (knee + floor), hip - 0.2)
        parameters = {"ease": rng.uniform(0.04, 0.12), "length": length, "flare": rng.uniform(0.10, 0.60)}
        if name == "circle_skirt":
            parameters |= {"ease": rng.uniform(0.0, 0.25) * (m.hip - m.waist), "circle": rng.uniform(0.4, 1.0)}
            del parameters["flare"]
    return size | parameters, figure, lambda: draft(name, m, **parameters)


def graded(name: str, seed: int) -> Variant:
    """A pattern from a file, made larger, with longer or shorter hems, for its body in another size."""
    rng = np.random.default_rng([seed, FILES.index(name)])
    size, wider, longer = rng.uniform(0.92, 1.10), rng.uniform(1.0, 1.12), rng.uniform(-0.06, 0.12)
    pattern = load_pattern(data_path(f"patterns/{name}_specification.json"))
    hems = ("torso",) if name == "shirt_mean" else ("skirt",)

    def made() -> Pattern:
        panels = [
            _graded(panel, size, size * wider, longer if any(k in panel.name for k in hems) else 0.0)
            for panel in pattern.panels
        ]
        return replace(pattern, panels=tuple(panels))

    figure = scaled(standing("patterns/mean_all.obj"), size, size)
    return {"size": size, "wider": wider, "longer": longer}, figure, made


def _graded(panel: Panel, size: float, factor: float, longer: float) -> Panel:
    """A panel times a factor around the middle of its top, its part above the hem lengthened, for a body of a size."""
    outline = panel.outline
    low, top = float(outline[:, 1].min()), outline[:, 1].max()
    centre = np.array([0.0, top])

    def moved(points: np.ndarray) -> np.ndarray:
        down = np.clip((low + LENGTHENED - points[:, 1]) / LENGTHENED, 0.0, 1.0)
        return (points - [0.0, longer] * down[:, None] - centre) * factor + centre * size

    placement = replace(panel.placement, translation=size * panel.placement.translation)
    return replace(panel, edges=tuple(moved(edge) for edge in panel.edges), placement=placement)


def outcome(variant: Variant) -> tuple[str, float]:
    """Empty for a garment that came out whole, else the reason; and seconds."""
    _, figure, made = variant
    began, reason = time.monotonic(), ""
    try:
        sew(made(), figure, "cotton", edge_length=COARSE_EDGE)
    except (SewingError, InputError) as error:
        reason = str(error)
    return reason, time.monotonic() - began


def check(title: str, variants: list[Variant]) -> None:
    whole, times = 0, []
    sys.stdout.write(f"\n{title}\n")
    for number, variant in enumerate(variants):
        reason, seconds = outcome(variant)
        whole += not reason
        times.append(seconds)
        words = " ".join(f"{key} {value:.3f}" for key, value in variant[0].items())
        sys.stdout.write(f"{number:2d} {words} {seconds:5.1f} s {reason or 'whole'}\n")
        sys.stdout.flush()
    seconds = f"{np.median(times):.1f} s, at most {max(times):.1f} s"
    sys.stdout.write(f"{title}: {whole} of {len(variants)} whole; {seconds}\n")
    assert whole >= LEAST_WHOLE


@pytest.mark.proof
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", DRAFTS)
def test_variants_of_drafts_come_out_whole(name: str, body: str) -> None:
    check(f"{name} on the {body}", [drafted(name, body, seed) for seed in range(COUNT)])


@pytest.mark.proof
@pytest.mark.parametrize("name", FILES)
def test_variants_of_files_come_out_whole(name: str) -> None:
    check(name, [graded(name, seed) for seed in range(COUNT)])
