from __future__ import annotations

import numpy as np
import pytest

from assets.procedural.builtin import builtin_garment
from pbd import ClothMesh
from tests.wrinkles.meshes import flat_sheet
from wrinkles.charts import Charts, fine_places
from wrinkles.patches import Grid, Patches
from wrinkles.surface import Subdivision


def axis(grid: Grid) -> np.ndarray:
    """Places of a grid's nodes along one axis, in cells."""
    return np.arange(grid.side) - grid.side // 2


class Sheet:
    """A flat sheet, its patches and where its coarse and fine vertices lie in (warp, weft) [m]."""

    def __init__(self, jitter: float, subdivisions: int) -> None:
        vertices, faces = flat_sheet(9, 0.8, jitter)
        self.subdivision = Subdivision.of(faces, len(vertices), subdivisions)
        self.patches = Patches.of(self.subdivision, Charts.of(ClothMesh.from_surface(vertices, faces, (1.0, 0.0, 0.0))))
        self.coarse = vertices[:, [0, 2]] * [1.0, -1.0]
        face, weights = fine_places(self.subdivision)
        self.fine = np.einsum("pc,pci->pi", weights, self.coarse[faces[face]])
        away = self.fine[:, None] - self.coarse[self.patches.corners]
        self.grid = self.patches.grid
        self.covered = (np.abs(away) < axis(self.grid)[-1] * self.patches.spacing).all(axis=(1, 2))

    def nodes(self, vertex: int) -> np.ndarray:
        """Places of the grid's nodes around a coarse vertex, shape (nodes, 2)."""
        offset = np.stack(np.meshgrid(axis(self.grid), axis(self.grid), indexing="ij"), axis=-1).reshape(-1, 2)
        return self.coarse[vertex] + self.patches.spacing * offset

    def read(self, grids: np.ndarray) -> np.ndarray:
        """What fine vertices read of grids, shape (n, nodes) to (N,), from what the arrays are said to be."""
        p, side = self.patches, self.grid.side
        total = np.zeros(len(p.corners))
        for c in range(3):
            grid = grids[p.corners[:, c]].reshape(-1, side, side)
            rows, (a, b) = np.arange(len(grid)), np.divmod(p.cell[:, c], side)
            u, v = p.within[:, 2 * c], p.within[:, 2 * c + 1]
            low = (1 - u) * grid[rows, a, b] + u * grid[rows, a + 1, b]
            high = (1 - u) * grid[rows, a, b + 1] + u * grid[rows, a + 1, b + 1]
            total += p.blend[:, c] * ((1 - v) * low + v * high)
        return total


@pytest.fixture(scope="module", params=[(0.0, 2), (0.25, 2), (0.0, 1), (0.25, 1)])
def sheet(request: pytest.FixtureRequest) -> Sheet:
    return Sheet(*request.param)


def test_a_grid_is_found_by_its_number_of_nodes() -> None:
    grids = [Grid.of(subdivisions) for subdivisions in (1, 2, 3)]
    assert [grid.cells for grid in grids] == [2, 4, 4]  # one for each fine edge, but at most four
    assert [Grid.with_nodes(grid.nodes) for grid in grids] == grids
    assert [grid.nodes for grid in grids] == [25, 121, 121]


def test_the_blend_is_a_partition_of_unity(sheet: Sheet) -> None:
    p, count = sheet.patches, len(sheet.coarse)
    assert p.blend.min() >= 0.0
    np.testing.assert_allclose(p.blend.sum(axis=1), 1.0, atol=1e-6)
    assert p.blend[:count].max(axis=1) == pytest.approx(0.943, abs=1e-3)  # a coarse vertex reads mostly its own patch
    assert np.array_equal(p.corners[np.arange(count), p.blend[:count].argmax(axis=1)], np.arange(count))
    np.testing.assert_allclose(sheet.read(np.full((count, sheet.grid.nodes), 3.5)), 3.5, atol=1e-5)


def test_cells_and_places_in_them_are_inside_the_grid() -> None:
    garment = builtin_garment("tshirt")
    subdivision = Subdivision.of(garment.faces, len(garment.vertices), 2)
    patches = Patches.of(subdivision, Charts.of(subdivision.meshes(garment.vertices)[0]))
    rows, columns = np.divmod(patches.cell, patches.grid.side)
    assert min(rows.min(), columns.min()) >= 0 and max(rows.max(), columns.max()) < patches.grid.side - 1
    assert patches.within.min() >= 0.0 and patches.within.max() <= 1.0


