"""Bad input and what is said of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec

import pytest

from pbd import InputError

P = ParamSpec("P")


def refuses(message: str, call: Callable[P, object], /, *arguments: P.args, **named: P.kwargs) -> str:
    """What a call that must end in an InputError says; ``message`` is a pattern of some part of it, if any."""
    with pytest.raises(InputError, match=message or None) as caught:
        call(*arguments, **named)
    return str(caught.value)
