"""Programs in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.data import ROOT


def python(script: str, *arguments: str, **settings: str | None) -> str:
    """What a script prints, run with variables of the environment set or, with None, taken away."""
    environment = {name: value for name, value in (os.environ | settings).items() if value is not None}
    command = [sys.executable, "-c", script, *arguments]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return result.stdout
