"""Energies of cloth: derivatives against finite differences, invariance, and patch tests between formulations."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pbd import ClothMesh, Fabric, Model
from pbd.mesh import edges_of
from pbd.models.elements import ElementEnergy, Sum
from pbd.models.membrane import condition_membrane, continuum_membrane
from pbd.models.plate import angle_bending, isometric_bending, morley_bending
from pbd.models.springs import square_springs, triangle_springs
from tests.pbd.meshes import cloth, free_model, grid, turn
from tests.pbd.models.sheets import FABRIC, differences, sheet
from tests.refusals import refuses

ISOTROPIC = Fabric(stretch_warp=600.0, stretch_weft=600.0, poisson=1 / 3, shear=225.0, bend_warp=0.0, bend_weft=0.0)


KNIT = replace(FABRIC, stiffening_warp_10=3.0, stiffening_warp_20=6.0, stiffening_weft_10=2.0, stiffening_weft_20=2.5)

ENERGIES: dict[str, Callable[[Model], ElementEnergy | Sum]] = {
    "triangle springs": lambda model: triangle_springs(model.mesh, model.fabric),
    "square springs": lambda model: square_springs(model.mesh, model.fabric),
    "condition": lambda model: condition_membrane(model.mesh, model.fabric),
    "corotational": lambda model: continuum_membrane(model.mesh, model.fabric, "corotational"),
    "stvk": lambda model: continuum_membrane(model.mesh, model.fabric, "stvk"),
    "isometric": isometric_bending,
    "hinges": lambda model: angle_bending(model)[0],
    "morley": lambda model: morley_bending(model, 0.3)[0],
    "sum": lambda model: Sum([triangle_springs(model.mesh, model.fabric), isometric_bending(model)]),
}


def crumpled(model: Model, points: int = 0) -> np.ndarray:
    """Vertices somewhere near their places, and further points anywhere."""
    x = np.concatenate([model.mesh.vertices, np.zeros((max(0, points - model.vertex_count), 3))])
    return (x + np.random.default_rng(3).normal(0.0, 0.01, x.shape)) @ turn((1.0, 2.0, 0.5), 70.0).T


def points_of(energy: ElementEnergy | Sum) -> int:
    return energy.point_count if isinstance(energy, Sum) else energy.vertex_count


@pytest.mark.parametrize("name", ENERGIES)
def test_derivatives_against_finite_differences(name: str) -> None:
    """First and second, 1e-6 of the largest."""
    model = sheet()
    energy = ENERGIES[name](model)
    check_derivatives(energy, crumpled(model, points_of(energy)))


@pytest.mark.parametrize("stretch", [1.1, 1.4])
@pytest.mark.parametrize("kind", ["condition", "corotational", "stvk"])
def test_derivatives_of_cloth_that_stiffens(kind: str, stretch: float) -> None:
    """Stretched within the cubic of the law, and on its tangent: at the end of both the third derivative jumps."""
    model = sheet()
    energy = condition_membrane(model.mesh, KNIT) if kind == "condition" else continuum_membrane(model.mesh, KNIT, kind)
    straight = ENERGIES[kind](model)
    x = stretch * model.mesh.vertices + np.random.default_rng(3).normal(0.0, 0.0005, model.mesh.vertices.shape)
    check_derivatives(energy, x @ turn((1.0, 2.0, 0.5), 70.0).T)
    assert energy.energy(x) > 1.3 * straight.energy(x)
    assert energy.energy(0.9 * model.mesh.vertices) == straight.energy(0.9 * model.mesh.vertices)


def check_derivatives(energy: ElementEnergy | Sum, x: np.ndarray) -> None:
    gradient = energy.gradient(x)
    measured = differences(energy.energy, x, 1e-4).reshape(x.shape)
    assert np.abs(measured - gradient).max() < 1e-6 * np.abs(gradient).max()
    hessian = energy.hessian(x).toarray()
    measured = differences(lambda y: energy.gradient(y).ravel(), x, 1e-4)
    assert np.abs(measured - hessian).max() < 1e-6 * np.abs(hessian).max()


@pytest.mark.parametrize("name", ENERGIES)
def test_a_positive_hessian_has_no_negative_eigenvalue_and_keeps_a_positive_one(name: str) -> None:
    model = sheet()
    energy = ENERGIES[name](model)
    eigenvalues = np.linalg.eigvalsh(energy.hessian(crumpled(model, points_of(energy)), positive=True).toarray())
    assert eigenvalues.min() > -1e-10 * eigenvalues.max()
    rest = Sum([energy], model.vertex_count).completed(model.mesh.vertices) if name == "morley" else model.mesh.vertices
    exact = energy.hessian(rest).toarray()
    assert energy.hessian(rest, positive=True).toarray() == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("name", ENERGIES)
def test_moving_and_turning_cost_nothing(name: str) -> None:
    model = sheet()
    energy = ENERGIES[name](model)
    x = crumpled(model, points_of(energy))
    assert energy.energy(x @ turn((0.3, 1.0, 2.0), 130.0).T + [5.0, -3.0, 8.0]) == pytest.approx(
        energy.energy(x), rel=1e-9
    )


@pytest.mark.parametrize("name", ENERGIES)
def test_a_flat_sheet_rests(name: str) -> None:
    model = sheet()
    energy = ENERGIES[name](model)
    force = (Sum([energy], model.vertex_count) if name == "morley" else energy).gradient(model.mesh.vertices)
    assert np.abs(force).max() < 1e-9


@pytest.mark.parametrize("name", ["stvk", "morley", "hinges"])
def test_elements_can_be_taken_apart(name: str) -> None:
    model = sheet()
    energy = ENERGIES[name](model)
    x = crumpled(model, points_of(energy))
    assert isinstance(energy, ElementEnergy)
    half = np.arange(len(energy.elements)) % 2 == 0
    parts = Sum([energy.subset(np.flatnonzero(half)), energy.subset(np.flatnonzero(~half))])
    assert parts.energy(x) == pytest.approx(energy.energy(x))
    assert parts.hessian(x).toarray() == pytest.approx(energy.hessian(x).toarray())


def affine(energy: ElementEnergy | Sum, mesh: ClothMesh, area: float) -> np.ndarray:
    """Stiffness for (e11, e22, 2 e12) of a sheet under homogeneous small strain, shape (3, 3)."""
    modes = np.zeros((3, *mesh.vertices.shape))
    modes[0, :, 0], modes[1, :, 1] = mesh.vertices[:, 0], mesh.vertices[:, 1]
    modes[2, :, 0], modes[2, :, 1] = 0.5 * mesh.vertices[:, 1], 0.5 * mesh.vertices[:, 0]
    modes = modes.reshape(3, -1)
    return modes @ (energy.hessian(mesh.vertices) @ modes.T) / area


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("corotational", FABRIC.membrane_stiffness()),
        ("stvk", FABRIC.membrane_stiffness()),
        ("condition", np.diag([900.0, 500.0, 200.0])),  # three springs and no Poisson ratio
    ],
)
def test_patch_of_the_continuum(name: str, law: np.ndarray) -> None:
    model = sheet()
    measured = affine(ENERGIES[name](model), model.mesh, model.mesh.face_areas.sum())
    assert measured == pytest.approx(law, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", ["triangle springs", "square springs"])
def test_patch_of_spring_lattices(name: str) -> None:
    """E and nu = 1/3 of plane stress, 1e-6."""
    mesh = cloth(*grid(6, 5, 0.03, "equilateral" if name == "triangle springs" else "alternating"))
    energy = ENERGIES[name](free_model(mesh, ISOTROPIC))
    assert affine(energy, mesh, mesh.face_areas.sum()) == pytest.approx(
        ISOTROPIC.membrane_stiffness(), rel=1e-6, abs=1e-6
    )


def test_a_triangular_lattice_is_the_constant_strain_triangle() -> None:
    """Two formulations of one energy: the whole Hessian at rest, border included."""
    mesh = cloth(*grid(5, 4, 0.03, "equilateral"))
    springs = triangle_springs(mesh, ISOTROPIC).hessian(mesh.vertices).toarray()
    for kind in ("corotational", "stvk"):
        triangles = continuum_membrane(mesh, ISOTROPIC, kind).hessian(mesh.vertices).toarray()
        assert triangles == pytest.approx(springs, abs=1e-6 * np.abs(springs).max())


def test_what_springs_a_square_lattice_has() -> None:
    mesh = cloth(*grid(3, 2, 0.1))
    springs = square_springs(mesh, ISOTROPIC)
    sides, border = 600.0 * 3 / 4, 600.0 * 3 / 8
    assert len(springs.elements) == 4 * 2 + 3 * 3 + 2 * 6  # sides both ways, two diagonals a square
    assert np.unique(np.round(springs.stiffness, 9)).tolist() == [border, sides]
    assert (springs.stiffness == sides).sum() == 2 * 2 + 3 * 1
    span = mesh.vertices[springs.elements[:, 0]] - mesh.vertices[springs.elements[:, 1]]
    assert springs.lengths == pytest.approx(np.linalg.norm(span, axis=1))


def test_other_meshes_are_no_square_lattice() -> None:
    refuses("no square lattice", square_springs, cloth(*grid(3, 3, 0.1, "equilateral")), ISOTROPIC)
    vertices, faces = grid(2, 2, 0.1)
    refuses("no square lattice", square_springs, cloth(vertices, faces[:-1]), ISOTROPIC)


@pytest.mark.parametrize("wave", [(np.pi / 2, np.pi / 2), (np.pi, np.pi), (np.pi, np.pi / 3)])
def test_a_square_lattice_does_not_push_out_of_the_plane(wave: tuple[float, float]) -> None:
    """A wave costs nothing; where long sides push against short diagonals it would gain, and the lattice buckle."""
    mesh = cloth(*grid(12, 12, 0.1))
    place = np.round(mesh.vertices[:, :2] / 0.1)
    inside = np.flatnonzero(np.all((place > 0) & (place < 12), axis=1))
    block = square_springs(mesh, ISOTROPIC).hessian(mesh.vertices).toarray()[2::3, 2::3]
    assert np.abs(block @ np.cos(place @ wave))[inside].max() < 1e-8


@pytest.mark.parametrize("curvature", [(0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01), (0.01, -0.02, 0.005)])
@pytest.mark.parametrize(
    ("kind", "jitter"), [("equilateral", 0.0), ("alternating", 0.0), ("diagonal", 0.0), ("equilateral", 0.0015)]
)
def test_patch_of_the_plate(kind: str, jitter: float, curvature: tuple[float, float, float]) -> None:
    """Orthotropic stiffness and a Poisson ratio of its own, on any mesh, without calibration; 1e-6."""
    vertices, faces = grid(6, 5, 0.01, kind)
    vertices[:, :2] += np.random.default_rng(1).uniform(-jitter, jitter, (len(vertices), 2))
    mesh = cloth(vertices, faces)
    k11, k22, k12 = curvature
    matrix = np.array([[k11, k12], [k12, k22]])
    edges, lengths = mesh.edge_lengths()
    start, end = vertices[edges[:, 0], :2], vertices[edges[:, 1], :2]
    middle, normal = 0.5 * (start + end), (end - start) @ [[0.0, -1.0], [1.0, 0.0]]
    height = lambda p: 0.5 * np.einsum("ni,ij,nj->n", p, matrix, p)  # noqa: E731
    hidden = np.zeros((len(edges), 3))
    hidden[:, :2] = middle + normal
    hidden[:, 2] = 0.5 * (height(start) + height(end)) + np.einsum("ni,ij,nj->n", middle, matrix, normal)
    bent = vertices.copy()
    bent[:, 2] = height(vertices[:, :2])
    energy = morley_bending(free_model(mesh, FABRIC), 0.3)[0]
    mean = np.sqrt(3e-3 * 1e-3)
    law = 3e-3 * k11**2 + 1e-3 * k22**2 + 2 * 0.3 * mean * k11 * k22 + 2 * 0.7 * mean * k12**2
    points = np.concatenate([bent, hidden])
    assert energy.energy(points) == pytest.approx(0.5 * mesh.face_areas.sum() * law, rel=1e-6)
    # No force inside, of vertices or hidden points, under constant curvature.
    inside = np.flatnonzero(np.bincount(edges_of(faces)[1].ravel(), minlength=len(edges)) == 2)
    rim = np.unique(np.delete(edges, inside, axis=0))
    still = np.concatenate([np.setdiff1d(np.arange(len(vertices)), rim), len(vertices) + inside])
    force = energy.gradient(points)
    assert np.abs(force[still, 2]).max() < 1e-9 * np.abs(force).max()


def test_hidden_points_stand_where_they_cost_least() -> None:
    model = sheet()
    energy = Sum(morley_bending(model, 0.2), model.vertex_count)
    x = crumpled(model)
    points = energy.completed(x)
    assert len(points) == energy.point_count == model.vertex_count + len(model.mesh.edge_lengths()[0])
    whole = energy.parts[0].gradient(points)
    assert np.abs(whole[len(x) :]).max() < 1e-9 * np.abs(whole).max()
    assert energy.energy(x) == pytest.approx(energy.energy(points)) and energy.gradient(x).shape == x.shape
    measured = differences(energy.energy, x, 1e-4).reshape(x.shape)
    assert np.abs(measured - energy.gradient(x)).max() < 1e-6 * np.abs(measured).max()
    assert energy.completed(x + 100.0) == pytest.approx(points + 100.0, abs=1e-9)


def test_a_bad_bending_ratio_is_refused() -> None:
    for bad in (-1.0, 1.0, np.nan):
        refuses("bend_poisson", morley_bending, sheet(), bad)


def test_both_hinge_models_agree_for_small_angles() -> None:
    model = sheet("equilateral")
    flat = model.mesh.vertices
    quadratic, angles = isometric_bending(model).hessian(flat), angle_bending(model)[0].hessian(flat)
    assert quadratic.toarray()[2::3, 2::3] == pytest.approx(
        angles.toarray()[2::3, 2::3], abs=1e-9 * np.abs(quadratic.data).max()
    )
