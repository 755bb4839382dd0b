"""Sections ``Args:`` and ``Attributes:`` of docstrings, held against the names that the code has."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Iterator

__all__ = ["untrue_sections"]

Function = ast.FunctionDef | ast.AsyncFunctionDef


def parameters(node: Function) -> list[str]:
    """Names of all parameters but the object itself."""
    held = node.args
    some = [*held.posonlyargs, *held.args, held.vararg, *held.kwonlyargs, held.kwarg]
    return [one.arg for one in some if one and one.arg not in ("self", "cls")]


def fields(node: ast.ClassDef) -> dict[str, str]:
    """Annotated names in the body of a class, each with its declaration; those of the class itself are none."""
    some = [one for one in node.body if isinstance(one, ast.AnnAssign) and "ClassVar" not in ast.unparse(one)]
    return {ast.unparse(one.target): ast.unparse(one) for one in some}


def attributes(node: ast.ClassDef) -> set[str]:
    """Names in the body of a class, and what its methods store in ``self``."""
    assigned = [target for one in node.body if isinstance(one, ast.Assign) for target in one.targets]
    names = {name.id for target in assigned for name in ast.walk(target) if isinstance(name, ast.Name)}
    functions = {one.name for one in node.body if isinstance(one, Function)}
    stored = [one for one in ast.walk(node) if isinstance(one, ast.Attribute) and isinstance(one.ctx, ast.Store)]
    return {*fields(node), *names, *functions, *(one.attr for one in stored if ast.unparse(one.value) == "self")}


def faults(node: Function | ast.ClassDef, title: str, known: Collection[str], wanted: Collection[str]) -> Iterator[str]:
    """Names that a section has beside the known ones, and wanted ones that the docstring does not explain.

    Several names may stand before a colon; a name in ``double quotes`` is explained by the text about it.
    """
    text = ast.get_docstring(node) or ""
    section = re.split(r"\n(?=\S)", f"\n{text}".partition(f"\n{title}:\n")[2])[0]
    entries = re.findall(r"^    (\w[\w, ]*):", section, re.MULTILINE)
    names = [name.strip() for entry in entries for name in entry.split(",")]
    yield from (f"{node.name}: {name} is not there" for name in names if name not in known)
    if names:
        explained = {*names, *re.findall(r"``(\w+)``", text)}
        yield from (f"{node.name}: {name} is not explained" for name in wanted if name not in explained)


def untrue_sections(tree: ast.AST) -> Iterator[str]:
    """Parameters and attributes that docstrings explain and the code lacks, or the other way round.

    A section explains each parameter of a function or constructor, or each public field of a class of data.
    """
    for node in ast.walk(tree):
        if isinstance(node, Function):
            yield from faults(node, "Args", parameters(node), parameters(node))
        elif isinstance(node, ast.ClassDef):
            constructors = [one for one in node.body if isinstance(one, Function) and one.name == "__init__"]
            taken = [name for name, text in fields(node).items() if "init=False" not in text]
            taken = parameters(constructors[0]) if constructors else taken
            yield from faults(node, "Args", taken, taken)
            public = [] if constructors else [name for name in fields(node) if not name.startswith("_")]
            yield from faults(node, "Attributes", attributes(node), public)
