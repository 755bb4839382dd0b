"""One Taichi for the process; conflicting wishes are refused."""

import os
import subprocess
import sys

import pytest

from pbd import InputError, ensure_initialized
from tests.data import ROOT


def test_the_same_wish_again_does_nothing() -> None:
    ensure_initialized()
    ensure_initialized("cpu")


@pytest.mark.parametrize("wish", [{"arch": "cuda"}, {"threads": 10_000}])
def test_another_wish_is_refused(wish: dict) -> None:
    with pytest.raises(InputError, match="already runs"):
        ensure_initialized(**wish)


@pytest.mark.parametrize("wish", [{"arch": "gpu"}, {"threads": 0}, {"threads": -1}])
def test_a_bad_wish_is_refused(wish: dict) -> None:
    with pytest.raises(InputError, match=next(iter(wish))):
        ensure_initialized(**wish)


@pytest.mark.parametrize("value", ["two", "-1", "1.5"])
def test_a_bad_thread_count_in_the_environment_is_refused(value: str) -> None:
    script = (
        "from pbd import InputError, ensure_initialized\ntry: ensure_initialized()\nexcept InputError as e: print(e)"
    )
    result = subprocess.run(
        [sys.executable, "-c", script],
        cwd=ROOT,
        env={**os.environ, "GUBE_THREADS": value},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "GUBE_THREADS" in result.stdout and value in result.stdout
