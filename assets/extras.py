"""Libraries that only some work needs: they come with an extra of the package, as in ``pip install 'gube[usd]'``."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from pbd.errors import InputError

__all__ = ["EXTRAS", "missing_library", "require_extra"]

EXTRAS = {
    "report": ("jinja2", "matplotlib", "pyvista", "trimesh"),
    "sew": ("ezdxf", "svgpathtools"),
    "usd": ("pxr",),
    "view": ("viser",),
}
"""Modules of each extra."""


def missing_library(module: str, file: Any = None) -> InputError | None:
    """What is said of a module that is not installed, and installs it; None of one that belongs to no extra.

    Args:
        module: dotted name.
        file: for which it is needed, if any.
    """
    name = module.partition(".")[0]
    extra = next((extra for extra, modules in EXTRAS.items() if name in modules), None)
    if extra is None:
        return None
    return InputError(f"{name} is not installed", file=file, expected=f"`pip install 'gube[{extra}]'`")


def require_extra(extra: str, file: Any = None) -> None:
    """Refuse, before it begins, work that needs what is not installed.

    Args:
        extra: a key of :data:`EXTRAS`.
        file: for which it is needed, if any.

    Raises:
        InputError: a module of the extra is missing.
    """
    for module in EXTRAS[extra]:
        if find_spec(module) is None and (error := missing_library(module, file)) is not None:
            raise error
