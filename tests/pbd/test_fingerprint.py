"""The fingerprint of source code follows the code and nothing else."""

from pathlib import Path

import pytest

from pbd import storage
from pbd.fingerprint import source_fingerprint
from tests.processes import python

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
    ("old", "new", "same"),
    [
        pytest.param("# metres", "# meters", True, id="comment"),
        pytest.param('"""Twice as long."""', '"""Twice as long,\n\n    and more.\n    """', True, id="docstring"),
        pytest.param("z = 2 * y", "z = (2*y)", True, id="layout"),
        pytest.param("2 * y", "3 * y", False, id="number"),
        pytest.param("LIMIT = 3", "LIMIT = 3.0", False, id="type of a number"),
        pytest.param(
            "    y = x + LIMIT\n    z = 2 * y\n", "    z = 2 * y\n    y = x + LIMIT\n", False, id="moved line"
        ),
        pytest.param("    y = x + LIMIT\n", "    y = x + LIMIT\n    y in {'a', 'b'}\n", False, id="set"),
        pytest.param("grow(x)", "grow(x, /)", False, id="kind of argument"),
    ],
)
@pytest.mark.parametrize("name", ["a.py", "contact/b.py"])
def test_code_changes_it_and_words_and_layout_do_not(package: Path, name: str, old: str, new: str, same: bool) -> None:
    before, path = source_fingerprint(package), package / name
    assert old in CODE
    path.write_text(CODE.replace(old, new))
    assert (source_fingerprint(package) == before) == same


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
    assert len({python(line, PYTHONHASHSEED=seed) for seed in "123"}) == 1


def test_missing_sources_are_refused(tmp_path: Path) -> None:
    for missing in (tmp_path / "nothing.py", tmp_path):
        with pytest.raises(FileNotFoundError):
            source_fingerprint(missing)
