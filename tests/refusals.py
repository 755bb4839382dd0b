"""Bad input and what is said of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec

import pytest

from pbd import InputError

P = ParamSpec("P")


def refuses(message: str, call: Callable[P, object], /, *arguments: P.args, **named: P.kwargs) -> None:
    """Fail unless a call ends in an InputError; ``message`` is a pattern of some part of its text."""
    with pytest.raises(InputError, match=message):
        call(*arguments, **named)
