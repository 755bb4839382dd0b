"""Several garments worn over one another, as one model: they share time steps, contact and momentum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

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
    of the innermost garment.

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
    joined = _Joined(models, numbers)
    fabrics = [model.fabric for model in models]
    thickness, friction = max(f.thickness for f in fabrics), min(f.friction for f in fabrics)
    pressed = [np.resize(model.pressure, model.vertex_count) for model in models]  # nothing becomes zeros
    return replace(
        models[0],
        mesh=_joined_mesh([model.mesh for model in models], numbers),
        fabric=replace(fabrics[0], thickness=thickness, friction=friction, compression=0.0),
        mass=joined.by_vertex([model.mass for model in models]),
        inverse_mass=joined.by_vertex([model.inverse_mass for model in models]),
        held=np.sort(joined.renumbered("held")),
        stitches=joined.renumbered("stitches"),
        stitch_weights=joined.values("stitch_weights"),
        stitch_gaps=joined.values("stitch_gaps"),
        tethers=joined.renumbered("tethers"),
        tether_lengths=joined.values("tether_lengths"),
        pressure=joined.by_vertex(pressed) if any(len(model.pressure) for model in models) else models[0].pressure,
        layer=joined.by_vertex([np.full(count, number, np.int32) for number, count in enumerate(counts)]),
        limits=_joined_limits(joined),
        **_joined_triangles(joined),
        **_joined_hinges(joined),
        **_joined_samples(joined),
    )


class _Joined:
    """Arrays of several models as those of one.

    Args:
        models: from the innermost outwards.
        numbers: of each one's vertices in the model of all, int, shapes (k,).
    """

    def __init__(self, models: Sequence[Model], numbers: Sequence[np.ndarray]) -> None:
        self.models, self.numbers = models, numbers
        self.vertex_count = sum(model.vertex_count for model in models)

    def values(self, name: str) -> np.ndarray:
        """Values of an attribute, one garment after the other."""
        return np.concatenate([getattr(model, name) for model in self.models])

    def renumbered(self, name: str, of: Sequence | None = None) -> np.ndarray:
        """An attribute that numbers vertices, one garment after the other; ``of``: parts of the models that have it."""
        parts = zip(self.models if of is None else of, self.numbers, strict=True)
        return np.concatenate([number[getattr(part, name)] for part, number in parts]).astype(np.int32)

    def by_vertex(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Values of the vertices of each garment, at the places of the vertices."""
        placed = np.zeros((self.vertex_count, *values[0].shape[1:]), values[0].dtype)
        for number, value in zip(self.numbers, values, strict=True):
            placed[number] = value
        return placed

    def by_color(self, colors: str, skip: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Order of constraints by colour after the first ``skip`` ones, and where each colour starts and ends."""
        sizes = [np.diff(getattr(model, colors))[skip:] for model in self.models]
        color = np.concatenate([np.repeat(np.arange(len(size)), size) for size in sizes])
        ends = np.concatenate([[0], np.cumsum(np.bincount(color, minlength=1))]).astype(np.int32)
        return np.argsort(color, kind="stable"), ends

    def shifted(self, name: str, counts: Sequence[int]) -> np.ndarray:
        """Numbers among ``counts`` places of each garment, one garment's places after the other's."""
        before = np.cumsum([0, *counts])
        return np.concatenate([getattr(m, name) + n for m, n in zip(self.models, before, strict=False)])


def _joined_triangles(joined: _Joined) -> dict[str, Any]:
    """The fields of a model about triangles. With friction in one garment, every triangle has a place in the state."""
    order, colors = joined.by_color("triangle_colors")
    counts = [len(model.triangles) for model in joined.models]
    blocks, block_colors = blocks_of(colors)
    return {
        "triangles": joined.renumbered("triangles")[order],
        "triangle_blocks": blocks,
        "block_colors": block_colors,
        "triangle_data": np.pad(_triangle_rows(joined.models)[:, order], ((0, 0), (0, BLOCK))),
        "triangle_numbers": joined.shifted("triangle_numbers", counts)[order].astype(np.int32),
        "plastic_shear_count": sum(counts) if any(model.plastic_shear_count for model in joined.models) else 0,
        "triangle_colors": colors,
    }


def _joined_hinges(joined: _Joined) -> dict[str, Any]:
    """The fields of a model about hinges. With friction in one garment, every hinge has a place in the state."""
    order, colors = joined.by_color("hinge_colors")
    counts = [max(model.plastic_count, 1 + model.hinge_numbers.max(initial=-1)) for model in joined.models]
    return {
        "hinges": joined.renumbered("hinges")[order],
        "hinge_data": joined.values("hinge_data")[order],
        "hinge_numbers": joined.shifted("hinge_numbers", counts)[order].astype(np.int32),
        "plastic_count": int(sum(counts)) if any(model.plastic_count for model in joined.models) else 0,
        "hinge_colors": colors,
    }


def _joined_samples(joined: _Joined) -> dict[str, Any]:
    """The fields of a model about contact samples: the vertices, which are the first colour, then middles of edges."""
    order, colors = joined.by_color("sample_colors", skip=1)
    pairs = zip(joined.models, joined.numbers, strict=True)
    edges = np.concatenate([number[model.samples[len(number) :]] for model, number in pairs])[order]
    alone = np.repeat(np.arange(joined.vertex_count)[:, None], 2, axis=1)
    return {
        "samples": np.concatenate([alone, edges]).astype(np.int32),
        "sample_colors": np.concatenate([[0], len(alone) + colors]).astype(np.int32),
    }


def _joined_limits(joined: _Joined) -> Limits:
    """The limits of all garments, their vertices ascending."""
    limits = [model.limits for model in joined.models]
    limited = joined.renumbered("vertices", limits)
    order = np.argsort(limited)
    names = ("maximum_distance", "backstop", "stiffness")
    values = (np.concatenate([getattr(part, name) for part in limits])[order] for name in names)
    return Limits(limited[order], *values)


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
        own_vertices = vertices[model.layer[vertices] == number]
        below = mesh.faces[model.layer[mesh.faces[:, 0]] < number]
        if not len(own_vertices):
            continue
        face, weight = closest_points(mesh.vertices[own_vertices], mesh.vertices, below)
        far = np.argsort(weight, axis=1)[:, 0]  # the corner opposite to the nearest edge
        ends = np.stack([below[face, (far + 1) % 3], below[face, (far + 2) % 3]], axis=1)
        start, along = mesh.vertices[ends[:, 0]], mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]]
        place = ((mesh.vertices[own_vertices] - start) * along).sum(axis=1) / np.maximum(
            (along * along).sum(axis=1), 1e-30
        )
        place = np.clip(place, 0.0, 1.0)
        gap = np.linalg.norm(mesh.vertices[own_vertices] - start - place[:, None] * along, axis=1)
        near = gap < FASTENING_REACH
        stitches.append(np.concatenate([own_vertices[:, None], ends], axis=1)[near])
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