def test_patches_reach_as_far_as_the_next_coarse_vertices(sheet: Sheet) -> None:
    lengths = np.linalg.norm(np.diff(sheet.coarse[sheet.subdivision.coarse_faces], axis=1), axis=2)
    assert sheet.patches.spacing * sheet.grid.cells == pytest.approx(lengths.mean(), rel=0.1)
    away = np.abs(sheet.fine[:, None] - sheet.coarse[sheet.patches.corners])
    outside = (away > axis(sheet.grid)[-1] * sheet.patches.spacing).any(axis=2)
    assert (
        sheet.patches.blend * outside
    ).sum() < 0.015 * sheet.patches.blend.sum()  # what is not covered hardly counts


def test_a_linear_function_is_read_exactly(sheet: Sheet) -> None:
    function = lambda place: 0.3 + place @ [2.0, -1.5]  # noqa: E731
    grids = np.stack([function(sheet.nodes(vertex)) for vertex in range(len(sheet.coarse))])
    error = np.abs(sheet.read(grids) - function(sheet.fine))
    assert error[sheet.covered].max() < 1e-5
    other = np.stack([function(sheet.nodes(v)[:, ::-1]) for v in range(len(sheet.coarse))])
    assert np.abs(sheet.read(other) - function(sheet.fine)).max() > 0.1  # warp and weft are not taken for one another


def test_fitted_grids_give_a_smooth_displacement_back(sheet: Sheet) -> None:
    edge = sheet.grid.cells * sheet.patches.spacing
    fits = sheet.patches.fits(len(sheet.coarse))
    for wavelength, tolerance in ((1e6, 1e-3), (4.0, 0.01), (2.0, 0.03), (1.2, 0.12)):
        wave = np.cos(2 * np.pi / (wavelength * edge) * sheet.fine @ [0.8, 0.6])
        grids = np.stack([fit @ wave[members] for members, fit in fits])
        assert grids.shape == (len(sheet.coarse), sheet.grid.nodes)
        assert np.abs(sheet.read(grids) - wave)[sheet.covered].max() < tolerance


def test_a_fit_listens_to_the_vertices_that_read_its_patch(sheet: Sheet) -> None:
    corners = sheet.patches.corners
    for coarse, (members, fit) in enumerate(sheet.patches.fits(len(sheet.coarse))):
        assert np.array_equal(members, np.flatnonzero((corners == coarse).any(axis=1)))
        assert fit.shape == (sheet.grid.nodes, len(members))


@pytest.mark.parametrize("grid", [Grid.of(1), Grid.of(2)])
def test_the_slope_metric_is_a_metric_without_preferred_side(grid: Grid) -> None:
    lower = grid.slope_metric()
    assert np.array_equal(lower, np.tril(lower))
    metric = lower @ lower.T
    assert np.linalg.eigvalsh(metric).min() > 1e-5
    index = np.arange(grid.nodes).reshape(grid.side, grid.side)
    for same in (index.T, index[::-1], index[:, ::-1]):
        order = same.ravel()
        np.testing.assert_allclose(metric[np.ix_(order, order)], metric, atol=1e-12)


@pytest.mark.parametrize("grid", [Grid.of(1), Grid.of(2)])
def test_the_slope_metric_counts_slopes_and_the_middle(grid: Grid) -> None:
    lower, side, cells = grid.slope_metric(), grid.side, axis(grid)
    error = lambda d: float(((lower.T @ d.ravel()) ** 2).sum())  # noqa: E731
    share = np.clip(1.0 - np.abs(cells) / grid.cells, 0.05, None)
    flat = np.ones((side, side))
    assert error(flat) == pytest.approx(share.sum() ** 2 / grid.cells**2)  # displacement as slope over an edge
    assert error(2.0 * flat) == pytest.approx(4.0 * error(flat))
    ripple = (-1.0) ** cells[:, None] * flat
    assert error(ripple) > 2.0 * grid.cells**2 * error(flat)
    middle, corner = np.zeros((2, side, side))
    middle[side // 2, side // 2] = corner[0, 0] = 1.0
    assert error(middle) > 20.0 * error(corner)
