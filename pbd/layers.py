"""Several garments worn over one another, as one model: they share time steps, contact and momentum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pbd.attachment import closest_points
from pbd.errors import InputError
from pbd.limits import Limits
from pbd.mesh import MAX_STRETCH, ClothMesh, Hinges, hinges_of
from pbd.model import BLOCK, Model, blocks_of

__all__ = ["FASTENING_REACH", "fastened", "layered", "parts_of"]

FASTENING_REACH = 0.1  # a vertex further than this from the garments below it is not fastened to them [m]


def parts_of(mesh: ClothMesh, layer: np.ndarray) -> list[tuple[ClothMesh, np.ndarray]]:
    """The garments of one mesh, from the innermost outwards.

    Args:
        mesh: of all garments.
        layer: number of the garment that each vertex belongs to, int, shape (n,).

    Returns:
        mesh of each garment, and the numbers of its vertices in the mesh of all, ascending, int, shape (k,).
    """
    found = []
    for number in range(int(layer.max()) + 1):
        vertices = np.flatnonzero(layer == number)
        own_number = np.full(len(layer), -1, np.int32)
        own_number[vertices] = np.arange(len(vertices))
        faces, sewn = layer[mesh.faces[:, 0]] == number, layer[mesh.stitches[:, 0]] == number
        by_face = {name: getattr(mesh, name) for name in ("cloth_areas", "layers", "max_stretch")}
        seams, bends = mesh.seam_hinges, mesh.rest_bends
        if seams is not None:
            across = layer[seams.vertices[:, 0]] == number
            seams = Hinges(own_number[seams.vertices[across]], *(values[across] for values in seams[1:]))
        if bends is not None:  # a garment's hinges are in the order that they have among all
            bends = bends[layer[hinges_of(mesh.faces)[:, 0]] == number]
        part = ClothMesh(
            mesh.vertices[vertices],
            own_number[mesh.faces[faces]],
            mesh.flat[faces],
            own_number[mesh.stitches[sewn]],
            mesh.stitch_weights[sewn],
            seams,
            bends,
            **{name: None if values is None else np.asarray(values)[faces] for name, values in by_face.items()},
        )
        found.append((part, vertices))
    return found


def layered(models: Sequence[Model], vertices: Sequence[np.ndarray] | None = None) -> Model:
    """One model of several garments, from the innermost outwards.

    Contact knows one fabric: the greatest thickness of all, which does not give way, the least friction, and the drag
    of the innermost garment. Over 60 lines: most of them list the fields of a model.

    Args:
        models: from the innermost outwards, at least one.
        vertices: numbers of each one's vertices in the model of all, ascending, int, shapes (k,); None numbers one
            garment after the other.

    Raises:
        InputError: no garment, or garments with different factors on compression.
    """
    if not models:
        raise InputError("no garment", key="models", received=0, expected="at least one")
    scales = sorted({model.options.compression_compliance_scale for model in models})
    if len(scales) > 1:
        key, expected = "compression_compliance_scale", "one value for all"
        raise InputError("layers that differ", key=key, received=scales, expected=expected)
    counts = [model.vertex_count for model in models]
    numbers = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1]) if vertices is None else list(vertices)

    def renumbered(name: str, of: Sequence = models) -> np.ndarray:
        parts = [number[getattr(part, name)] for part, number in zip(of, numbers, strict=True)]
        return np.concatenate(parts).astype(np.int32)

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(model, name) for model in models])

    def by_vertex(values: Sequence[np.ndarray]) -> np.ndarray:
        placed = np.zeros((sum(counts), *values[0].shape[1:]), values[0].dtype)
        for number, value in zip(numbers, values, strict=True):
            placed[number] = value
        return placed

    def by_color(colors: str, skip: int = 0) -> tuple[np.ndarray, np.ndarray]:
        sizes = [np.diff(getattr(model, colors))[skip:] for model in models]
        color = np.concatenate([np.repeat(np.arange(len(size)), size) for size in sizes])
        ends = np.concatenate([[0], np.cumsum(np.bincount(color, minlength=1))]).astype(np.int32)
        return np.argsort(color, kind="stable"), ends

    mesh = _joined_mesh([model.mesh for model in models], numbers)
    # Vertices are the first colour of the samples: each one's own number is that of its sample.
    edge_order, edge_colors = by_color("sample_colors", skip=1)
    edges = np.concatenate([n[model.samples[len(n) :]] for model, n in zip(models, numbers, strict=True)])[edge_order]
    alone = np.repeat(np.arange(sum(counts))[:, None], 2, axis=1)
    triangle_order, triangle_colors = by_color("triangle_colors")
    hinge_order, hinge_colors = by_color("hinge_colors")
    # With friction in one of them, every hinge and every triangle has a place in the state.
    hinge_counts = [max(model.plastic_count, 1 + model.hinge_numbers.max(initial=-1)) for model in models]
    before = np.cumsum([0, *hinge_counts])
    hinge_numbers = np.concatenate([model.hinge_numbers + n for model, n in zip(models, before, strict=False)])
    plastic_count = int(before[-1]) if any(model.plastic_count for model in models) else 0
    face_counts = [len(model.triangles) for model in models]
    before = np.cumsum([0, *face_counts])
    triangle_numbers = np.concatenate([m.triangle_numbers + n for m, n in zip(models, before, strict=False)])
    shear_count = sum(face_counts) if any(model.plastic_shear_count for model in models) else 0
    blocks, block_colors = blocks_of(triangle_colors)
    values = np.pad(_triangle_rows(models)[:, triangle_order], ((0, 0), (0, BLOCK)))
    fabrics = [model.fabric for model in models]
    pressed = [np.resize(model.pressure, model.vertex_count) for model in models]  # nothing becomes zeros
    limits = [model.limits for model in models]
    limited = renumbered("vertices", limits)
    ascending = np.argsort(limited)
    thickness, friction = max(f.thickness for f in fabrics), min(f.friction for f in fabrics)
    return replace(
        models[0],
        mesh=mesh,
        fabric=replace(fabrics[0], thickness=thickness, friction=friction, compression=0.0),
        mass=by_vertex([model.mass for model in models]),
        inverse_mass=by_vertex([model.inverse_mass for model in models]),
        held=np.sort(renumbered("held")),
        triangles=renumbered("triangles")[triangle_order],
        triangle_blocks=blocks,
        block_colors=block_colors,
        triangle_data=values,
        triangle_numbers=triangle_numbers[triangle_order].astype(np.int32),
        plastic_shear_count=shear_count,
        triangle_colors=triangle_colors,
        hinges=renumbered("hinges")[hinge_order],
        hinge_data=joined("hinge_data")[hinge_order],
        hinge_numbers=hinge_numbers[hinge_order].astype(np.int32),
        plastic_count=plastic_count,
        hinge_colors=hinge_colors,
        stitches=renumbered("stitches"),
        stitch_weights=joined("stitch_weights"),
        stitch_gaps=joined("stitch_gaps"),
        tethers=renumbered("tethers"),
        tether_lengths=joined("tether_lengths"),
        samples=np.concatenate([alone, edges]).astype(np.int32),
        sample_colors=np.concatenate([[0], len(alone) + edge_colors]).astype(np.int32),
        pressure=by_vertex(pressed) if any(len(model.pressure) for model in models) else models[0].pressure,
        limits=Limits(
            limited[ascending],
            *(
                np.concatenate([getattr(part, name) for part in limits])[ascending]
                for name in ("maximum_distance", "backstop", "stiffness")
            ),
        ),
        layer=by_vertex([np.full(count, number, np.int32) for number, count in enumerate(counts)]),
    )


def fastened(model: Model, vertices: np.ndarray) -> Model:
    """The model with vertices of outer garments fastened to the garments below them.

    Each is stitched to the nearest point of the nearest edge below, and goes no further from it than it is in the
    mesh's positions. A vertex that has no garment below it is left free.

    Args:
        model: of :func:`layered`.
        vertices: int, shape (k,).
    """
    mesh, stitches, weights, gaps = model.mesh, [], [], []
    for number in range(1, int(model.layer.max()) + 1):
        mine = vertices[model.layer[vertices] == number]
        below = mesh.faces[model.layer[mesh.faces[:, 0]] < number]
        if not len(mine):
            continue
        face, weight = closest_points(mesh.vertices[mine], mesh.vertices, below)
        far = np.argsort(weight, axis=1)[:, 0]  # the corner opposite to the nearest edge
        ends = np.stack([below[face, (far + 1) % 3], below[face, (far + 2) % 3]], axis=1)
        start, along = mesh.vertices[ends[:, 0]], mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]]
        place = ((mesh.vertices[mine] - start) * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-30)
        place = np.clip(place, 0.0, 1.0)
        gap = np.linalg.norm(mesh.vertices[mine] - start - place[:, None] * along, axis=1)
        near = gap < FASTENING_REACH
        stitches.append(np.concatenate([mine[:, None], ends], axis=1)[near])
        weights.append(place[near])
        gaps.append(gap[near])
    return replace(
        model,
        stitches=np.concatenate([model.stitches, *stitches]).astype(np.int32),
        stitch_weights=np.concatenate([model.stitch_weights, *weights]).astype(np.float32),
        stitch_gaps=np.concatenate([model.stitch_gaps, *gaps]).astype(np.float32),
    )


def _triangle_rows(models: Sequence[Model]) -> np.ndarray:
    """Data of the triangles of all models, one after the other; zeros where one has less than others."""
    own = [model.triangle_data[:, : len(model.triangles)] for model in models]
    rubs = [model.plastic_shear_count > 0 for model in models]
    plain = [values[: len(values) - rub] for values, rub in zip(own, rubs, strict=True)]
    rows = max(len(values) for values in plain)
    together = np.concatenate([np.pad(values, ((0, rows - len(values)), (0, 0))) for values in plain], axis=1)
    if not any(rubs):
        return together
    slips = [values[-1] if rub else np.zeros(values.shape[1]) for values, rub in zip(own, rubs, strict=True)]
    return np.concatenate([together, np.concatenate(slips)[None]]).astype(np.float32)


def _joined_mesh(meshes: Sequence[ClothMesh], numbers: Sequence[np.ndarray]) -> ClothMesh:
    """One mesh of several; ``numbers``: of each one's vertices in it."""
    placed = list(zip(meshes, numbers, strict=True))
    vertices = np.zeros((sum(len(mesh.vertices) for mesh in meshes), 3))
    for mesh, number in placed:
        vertices[number] = mesh.vertices
    seam_hinges = None
    if any(mesh.seam_hinges is not None for mesh in meshes):
        parts = [
            mesh.seam_hinges._replace(vertices=number[mesh.seam_hinges.vertices].astype(np.int32))
            for mesh, number in placed
            if mesh.seam_hinges is not None
        ]
        seam_hinges = Hinges(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    max_stretch = None
    if any(mesh.max_stretch is not None for mesh in meshes):
        max_stretch = np.concatenate(
            [np.full(len(m.faces), MAX_STRETCH) if m.max_stretch is None else m.max_stretch for m in meshes]
        )
    return ClothMesh(
        vertices,
        np.concatenate([number[mesh.faces] for mesh, number in placed]).astype(np.int32),
        np.concatenate([mesh.flat for mesh in meshes]),
        np.concatenate([number[mesh.stitches] for mesh, number in placed]).astype(np.int32),
        np.concatenate([mesh.stitch_weights for mesh in meshes]),
        seam_hinges,
        max_stretch=max_stretch,
    )
