"""A sewn garment: one surface with its flat metric, and the figures by which it is judged."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from assets.garment import Garment
from assets.sewing.body import StandingBody
from pbd.crossings import crossings
from pbd.distance import TOLERANCE, BodyDistance

__all__ = ["SewnGarment", "body_crossings", "drape_figures", "faults_of", "faulty_panels"]

MAX_SEAM_GAP = 0.0005  # between stitched points [m]
MAX_SLIDE = 0.08  # of the garment's uppermost opening, up or down from where it was arranged [m]
NEAR = 0.01  # faces of the body so near the garment's box may touch it [m]
MAX_STRAIN = 0.25  # of the edges, at the 99th percentile [-]; more is a garment too small for its body


@dataclass(frozen=True, eq=False)
class SewnGarment:
    """A garment as it was sewn on a body.

    Attributes:
        garment: vertices, faces, rest shape (warp, weft) and layers.
        panel_names: of the pattern.
        panel_of_face: int32, shape (m,).
        seams: edges along seams, int32, shape (e, 2).
        fabric: name of the fabric that it was draped in.
        figures: see :func:`drape_figures`; empty where the garment comes from a file.
    """

    garment: Garment
    panel_names: tuple[str, ...]
    panel_of_face: NDArray[np.int32]
    seams: NDArray[np.int32]
    fabric: str
    figures: dict[str, float] = field(default_factory=dict)


def body_crossings(vertices: NDArray[np.float64], faces: NDArray[np.int32], body: StandingBody) -> NDArray[np.int64]:
    """Where a garment and a body go through one another.

    Returns:
        rows of both ends of an edge and the face that it goes through, one of which is the body's: int64, shape (k, 3);
        vertices and faces of the body count on from those of the garment.
    """
    corners = body.vertices[body.faces]
    low, high = vertices.min(axis=0) - NEAR, vertices.max(axis=0) + NEAR
    near = np.flatnonzero(((corners > low) & (corners < high)).all(axis=2).any(axis=1))
    count = len(vertices)
    both = np.concatenate([faces, body.faces[near] + count])
    found = crossings(np.concatenate([vertices, body.vertices]), both)
    mixed = (found[:, 0] < count) != (found[:, 2] < len(faces))
    found = found[mixed]
    of_body = found[:, 2] >= len(faces)
    found[of_body, 2] = len(faces) + near[found[of_body, 2] - len(faces)]
    return found


def drape_figures(garment: Garment, body: StandingBody) -> dict[str, float]:
    """How a draped garment lies.

    Returns:
        vertex_count, crossings (edges that go through faces of the garment), body_crossings (edges of the one that go
        through faces of the other), inside_body (vertices) and deepest_mm,
        strain_p50 and strain_p99 of the edges' lengths against their rest shape (absolute values); tension_p99 with
        shortened edges as negative values.
    """
    assert garment.pattern is not None
    depth = BodyDistance(body.faces).signed_distance(garment.vertices, body.vertices)
    sides = [
        np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2) for x in (garment.vertices[garment.faces], garment.pattern)
    ]
    strain = sides[0] / sides[1] - 1.0
    return {
        "vertex_count": len(garment.vertices),
        "crossings": len(crossings(garment.vertices, garment.faces)),
        "body_crossings": len(body_crossings(garment.vertices, garment.faces, body)),
        "inside_body": int((depth < -TOLERANCE).sum()),
        "deepest_mm": 1e3 * max(0.0, -float(depth.min())),
        "strain_p50": float(np.percentile(np.abs(strain), 50)),
        "strain_p99": float(np.percentile(np.abs(strain), 99)),
        "tension_p99": float(np.percentile(strain, 99)),
    }


def faulty_panels(sewn: SewnGarment, body: StandingBody) -> list[str]:
    """Names of the panels that go through cloth or body, lie in the body or are stretched too far, in their order."""
    garment = sewn.garment
    assert garment.pattern is not None
    faces, bad = garment.faces, np.zeros(len(garment.faces), bool)
    vertex = BodyDistance(body.faces).signed_distance(garment.vertices, body.vertices) < -TOLERANCE
    for found in (crossings(garment.vertices, faces), body_crossings(garment.vertices, faces, body)):
        ends, through = found[:, :2].ravel(), found[:, 2]
        vertex[ends[ends < len(vertex)]] = True
        bad[through[through < len(bad)]] = True
    sides = [np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2) for x in (garment.vertices[faces], garment.pattern)]
    bad |= vertex[faces].any(axis=1) | (sides[0] > (1.0 + MAX_STRAIN) * sides[1]).any(axis=1)
    return [sewn.panel_names[k] for k in np.unique(sewn.panel_of_face[bad])]


def faults_of(figures: dict[str, float]) -> list[str]:
    """Sentences about everything for which a garment is not whole; none if it is."""
    found = []
    if figures["seam_gap_mm"] > 1e3 * MAX_SEAM_GAP:
        found.append(f"a seam stays open by {figures['seam_gap_mm']:.1f} mm")
    if figures["crossings"]:
        found.append(f"{figures['crossings']:.0f} edges go through other cloth")
    if figures["body_crossings"]:
        found.append(f"cloth and body go through one another at {figures['body_crossings']:.0f} edges")
    if figures["inside_body"]:
        found.append(f"{figures['inside_body']:.0f} vertices are inside the body, {figures['deepest_mm']:.1f} mm deep")
    if figures["slid_cm"] > 100.0 * MAX_SLIDE:
        found.append(f"it slid down by {figures['slid_cm']:.0f} cm: nothing holds it")
    if figures["slid_cm"] < -100.0 * MAX_SLIDE:
        found.append(f"it slid up by {-figures['slid_cm']:.0f} cm: it is too small where it belongs")
    if figures["tension_p99"] > MAX_STRAIN:
        found.append(
            f"the cloth is stretched by {100.0 * figures['tension_p99']:.0f} % (99th percentile of its edges): it is "
            "too small for the body, or caught on it"
        )
    return found
