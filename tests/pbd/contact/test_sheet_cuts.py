"""Sheets cut along a curve: the same parts as SciPy's floods and flows find."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_flow

from pbd.contact.sheet_cuts import NEAR, CutCurve, SheetCuts
from pbd.engine import ensure_initialized
from pbd.mesh import edges_of
from tests.pbd.meshes import grid

RINGS = 3


def expected_cut(
    edges: np.ndarray, count: int, curve: CutCurve, most: float, near: np.ndarray | None
) -> tuple[np.ndarray | None, bool]:
    """The part above by SciPy, and whether the curve had to be closed."""
    above, below = np.setdiff1d(curve.above, curve.below), np.setdiff1d(curve.below, curve.above)
    if not (len(above) and len(below)):
        return None, False
    kept = np.delete(edges, curve.edges, axis=0)
    part = connected_components(coo_matrix((np.ones(len(kept)), kept.T), (count, count)), directed=False)[1]
    if not np.isin(part[above], part[below]).any():
        return np.isin(part, part[above]), False
    if near is not None:
        kept = kept[near[kept].all(axis=1)]
    rows = np.concatenate([kept[:, 0], kept[:, 1], np.full(len(above), count), below])
    columns = np.concatenate([kept[:, 1], kept[:, 0], above, np.full(len(below), count + 1)])
    values = np.concatenate([np.ones(2 * len(kept)), np.full(len(above) + len(below), len(kept) + 1)])
    capacity = csr_matrix((values, (rows, columns)), (count + 2, count + 2)).astype(np.int32)
    found = maximum_flow(capacity, count, count + 1)
    if found.flow_value > most:
        return None, True
    rest = capacity - found.flow
    rest.data = np.maximum(rest.data, 0)
    rest.eliminate_zeros()
    reached = breadth_first_order(rest, count, return_predecessors=False)
    return np.isin(np.arange(count), reached), True


def around(edges: np.ndarray, ends: np.ndarray, part: np.ndarray) -> np.ndarray:
    near = np.zeros(len(part), bool)
    near[ends] = True
    near &= part
    for _ in range(RINGS):
        near[edges[near[edges].any(axis=1)]] = True
        near &= part
    return near


@pytest.mark.parametrize("nearby", [False, True])
def test_a_curve_cuts_a_sheet_where_scipy_cuts_it(nearby: bool) -> None:
    """Curves around random discs, of which random edges are missing."""
    ensure_initialized()
    flat, faces = grid(18, 14, 1.0)
    edges, _ = edges_of(faces)
    count, random = len(flat), np.random.default_rng(3)
    cuts, seen = SheetCuts(edges, count), {"by itself": 0, "closed": 0, "not": 0}
    for _ in range(150):
        inner = np.linalg.norm(flat - flat[random.integers(count)], axis=1) < random.uniform(0.8, 5.0)
        crossing = np.flatnonzero(inner[edges[:, 0]] != inner[edges[:, 1]])
        crossing = crossing[random.random(len(crossing)) > random.choice([0.0, 0.05, 0.4])]
        if not len(crossing):
            continue
        first = inner[edges[crossing, 0]]
        above, below = np.where(first, edges[crossing].T, edges[crossing, ::-1].T)
        curve = CutCurve(crossing.astype(np.int32), above.astype(np.int32), below.astype(np.int32))
        most = max(0.5 * len(crossing), 4)
        near = around(edges, edges[crossing], np.ones(count, bool)) if nearby else None
        wanted, closed = expected_cut(edges, count, curve, most, near)
        found = cuts.upper(curve, most, nearby)
        if wanted is None:
            assert found is None
            seen["not"] += 1
            continue
        assert found is not None and np.array_equal(found, wanted)
        assert cuts.closed == closed
        seen["closed" if closed else "by itself"] += 1
        if closed and near is not None:
            assert np.array_equal((cuts.marks & NEAR) > 0, near)
    assert min(seen.values()) > 5, seen


def test_cloth_around_vertices_is_a_few_edges_away() -> None:
    ensure_initialized()
    flat, faces = grid(12, 9, 1.0)
    edges, _ = edges_of(faces)
    random, cuts = np.random.default_rng(0), SheetCuts(edges, len(flat))
    for _ in range(20):
        ends, part = random.integers(len(flat), size=(3, 2)), random.random(len(flat)) > 0.3
        assert np.array_equal(cuts.around(ends, part), around(edges, ends, part))
    assert not cuts.around(np.zeros(0, int), np.ones(len(flat), bool)).any()
