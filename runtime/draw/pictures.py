"""Pictures of garments and bodies, drawn off-screen: no display is needed.

pyvista (VTK) draws; it and Pillow are imported where they are used, so that playing a database loads neither.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pbd.errors import InputError
from pbd.storage import replacing
from runtime.draw.picture_content import Camera, Drawn
from runtime.draw.studio import studio

__all__ = [
    "encode_film",
    "encode_image",
    "render",
    "save_png",
    "strip",
]

_PAPER, _INK = (255, 255, 255), (30, 30, 34)


def render(
    meshes: Sequence[Drawn], camera: Camera, size: tuple[int, int] = (900, 900), *, floor: float | None = 0.0
) -> np.ndarray:
    """Draw meshes in a neutral studio: a key light that rakes from the side, soft shadow, ambient occlusion.

    The window, and the meshes whose faces and pattern stay the same, are kept from one picture to the next. The same
    meshes give the same pixels on the same machine; earlier pictures make no difference. Several threads must not call
    this at the same time.

    Args:
        meshes: the meshes of the picture.
        camera: the camera that sees them.
        size: width and height of the picture [pixel].
        floor: height of the floor on which shadows fall [m]; None draws no shadow.

    Returns:
        red, green, blue, uint8, shape (height, width, 3).

    Raises:
        InputError: a vertex is not finite, or a pattern is not that of the faces.
    """
    for index, mesh in enumerate(meshes):
        if not np.isfinite(mesh.vertices).all():
            raise InputError("a vertex of a picture is not finite", key=f"meshes[{index}].vertices")
        wanted = (len(mesh.faces), 3, 2)
        if mesh.pattern is not None and not (mesh.pattern.shape == wanted and np.isfinite(mesh.pattern).all()):
            key, received = f"meshes[{index}].pattern", mesh.pattern.shape
            raise InputError("not the pattern of these faces", key=key, received=received, expected=f"{wanted}, finite")
    return studio().draw(meshes, camera, size, floor)


def strip(
    columns: Sequence[Sequence[np.ndarray]], column_titles: Sequence[str], row_titles: Sequence[str]
) -> np.ndarray:
    """Set pictures side by side, a column for each kind and a row for each moment, with titles.

    Args:
        columns: ``columns[c][r]`` is an image uint8 (h, w, 3); all have one size.
        column_titles: one line above each column.
        row_titles: one line at the left of each row, turned upright; empty ones take no room.

    Returns:
        uint8, shape (height, width, 3).

    Raises:
        InputError: titles and pictures do not match in number, or pictures do not match in size.
    """
    from PIL import Image, ImageDraw, ImageFont

    shapes = {np.shape(image) for column in columns for image in column}
    counts = (len(columns), *(len(column) for column in columns))
    if counts != (len(column_titles), *([len(row_titles)] * len(columns))) or len(shapes) != 1:
        raise InputError(
            "pictures and titles do not form a grid",
            received=f"{counts[0]} columns of {counts[1:]} pictures in sizes {sorted(shapes)}",
            expected=f"{len(column_titles)} columns of {len(row_titles)} pictures of one size",
        )
    height, width, _ = shapes.pop()
    text_size = max(14, height // 24)
    font = ImageFont.load_default(text_size)
    line = int(1.7 * text_size)
    gap = max(2, height // 150)
    left = line if any(row_titles) else 0
    sheet = Image.new(
        "RGB", (left + len(columns) * (width + gap) - gap, line + len(row_titles) * (height + gap) - gap), _PAPER
    )
    draw = ImageDraw.Draw(sheet)
    for c, (column, title) in enumerate(zip(columns, column_titles, strict=True)):
        x = left + c * (width + gap)
        draw.text((x + width / 2, line / 2), title, fill=_INK, font=_fitting(font, title, width), anchor="mm")
        for r, image in enumerate(column):
            sheet.paste(Image.fromarray(np.ascontiguousarray(image)), (x, line + r * (height + gap)))
    for r, title in enumerate(row_titles if left else ()):
        label = Image.new("RGB", (height, line), _PAPER)
        ImageDraw.Draw(label).text(
            (height / 2, line / 2), title, fill=_INK, font=_fitting(font, title, height), anchor="mm"
        )
        sheet.paste(label.transpose(Image.Transpose.ROTATE_90), (0, line + r * (height + gap)))
    return np.asarray(sheet)


def encode_image(image: np.ndarray, kind: str = "png") -> bytes:
    """A picture as the bytes of a PNG or JPEG file.

    Args:
        image: uint8, shape (h, w, 3).
        kind: ``"png"`` (exact) or ``"jpeg"`` (a tenth of the size).

    Raises:
        InputError: the array is no such picture.
    """
    from PIL import Image

    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise InputError("not a picture", received=f"{image.dtype} {image.shape}", expected="uint8 of shape (h, w, 3)")
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, kind.upper(), optimize=kind == "jpeg", quality=90)
    return buffer.getvalue()


def encode_film(pictures: Sequence[np.ndarray], rate: float) -> bytes:
    """Pictures as the bytes of a WebP file that plays again and again.

    Args:
        pictures: each uint8, shape (h, w, 3); all have one size.
        rate: pictures a second [Hz].
    """
    from PIL import Image

    buffer, (first, *others) = io.BytesIO(), [Image.fromarray(np.ascontiguousarray(one)) for one in pictures]
    settings = {"duration": round(1000.0 / rate), "loop": 0, "quality": 80, "method": 4}
    first.save(buffer, "WEBP", save_all=True, append_images=others, **settings)
    return buffer.getvalue()


def save_png(path: str | os.PathLike[str], image: np.ndarray) -> None:
    """Write a picture uint8 (h, w, 3) as PNG; the file is never half-written.

    Raises:
        InputError: the array is no picture.
    """
    with replacing(Path(path)) as beside:
        beside.write_bytes(encode_image(image))


def _fitting(font: Any, text: str, room: float) -> Any:
    """The font, made smaller until the text fits into the room [pixel]."""
    length = font.getlength(text)
    return font if length <= 0.96 * room else font.font_variant(size=max(8.0, font.size * 0.96 * room / length))
