"""Distance fields of meshes: exact at grid points, and what cannot be one is refused."""

import numpy as np
import pytest

from pbd import Colliders, Fabric, InputError, State
from tests.pbd.meshes import RADIUS, THICKNESS, bodies, cloth, free_model, level_sheet, run, to_triangles, turn
from tests.refusals import refuses
from tests.wrinkles.meshes import icosphere
from wrinkles.field import field_of_mesh


@pytest.mark.parametrize("seed", [1, 2])
def test_values_are_the_exact_distance(seed: int) -> None:
    """A lumpy ball and a box, against all faces; at a few points of the grid."""
    vertices, faces = bodies(seed)
    field = field_of_mesh(vertices, faces, 0.02)
    counts = np.array(field.values.shape)
    for end, reach in ((field.origin, vertices.min(axis=0) - 0.03), (field.origin + 0.02 * (counts - 1), None)):
        assert reach is None or end == pytest.approx(reach)
        assert reach is not None or (end > vertices.max(axis=0) + 0.03 - 1e-9).all()
    places = np.random.default_rng(seed).integers(0, counts, (300, 3))
    distance, foot = to_triangles(field.origin + 0.02 * places, vertices, faces)
    values = field.values[tuple(places.T)]
    assert np.abs(values) == pytest.approx(distance, abs=1e-6)
    inside = np.abs(field.origin + 0.02 * places) < 0.99 * np.abs(vertices).max(axis=0)
    if seed == 2:
        assert np.array_equal(values < -1e-9, inside.all(axis=1))


def test_cloth_rests_on_the_field_of_a_mesh() -> None:
    ball, faces = icosphere(4, RADIUS)
    field = field_of_mesh(ball, faces, 0.01)
    field.rotation = turn((1.0, 1.0, 0.0), 25.0)
    vertices, cloth_faces = level_sheet(12, 0.45, RADIUS + 0.02)
    model = free_model(cloth(vertices, cloth_faces), Fabric(thickness=THICKNESS, friction=0.5))
    state = State.at_rest(model)
    run(model, state, 60, colliders=Colliders([field]))
    gap = np.linalg.norm(state.world(), axis=1) - RADIUS - THICKNESS
    assert gap.min() > -5e-4 and (np.abs(gap) < 5e-4).sum() > 15


def test_meshes_that_are_no_solid_are_refused() -> None:
    vertices, faces = icosphere(2, 0.1)
    refuses(r"not closed \(received '3 edges", field_of_mesh, vertices, faces[1:], 0.01)
    refuses("not closed", field_of_mesh, vertices, np.concatenate([faces, faces[:1]]), 0.01)
    with pytest.raises(InputError, match="not closed"):  # one face wound against the others
        field_of_mesh(vertices, np.concatenate([faces[:-1], faces[-1:, ::-1]]), 0.01)
    refuses("inside out", field_of_mesh, vertices, faces[:, ::-1], 0.01)
    refuses("no such vertex", field_of_mesh, vertices[:-1], faces, 0.01)
    refuses("finite", field_of_mesh, vertices * np.nan, faces, 0.01)
    refuses("spacing", field_of_mesh, vertices, faces, 0.0)
    refuses("grid of 1.76e", field_of_mesh, vertices, faces, 1e-4)
