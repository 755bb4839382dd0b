"""A fingerprint of source code: it changes where the code does, and not where only its words do."""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path
from types import ModuleType

__all__ = ["source_fingerprint"]


def source_fingerprint(*sources: ModuleType | Path) -> str:
    """Hash of Python code without comments, docstrings and layout: SHA-256, 64 hexadecimal digits.

    Caches of simulated runs are keyed by it, so that a better comment does not discard hours of work.

    Args:
        sources: modules, packages (with all of their sub-packages) or paths of files and folders, in any order.

    Raises:
        FileNotFoundError: a source that does not exist; a folder without Python files counts as missing, too.
    """
    files: dict[str, Path] = {}
    for source in sources:
        found = _files(source)
        if not found:
            raise FileNotFoundError(f"no Python source in {source}")
        files |= found
    digest = hashlib.sha256()
    for name, path in sorted(files.items()):
        digest.update(name.encode() + b"\0" + _code_hash(path.read_bytes()))
    return digest.hexdigest()


def _files(source: ModuleType | Path) -> dict[str, Path]:
    """Files of a source by their names: for a module the dotted one, for a path the one below its parent."""
    if isinstance(source, ModuleType):
        if not hasattr(source, "__path__"):
            return {source.__name__: Path(str(source.__file__))}
        root, prefix = Path(next(iter(source.__path__))), source.__name__
    elif source.is_dir():
        root, prefix = source, source.name
    else:
        return {source.name: source}
    return {f"{prefix}/{path.relative_to(root).as_posix()}": path for path in root.rglob("*.py")}


@cache
def _code_hash(source: bytes) -> bytes:
    """Of one file; kept by its content, since a process asks for some files several times."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            if ast.get_docstring(node, clean=False) is not None:
                del node.body[0]
    return hashlib.sha256(ast.dump(tree).encode()).digest()
