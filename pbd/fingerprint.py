"""A fingerprint of source code: it changes where the code does, and not where only its words do."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType

__all__ = ["source_fingerprint"]


def source_fingerprint(*sources: ModuleType | Path) -> str:
    """Hash of Python code without comments, docstrings and layout: SHA-256, 64 hexadecimal digits.

    Caches of simulated runs are keyed by it, so that a better comment does not discard hours of work. Another version
    of Python gives another hash, and so does a first docstring; assertions do not count.

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
    digest = hashlib.sha256()
    # Compiled code has no comments, and optimised no docstrings. To dump the syntax tree takes three times as long.
    codes = [compile(source, "", "exec", dont_inherit=True, optimize=2)]
    for code in codes:
        names = code.co_name, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
        counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
        digest.update(repr((names, counts)).encode() + code.co_code)
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                codes.append(constant)
            else:
                whole = sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant  # in no order
                digest.update(repr((type(constant).__name__, whole)).encode())
    return digest.digest()
