"""Several garments worn over one another, as one model: they share time steps, contact and momentum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pbd.contact.strain_limits import MAX_STRETCH
from pbd.errors import InputError
from pbd.limits import Limits
from pbd.mesh import ClothMesh, Hinges
from pbd.model import BLOCK, Model, blocks_of

__all__ = ["layered"]


def layered(models: Sequence[Model]) -> Model:
    """One model of several garments, from the innermost outwards; its vertices, and those held, come in that order.

    Contact knows one fabric: the greatest thickness of all, which does not give way, the least friction, and the drag
    of the innermost garment. Over 60 lines: most of them list the fields of a model.

    Args:
        models: from the innermost outwards, at least one.

    Raises:
        InputError: no garment, or garments with different factors on compression.
    """
    if not models:
        raise InputError("no garment", key="models", received=0, expected="at least one")
    scales = sorted({model.options.compression_compliance_scale for model in models})
    if len(scales) > 1:
        key, expected = "compression_compliance_scale", "one value for all"
        raise InputError("layers that differ", key=key, received=scales, expected=expected)
    offsets = np.cumsum([0, *(model.vertex_count for model in models)])

    def shifted(name: str, of: Sequence = models) -> list[np.ndarray]:
        return [getattr(part, name) + offset for part, offset in zip(of, offsets, strict=False)]

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(model, name) for model in models])

    def by_color(colors: str) -> tuple[np.ndarray, np.ndarray]:
        counts = [np.diff(getattr(model, colors)) for model in models]
        color = np.concatenate([np.repeat(np.arange(len(count)), count) for count in counts])
        ends = np.concatenate([[0], np.cumsum(np.bincount(color, minlength=1))]).astype(np.int32)
        return np.argsort(color, kind="stable"), ends

    mesh = _joined_mesh([model.mesh for model in models], offsets)
    # Vertices are the first colour of the samples of each garment, and so they are of all.
    sample_order, sample_colors = by_color("sample_colors")
    triangle_order, triangle_colors = by_color("triangle_colors")
    hinge_order, hinge_colors = by_color("hinge_colors")
    blocks, block_colors = blocks_of(triangle_colors)
    values = np.concatenate([model.triangle_data[:, : len(model.triangles)] for model in models], axis=1)[
        :, triangle_order
    ]
    counts = [model.vertex_count for model in models]
    fabrics = [model.fabric for model in models]
    pressed = [np.resize(model.pressure, model.vertex_count) for model in models]  # nothing becomes zeros
    limits = [model.limits for model in models]
    thickness, friction = max(f.thickness for f in fabrics), min(f.friction for f in fabrics)
    return replace(
        models[0],
        mesh=mesh,
        fabric=replace(fabrics[0], thickness=thickness, friction=friction, compression=0.0),
        mass=joined("mass"),
        inverse_mass=joined("inverse_mass"),
        held=np.concatenate(shifted("held")).astype(np.int32),
        triangles=np.concatenate(shifted("triangles"))[triangle_order].astype(np.int32),
        triangle_blocks=blocks,
        block_colors=block_colors,
        triangle_data=np.ascontiguousarray(np.pad(values, ((0, 0), (0, BLOCK)))),
        triangle_colors=triangle_colors,
        hinges=np.concatenate(shifted("hinges"))[hinge_order].astype(np.int32),
        hinge_data=joined("hinge_data")[hinge_order],
        hinge_colors=hinge_colors,
        stitches=np.concatenate(shifted("stitches")).astype(np.int32),
        stitch_weights=joined("stitch_weights"),
        tethers=np.concatenate(shifted("tethers")).astype(np.int32),
        tether_lengths=joined("tether_lengths"),
        samples=np.concatenate(shifted("samples"))[sample_order].astype(np.int32),
        sample_colors=sample_colors,
        pressure=np.concatenate(pressed) if any(len(model.pressure) for model in models) else models[0].pressure,
        limits=Limits(
            np.concatenate(shifted("vertices", limits)),
            *(
                np.concatenate([getattr(part, name) for part in limits])
                for name in ("maximum_distance", "backstop", "stiffness")
            ),
        ),
        layer=np.repeat(np.arange(len(models), dtype=np.int32), counts),
    )


def _joined_mesh(meshes: Sequence[ClothMesh], offsets: np.ndarray) -> ClothMesh:
    """One mesh of several; ``offsets``: number of each one's first vertex."""
    placed = list(zip(meshes, offsets, strict=False))
    seam_hinges = None
    if any(mesh.seam_hinges is not None for mesh in meshes):
        parts = [
            mesh.seam_hinges._replace(vertices=mesh.seam_hinges.vertices + offset)
            for mesh, offset in placed
            if mesh.seam_hinges is not None
        ]
        seam_hinges = Hinges(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    max_stretch = None
    if any(mesh.max_stretch is not None for mesh in meshes):
        max_stretch = np.concatenate(
            [np.full(len(m.faces), MAX_STRETCH) if m.max_stretch is None else m.max_stretch for m in meshes]
        )
    return ClothMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in placed]).astype(np.int32),
        np.concatenate([mesh.flat for mesh in meshes]),
        np.concatenate([mesh.stitches + offset for mesh, offset in placed]).astype(np.int32),
        np.concatenate([mesh.stitch_weights for mesh in meshes]),
        seam_hinges,
        max_stretch=max_stretch,
    )
