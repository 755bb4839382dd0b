"""Frames of a motion drawn as strips: several garments side by side."""

from __future__ import annotations

import re
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import render, save_png, strip

__all__ = ["draw_strips", "draw_strips_apart"]

PICTURE = (560, 640)  # [pixel]


def draw_strips(
    folder: Path,
    name: str,
    columns: Mapping[str, np.ndarray],
    faces: np.ndarray,
    pattern: np.ndarray | None,
    layer: np.ndarray | None,
    bodies: np.ndarray,
    body_faces: np.ndarray,
    numbers: np.ndarray,
    dt: float,
) -> list[Path]:
    """Draw frames, each as a strip of pictures side by side; frame 10 goes into ``folder / NAME_0010.png``.

    Args:
        folder: where the files are written.
        name: name of the motion.
        columns: the pictures side by side: vertices of a garment [m], shape (f, N, 3), by title.
        faces: faces of the garments, int, shape (m, 3).
        pattern: place of each corner of each face in the flat pattern [m], shape (m, 3, 2), or None.
        layer: of an outfit the number of the garment of each vertex, int, shape (N,), or None.
        bodies: vertices of the body [m], shape (f, b, 3).
        body_faces: faces of the body, int, shape (k, 3).
        numbers: numbers of the frames, int, shape (f,); without frames no file is written.
        dt: time from one number to the next [s].

    Returns:
        paths of the files.

    Raises:
        InputError: a vertex is not finite.
    """
    if not len(numbers):
        return []
    cameras = frame_camera(next(iter(columns.values())), aspect=PICTURE[0] / PICTURE[1], margin=1.15)
    files = []
    for index, number in enumerate(numbers):
        body = Drawn.body(bodies[index], body_faces)
        images = [
            [render([body, *Drawn.garments(vertices[index], faces, pattern, layer)], cameras[index], PICTURE)]
            for vertices in columns.values()
        ]
        files.append(folder / f"{re.sub(r'[^-.0-9A-Za-z]+', '_', name)}_{number:04d}.png")
        save_png(files[-1], strip(images, list(columns), [f"{number * dt:.2f} s"]))
    return files


def draw_strips_apart(*arguments: Any) -> list[Path]:
    """:func:`draw_strips` in a process of its own: pyvista loads many modules that playing must not need."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(draw_strips, *arguments).result()
