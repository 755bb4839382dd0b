"""Every example runs from a folder of its own, with its assertions, and imports nothing but `gube` and NumPy."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.data import ROOT
from tests.imports import imports

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
ALLOWED = {"gube", "numpy"}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path: Path, tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "GUBE_THREADS": "1"}
    command = [sys.executable, str(path)]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_says_how_long_it_takes_and_ends_in_assertions(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert " takes " in (ast.get_docstring(tree) or "")
    assert {name for name, _ in imports(tree)} <= ALLOWED
    assert any(isinstance(node, ast.Assert) for node in ast.walk(tree))


def test_there_are_the_four_examples() -> None:
    names = {"falling_cloth", "garment_on_character", "game_loop", "database_made_and_played"}
    assert names <= {path.stem for path in EXAMPLES}
