"""The fingerprint of source code follows the code and nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pbd import storage
from pbd.fingerprint import source_fingerprint
from tests.data import ROOT

CODE = '''"""A module."""

LIMIT = 3  # metres


def grow(x):
    """Twice as long."""
    y = x + LIMIT
    z = 2 * y
    return z
'''


@pytest.fixture
def package(tmp_path: Path) -> Path:
    inner = tmp_path / "cloth" / "contact"
    inner.mkdir(parents=True)
    (tmp_path / "cloth" / "a.py").write_text(CODE)
    (inner / "b.py").write_text(CODE)
    return tmp_path / "cloth"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# metres", "# meters"),
        ('"""Twice as long."""', '"""Twice as long,\n\n    and more.\n    """'),
        ("z = 2 * y", "z = (2*y)"),
    ],
    ids=["comment", "docstring", "layout"],
)
@pytest.mark.parametrize("name", ["a.py", "contact/b.py"])
def test_words_and_layout_change_nothing(package: Path, name: str, old: str, new: str) -> None:
    before, path = source_fingerprint(package), package / name
    assert old in CODE
    path.write_text(CODE.replace(old, new))
    assert source_fingerprint(package) == before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2 * y", "3 * y"),
        ("LIMIT = 3", "LIMIT = 3.0"),
        ("    y = x + LIMIT\n    z = 2 * y\n", "    z = 2 * y\n    y = x + LIMIT\n"),
        ("    y = x + LIMIT\n", "    y = x + LIMIT\n    y in {'a', 'b'}\n"),
        ("grow(x)", "grow(x, /)"),
    ],
    ids=["number", "type of a number", "moved line", "set", "kind of argument"],
)
@pytest.mark.parametrize("name", ["a.py", "contact/b.py"])
def test_changed_and_moved_lines_change_it(package: Path, name: str, old: str, new: str) -> None:
    before, path = source_fingerprint(package), package / name
    assert old in CODE
    path.write_text(CODE.replace(old, new))
    assert source_fingerprint(package) != before


def test_a_file_that_moves_into_a_sub_package_stays_part_of_it(package: Path) -> None:
    (package / "a.py").rename(package / "contact" / "a.py")
    moved = source_fingerprint(package)
    (package / "contact" / "a.py").write_text(CODE.replace("2 * y", "3 * y"))
    assert source_fingerprint(package) != moved


def test_order_and_repetition_of_sources_do_not_matter(package: Path) -> None:
    assert source_fingerprint(storage, package) == source_fingerprint(package, storage, package)


def test_it_does_not_depend_on_the_order_of_sets(package: Path) -> None:
    (package / "a.py").write_text("WORDS = [x for x in 'ab' if x in {'a', 'b', 'c', 'd', 'e'}]\n")
    line = f"import pathlib, pbd.fingerprint as f; print(f.source_fingerprint(pathlib.Path({str(package)!r})))"
    found = {
        subprocess.run(
            [sys.executable, "-c", line],
            env=os.environ | {"PYTHONHASHSEED": seed},
            cwd=ROOT,
            capture_output=True,
            check=True,
        ).stdout
        for seed in "123"
    }
    assert len(found) == 1


def test_missing_sources_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        source_fingerprint(tmp_path / "nothing.py")
    with pytest.raises(FileNotFoundError):
        source_fingerprint(tmp_path)
