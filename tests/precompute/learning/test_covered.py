from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from assets.io.sequence import Sequence
from precompute.learning.covered import NEAR, RIM, covered_faces
from precompute.learning.recording import Recording, Run
from tests.wrinkles.meshes import tube

BODY, BODY_FACES = tube(40, 0.1)
LENGTH = float(np.ptp(BODY[:, 1]))


def worn(*radii: float, inside_out: bool = False, layer: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """What tubes around a cylinder cover, shorter than it by a tenth at both ends; a radius for each frame."""
    vertices, faces = tube(48, 0.1)
    height = 0.1 * LENGTH + 0.8 * LENGTH * vertices[:, 1] / np.ptp(vertices[:, 1])
    frames = np.array(
        [vertices * [radius / 0.1, 0.0, radius / 0.1] + height[:, None] * [0.0, 1.0, 0.0] for radius in radii]
    )
    faces = faces[:, ::-1] if inside_out else faces
    if layer is not None:
        faces = np.concatenate([faces, faces + len(vertices)])
        frames = np.concatenate([frames, frames * [1.2, 1.0, 1.2]], axis=1)
    body = Sequence("cylinder", np.repeat(BODY[None], len(radii), axis=0).astype(np.float32), BODY_FACES, 0.1)
    coarse, subdivision = SimpleNamespace(vertices=frames[0], faces=faces), SimpleNamespace(faces=faces)
    levels = SimpleNamespace(coarse=coarse, subdivision=subdivision, fine_layer=layer)
    run = cast(Run, SimpleNamespace(levels=levels, body=body, poses=body.vertices))
    numbers = np.arange(len(radii))
    nothing: Any = numbers
    return covered_faces([run], [Recording("tube", numbers, frames, nothing, nothing, nothing, 0.0)])


@pytest.mark.parametrize("inside_out", [False, True])
def test_faces_in_the_middle_are_covered_and_those_near_the_rims_are_not(inside_out: bool) -> None:
    found, garment = worn(0.102, 0.105, inside_out=inside_out)
    height = BODY[BODY_FACES][..., 1]
    rims = 0.1 * LENGTH, 0.9 * LENGTH
    inside = (height.min(axis=1) > rims[0] + RIM) & (height.max(axis=1) < rims[1] - RIM)
    well_inside = (height.min(axis=1) > rims[0] + RIM + 0.01) & (height.max(axis=1) < rims[1] - RIM - 0.01)
    assert set(garment) == {0} and well_inside.sum() > 500
    assert set(np.flatnonzero(well_inside)) <= set(found)
    assert set(found) <= set(np.flatnonzero(inside))


@pytest.mark.parametrize("radii", [(0.105, 0.1 + 1.2 * NEAR), (0.105, 0.09)])
def test_a_garment_that_is_once_far_off_or_inside_the_body_covers_nothing(radii: tuple[float, ...]) -> None:
    assert len(worn(*radii)[0]) == 0


def test_each_garment_of_an_outfit_covers_for_itself() -> None:
    layer = np.repeat([0, 1], 48 * 49)  # the outer one is larger by a fifth
    (_, both), (found, inner) = worn(0.102, layer=layer), worn(0.105, layer=layer)
    assert set(inner) == {0} and set(both) == {0, 1}
    assert np.array_equal(found, worn(0.105)[0])
