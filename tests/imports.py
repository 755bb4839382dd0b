"""What a module imports."""

from __future__ import annotations

import ast
from collections.abc import Iterator

__all__ = ["imports"]


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
