"""Orders of convergence in space, measured. Those in time stand with the integrators."""

import numpy as np
import pytest

from pbd import Colliders, Fabric, State
from pbd.models import ClothSolver, cloth_energy, make_solver
from tests.pbd.meshes import cloth, free_model, grid

# Gamma: height over width of the tip, from theta'' = -Gamma (1 - s) cos theta.
CANTILEVER = {0.1: 0.0124996, 10.0: 1.0668023}
FABRIC = Fabric(stretch_warp=90.0, stretch_weft=50.0, poisson=0.3, shear=20.0, bend_warp=3e-3, bend_weft=1e-3)


def bent_energy(membrane: str, bending: str, edges: int, flat: bool) -> float:
    """Energy of a smooth deformation of a square: in the plane, or out of it."""
    vertices, faces = grid(edges, edges, 0.2 / edges)
    model = free_model(cloth(vertices, faces), FABRIC)
    x = vertices.copy()
    u, v = 2 * np.pi * vertices[:, 0] / 0.2, 2 * np.pi * vertices[:, 1] / 0.2
    if flat:
        x[:, 0] += 0.004 * np.sin(u) * np.cos(0.5 * v)
        x[:, 1] += 0.003 * np.cos(0.7 * u + v)
    else:
        x[:, 2] += 1e-4 * (np.sin(0.5 * u) * np.sin(0.5 * v)) ** 4  # without moment at the border
    energy = cloth_energy(model, membrane, bending, 0.3)
    part = energy.parts[0] if flat else energy.parts[1]
    return part.energy(energy.completed(x))


@pytest.mark.parametrize(
    ("membrane", "bending", "flat"),
    [
        ("fem-corotational", "isometric", True),
        ("fem-stvk", "isometric", True),
        ("baraff-witkin", "isometric", True),
        ("springs-square", "isometric", True),
        ("fem-stvk", "isometric", False),
    ],
)
def test_energy_converges_with_the_square_of_the_edge(membrane: str, bending: str, flat: bool) -> None:
    """Three meshes tell the order without an exact value. (Morley: the cantilever below.)"""
    first, second, third = (bent_energy(membrane, bending, edges, flat) for edges in (10, 20, 40))
    assert np.log2(abs(first - second) / abs(second - third)) == pytest.approx(2.0, abs=0.3)


def cantilever(gamma: float, edges: int, kind: str) -> float:
    """Height over width of the tip of a strip clamped level under its own weight, in equilibrium."""
    length, density = 0.2, 0.2
    step = length / edges
    vertices, faces = grid(edges + 1, max(4, 2 * edges // 5), step, kind)
    vertices = np.stack([vertices[:, 0] - step, vertices[:, 2], -vertices[:, 1]], axis=1)
    bend = density * 9.81 * length**3 / gamma
    fabric = Fabric(density, 3e4, 3e4, 0.0, 1.2e4, bend, bend, air_drag=0.0)
    model = free_model(cloth(vertices, faces), fabric, np.flatnonzero(vertices[:, 0] < 1e-9))
    solver = make_solver("fem-stvk/quasi-static", model)
    assert isinstance(solver, ClothSolver)
    solver.step(State.at_rest(model), Colliders(), 1 / 60)
    tip = solver.position[vertices[:, 0] > length - 1e-9].mean(axis=0)
    return -tip[1] / tip[0]


@pytest.mark.parametrize("kind", ["alternating", "diagonal"])
def test_order_of_the_cantilever(kind: str) -> None:
    """Second order, and without calibration; small and large deflection."""
    small = [cantilever(0.1, edges, kind) / CANTILEVER[0.1] - 1.0 for edges in (5, 10, 20)]
    assert np.log2(np.divide(small[:-1], small[1:])) == pytest.approx([2.0, 2.0], abs=0.2)
    assert abs(small[2]) < 5e-3
    assert cantilever(10.0, 20, kind) == pytest.approx(CANTILEVER[10.0], rel=0.01)
