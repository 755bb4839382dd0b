"""The one name to import: its names, how cheap it is, and that documents and examples use no other names."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import gube
from tests.data import ROOT
from tests.processes import python

DOCUMENTS = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*.py")])
API = ROOT / "docs" / "api.md"
OBJECTS = [name for name in gube.__all__ if name != "__version__"]


def used_names(text: str) -> set[str]:
    """Names after ``gube.`` in a document, but not the ending of a file ``gube.toml`` in a path."""
    return set(re.findall(r"(?<![\w/.-])gube\.([A-Za-z_]\w*)", text))


def test_importing_it_loads_none_of_the_folders_and_no_library() -> None:
    script = (
        "import sys; before = set(sys.modules); import gube; dir(gube)\n"
        "standard = set(sys.stdlib_module_names) | {'gube'}\n"
        "print(sorted({name.partition('.')[0] for name in set(sys.modules) - before} - standard))"
    )
    assert python(script).strip() == "[]"


def test_each_name_exists_and_is_the_same_each_time() -> None:
    assert [name for name in OBJECTS if not getattr(gube, name) is getattr(gube, name) is not None] == []


def test_a_star_import_gives_the_public_names() -> None:
    space: dict[str, Any] = {}
    exec("from gube import *", space)
    assert set(space) - {"__builtins__"} == set(gube.__all__)


def test_dir_lists_the_public_names() -> None:
    assert dir(gube) == sorted(gube.__all__)


def test_its_version_is_that_of_the_package() -> None:
    assert re.fullmatch(r"\d+\.\d+.*", gube.__version__)


@pytest.mark.parametrize(
    ("wrong", "hint"),
    [
        ("Plyer", "did you mean Player"),
        ("load_charakter", "did you mean load_character"),
        ("solver", "did you mean Solver"),
        ("nothing", "dir(gube) lists the public names"),
    ],
)
def test_a_wrong_name_is_refused_with_those_that_look_like_it(wrong: str, hint: str) -> None:
    with pytest.raises(AttributeError, match=re.escape(f"module 'gube' has no attribute '{wrong}': ") + ".*") as caught:
        getattr(gube, wrong)
    assert hint in str(caught.value)
    assert not hasattr(gube, wrong)


def for_type_checkers(source: str) -> dict[str, str]:
    """What the block under ``TYPE_CHECKING`` imports: public name to ``module:attribute``."""
    blocks = (node for node in ast.parse(source).body if isinstance(node, ast.If))
    (block,) = (node for node in blocks if ast.unparse(node.test) == "TYPE_CHECKING")
    return {
        alias.asname or "without `as`": f"{node.module}:{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def test_type_checkers_see_the_same_names() -> None:
    assert for_type_checkers(Path(gube.__file__).read_text(encoding="utf-8")) == gube.SOURCES


def test_documents_and_examples_use_public_names_alone() -> None:
    used = {path: used_names(path.read_text(encoding="utf-8")) - set(gube.__all__) for path in DOCUMENTS}
    assert {path: names for path, names in used.items() if names} == {}


def test_used_names_are_found() -> None:
    text = "see gube.Player, `gube.nothing(1)` and docs/gube.toml; gube.load_scene.x"
    assert used_names(text) == {"Player", "nothing", "load_scene"}


def test_each_public_name_has_its_line_in_the_list() -> None:
    text = API.read_text(encoding="utf-8")
    assert [name for name in OBJECTS if not re.search(rf"^\|[^|]*`{name}[`(]", text, re.MULTILINE)] == []


def undocumented(name: str, value: Any) -> Iterator[str]:
    """Public classes, functions and methods of the project below a name that lack a docstring."""
    if not (inspect.isclass(value) or inspect.isroutine(value)):
        return
    if not written_docstring(value):
        yield name
    for member, held in vars(value).items() if inspect.isclass(value) else ():
        held = getattr(held, "__func__", getattr(held, "fget", getattr(held, "func", held)))
        if not member.startswith("_") and inspect.isfunction(held) and not written_docstring(held):
            yield f"{name}.{member}"


def written_docstring(value: Any) -> str:
    """The docstring, without the signature that ``dataclass`` and ``NamedTuple`` put where there is none."""
    text = value.__doc__ or ""
    return "" if text.startswith(f"{value.__name__}(") else text


def test_each_public_name_and_its_methods_have_docstrings() -> None:
    assert [one for name in OBJECTS for one in undocumented(name, getattr(gube, name))] == []


def test_missing_docstrings_are_found() -> None:
    class Bare:
        def method(self) -> None: ...

        @property
        def part(self) -> None: ...

        @classmethod
        def made(cls) -> None: ...

        def _private(self) -> None: ...

    assert list(undocumented("Bare", Bare)) == ["Bare", "Bare.method", "Bare.part", "Bare.made"]


def test_the_module_is_the_command() -> None:
    result = subprocess.run([sys.executable, "-m", "gube", "--version"], cwd=ROOT, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (0, f"gube {gube.__version__}\n"), result.stderr
