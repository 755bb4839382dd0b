"""The fingerprint of source code follows the code and nothing else."""

from pathlib import Path

import pytest

from pbd import storage
from pbd.fingerprint import source_fingerprint

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
        ('"""A module."""\n', ""),
        ("z = 2 * y", "z = (2*y)"),
    ],
    ids=["comment", "docstring", "no docstring", "layout"],
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
        ("    y = x + LIMIT\n", '    y = x + LIMIT\n    "not a docstring"\n'),
    ],
    ids=["number", "type of a number", "moved line", "string in the middle"],
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


def test_missing_sources_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        source_fingerprint(tmp_path / "nothing.py")
    with pytest.raises(FileNotFoundError):
        source_fingerprint(tmp_path)
