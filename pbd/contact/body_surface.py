"""The view of a body's surface in kernels, see :mod:`pbd.xpbd.views`."""

from dataclasses import dataclass
from typing import Any

from pbd.taichi_internals import in_kernel

__all__ = ["BodySurface"]


@in_kernel
@dataclass(eq=False)
class BodySurface:
    """An animated triangle mesh in one frame, see :class:`pbd.Body`.

    Attributes:
        body_start, body_end: vertices at the start and end of the frame [m], vec3; one array twice if it stands still.
        ring_start, ring: neighbours of each vertex.
        fan_start, fan: the other two corners of each face around each vertex.
        body_normals: unit vertex normals, vec3.
    """

    body_start: Any = None
    body_end: Any = None
    ring_start: Any = None
    ring: Any = None
    fan_start: Any = None
    fan: Any = None
    body_normals: Any = None
    _data_oriented = True
