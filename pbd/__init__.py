"""Cloth, fabrics, colliders and time: the solvers and everything they stand on."""

from pbd.engine import ensure_initialized
from pbd.errors import InputError

__all__ = ["InputError", "ensure_initialized"]
