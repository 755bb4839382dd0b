"""What a module imports, and which modules import one another in a circle."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator, Mapping

__all__ = ["circles", "imports", "modules_imported"]


def imports(tree: ast.AST, inside_function: bool = False) -> Iterator[tuple[str, bool]]:
    """Top-level names that a module imports, each with whether a function holds the import."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name.partition(".")[0], inside_function) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield ("." * node.level or (node.module or "").partition(".")[0], inside_function)
        else:
            deeper = inside_function or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
            yield from imports(node, deeper)


def modules_imported(tree: ast.AST, modules: Collection[str]) -> set[str]:
    """Which of ``modules`` (dotted names) are imported, inside functions and for types as well."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in modules else node.module for name in inside}
    return found & set(modules)


def circles(graph: Mapping[str, Collection[str]]) -> list[tuple[str, ...]]:
    """Groups of nodes of which each leads to each other one, sorted."""
    reached = {}
    for start in graph:
        seen, left = set(), [start]
        while left:
            new = set(graph[left.pop()]) - seen
            seen |= new
            left += new
        reached[start] = seen
    return sorted({tuple(sorted(b for b in reached[a] if a in reached[b])) for a in graph if a in reached[a]})
