"""How much the cloth of recorded frames goes through itself, and its garments through one another."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from pbd import ClothMesh
from pbd.crossings import SelfCrossings

__all__ = [
    "COME_APART",
    "CROSSED_AT_MOST",
    "WHOLE",
    "crossed_figures",
    "crossed_jobs",
    "crossed_share",
    "crossed_words",
    "joined_crossed",
]

BLOCK = 64  # frames that one worker looks at
CROSSED_AT_MOST = 0.05  # faces of a training run that may cross others in its worst frame before it is reported [%]
WHOLE = 1.0  # faces that may cross others in a frame that is learned from [%]
# Faces that cross others where a training run ends [%]. Cloth that is through itself as much is a ball that is never
# sorted out, and its frames take a hundred times as long.
COME_APART = 5.0


def crossed_jobs(mesh: ClothMesh, layer: np.ndarray | None, frames: np.ndarray) -> list[partial]:
    """Jobs that look for crossings, of some frames at a time; their results go to :func:`joined_crossed`.

    Args:
        mesh: of the frames; ``layer``: number of the garment of each vertex, None for one garment.
        frames: vertices [m], shape (f, n, 3).
    """
    return [partial(_crossed, mesh, layer, frames[first : first + BLOCK]) for first in range(0, len(frames), BLOCK)]


def _crossed(mesh: ClothMesh, layer: np.ndarray | None, frames: np.ndarray) -> np.ndarray:
    """Of each frame the faces that cross others, and the vertices on edges through another garment [%]: (f, 2)."""
    crossings = SelfCrossings(mesh)
    shares = np.zeros((len(frames), 2))
    for row, vertices in zip(shares, frames, strict=True):
        found = crossings.find(np.asarray(vertices, float))
        row[0] = _share(crossings, found, mesh)
        if layer is not None:
            between = layer[found[:, 0]] != layer[mesh.faces[found[:, 2], 0]]
            row[1] = 100.0 * len(np.unique(found[between, :2])) / len(layer)
    return shares


def _share(crossings: SelfCrossings, found: np.ndarray, mesh: ClothMesh) -> float:
    return 100.0 * len(crossings.faces_of(found)) / len(mesh.faces)


def crossed_share(mesh: ClothMesh, vertices: np.ndarray) -> float:
    """Faces that cross others at given positions [m], shape (n, 3), as a share of all [%]."""
    crossings = SelfCrossings(mesh)
    return _share(crossings, crossings.find(np.asarray(vertices, float)), mesh)


def joined_crossed(parts: Sequence[np.ndarray]) -> np.ndarray:
    """What the jobs of :func:`crossed_jobs` gave, for all frames: shape (f, 2)."""
    return np.concatenate([np.zeros((0, 2)), *parts])


def crossed_figures(shares: np.ndarray, outfit: bool) -> dict[str, float]:
    """Figures of :func:`joined_crossed`; those of garments through one another for outfits alone.

    Returns:
        ``self_crossed_percent``: faces that cross another, mean over the frames; ``self_crossed_worst_percent``: in the
        worst frame; ``crossed_layers_percent``, ``crossed_layers_at_end_percent``: vertices on edges that go through
        another garment, mean and last frame [%].
    """
    crossed, between = shares.T
    figures = {
        "self_crossed_percent": float(crossed.mean()),
        "self_crossed_worst_percent": float(crossed.max()),
    }
    if outfit:
        figures |= {
            "crossed_layers_percent": float(between.mean()),
            "crossed_layers_at_end_percent": float(between[-1]),
        }
    return figures


def crossed_words(name: str, seconds: np.ndarray, shares: np.ndarray, end: float) -> str:
    """Lines about a training run that goes through itself; empty where it does so little or not at all.

    Args:
        name: of the run.
        seconds: at which its frames are [s], shape (f,).
        shares: see :func:`joined_crossed`.
        end: time of the frame that the run would end with if the cloth stayed whole [s].
    """
    lines, crossed = [], shares[:, 0]
    if crossed.max(initial=0.0) > CROSSED_AT_MOST:
        worst = int(crossed.argmax())
        lines.append(
            f"the fine cloth goes through itself in {name}: {crossed.mean():.2g} % of its faces cross others, "
            f"{crossed[worst]:.2g} % at worst, at {seconds[worst]:.1f} s; wrinkles learned there are ragged"
        )
    left_out = int((crossed > WHOLE).sum())
    if left_out:
        lines.append(f"{left_out} of {len(crossed)} frames of {name} are left out: over {WHOLE:g} % of the faces cross")
    last = float(seconds.max(initial=0.0))
    if last < end - 1e-6:
        lines.append(
            f"{name} ends at {last:.1f} of {end:.1f} s, where the fine cloth has come apart: over {COME_APART:g} % of "
            "its faces cross others. The motion asks more of this garment than it can give"
        )
    return "\n".join(lines)
