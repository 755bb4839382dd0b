"""Decodes recorded coarse states as docs/recording-file.md says, in NumPy: what any reader of the file computes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.sparse import csr_matrix

from runtime.recording_file import Quantised
from wrinkles.patches import Grid

__all__ = ["RecordedDecoder"]

STENCIL_SIDE = 5
CENTRE = STENCIL_SIDE * STENCIL_SIDE // 2
UP, DOWN, LEFT, RIGHT = CENTRE + STENCIL_SIDE, CENTRE - STENCIL_SIDE, CENTRE - 1, CENTRE + 1
INNER = [CENTRE + STENCIL_SIDE * a + b for a in (-1, 0, 1) for b in (-1, 0, 1)]


class RecordedDecoder:
    """From a recorded coarse state to the fine garment, before the recorded correction.

    Args:
        about: header of the file.
        arrays: its arrays.
    """

    def __init__(self, about: Mapping[str, float], arrays: Mapping[str, Quantised]) -> None:
        self._about = about
        self._arrays = {name: array.values for name, array in arrays.items() if not name.startswith("frames/")}
        a = self._arrays
        count, fine = len(a["stencil/corners"]), len(a["patches/corners"])
        middle = len(a["middle/start"]) - 1
        self._filter = self._matrix("filter", count)
        self._middle, self._surface = self._matrix("middle", count), self._matrix("surface", middle)
        self._smoothing = self._matrix("smoothing", fine) if "smoothing/start" in a else None
        self._place_bias = a["network/place"] @ a["network/place_weights"] + a["network/bias_1"]
        corners, blend = a["patches/corners"].astype(int), a["patches/blend"]
        u, v = (a["patches/within"].reshape(-1, 3, 2)[..., axis] for axis in (0, 1))
        share = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v], axis=-1) * blend[..., None]
        grid = Grid.with_nodes(len(a["atoms/mean"]) // 3)
        first = corners * grid.nodes + a["patches/cell"]
        nodes = first[..., None] + np.array([0, 1, grid.side, grid.side + 1])
        rows = np.repeat(np.arange(fine), 4)
        self._reading = [
            csr_matrix((share[:, c].ravel(), (rows, nodes[:, c].ravel())), (fine, grid.nodes * count)) for c in range(3)
        ]
        if "turning/start" in a:
            self._turning = self._matrix("turning", count)
        else:
            rows = np.repeat(np.arange(fine), 3)
            self._turning = csr_matrix((blend.ravel(), (rows, corners.ravel())), (fine, count))

    def _matrix(self, name: str, columns: int) -> csr_matrix:
        start, index, value = (self._arrays[f"{name}/{part}"] for part in ("start", "index", "value"))
        return csr_matrix((value, index.astype(np.int32), start.astype(np.int32)), (len(start) - 1, columns))

    def __call__(self, coarse: np.ndarray, contact: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fine vertices of a state without its correction, and the frames that the correction is given in.

        Args:
            coarse: coarse vertices about any origin [m], float32, shape (n, 3).
            contact: their distance from the body or the garments below [m], float32, shape (n,).
            held: held fine vertices about the same origin [m], float32, shape (P, 3).

        Returns:
            fine vertices [m], float32, shape (N, 3), and frames of the coarse vertices, float32, shape (n, 3, 3).
        """
        a = self._arrays
        coarse = self._filter @ coarse
        frames, features = self._read(coarse, contact)
        grids = self._grids(features).reshape(-1, 3)
        corners = a["patches/corners"].astype(int)
        added = np.zeros((len(corners), 3), np.float32)
        for c in range(3):
            added += np.einsum("ia,iax->ix", self._reading[c] @ grids, frames[corners[:, c]])
        if self._smoothing is not None:
            added = self._smoothing @ added
        turned = (self._turning @ frames.reshape(-1, 9)).reshape(-1, 3, 3)
        fine = self._surface @ (self._middle @ coarse) + added + np.einsum("ia,iax->ix", a["patches/mean"], turned)
        fine = fine.astype(np.float32)
        fine[a["held"]] = held
        return fine, frames

    def _read(self, coarse: np.ndarray, contact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frames and features of the coarse vertices; see :class:`wrinkles.features.Stencil`."""
        a = self._arrays
        corners, weights = a["stencil/corners"].astype(int), a["stencil/weights"]
        points = (coarse[corners] * weights[..., None]).reshape(len(corners), -1, 3, 3).sum(axis=2)
        distance = (contact[corners] * weights).reshape(len(corners), -1, 3).sum(axis=2)
        e1 = _unit(points[:, UP] - points[:, DOWN])
        e3 = _unit(np.cross(e1, points[:, RIGHT] - points[:, LEFT]))
        frames = np.stack([e1, np.cross(e3, e1), e3], axis=1)
        offsets = np.delete(points - points[:, CENTRE : CENTRE + 1], CENTRE, axis=1)
        local = np.einsum("npx,nax->npa", offsets, frames) / np.float32(self._about["spacing"])
        parts = [local.reshape(len(corners), -1), distance[:, INNER] / np.float32(self._about["far"])]
        features = (np.concatenate(parts, axis=1) - a["network/center"]) * a["network/scale"]
        return frames, np.clip(features, -self._about["clip"], self._about["clip"]).astype(np.float32)

    def _grids(self, features: np.ndarray) -> np.ndarray:
        """Displacements in the patches' frames [m], shape (n, 3 nodes); see :class:`wrinkles.decoder.Decoder`."""
        a = self._arrays
        order, first = a["network/order"].astype(int), a["network/first_rows"]
        hidden = np.maximum(features[order] @ a["network/weights_1"] + self._place_bias, 0.0)
        units = np.maximum(hidden @ a["novelty/weights_1"] + a["novelty/bias_1"], 0.0)
        score = units @ a["novelty/weights_2"] + np.float32(self._about["novelty_bias"])
        width = np.float32(self._about["fade_width"])
        amplitude = np.clip((np.float32(self._about["fade_end"]) - score) / width, 0.0, 1.0)
        coefficients = np.zeros((len(features), len(a["atoms/shapes"])), np.float32)
        for r in range(len(a["network/bias_2"])):
            rows = slice(first[r], first[r + 1])
            second = np.maximum(hidden[rows] @ a["network/weights_2"][r] + a["network/bias_2"][r], 0.0)
            coefficients[order[rows]] = second @ a["network/weights_3"][r] + a["network/bias_3"][r]
            coefficients[order[rows]] *= amplitude[rows, None]
        return coefficients @ a["atoms/shapes"] + a["atoms/mean"]


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
