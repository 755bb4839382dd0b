"""Real garments on real clips: what is counted, and, as proofs, what came."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from assets.garment import highest_loop
from assets.motion import ClipMotion
from assets.procedural.builtin import builtin_garment
from assets.procedural.mannequin import builtin_mannequin
from pbd import ClothMesh, Fabric, InputError, build_model
from pbd.distance import BodyDistance
from precompute.benchmarks.clips import CLIPS, MAX_OVER_LIMBS, clip_rows, overlapping, run_clip, shrinking, write_clips
from runtime.play.simulation import Simulation, body_source
from tests.data import data_path
from tests.wrinkles.meshes import icosphere


class Still:
    """The pose in which a walk is led into, for a second."""

    name, duration, lead_in = "still", 1.0, 0.0

    def __init__(self) -> None:
        body = builtin_mannequin()
        self._pose = ClipMotion(body, next(iter(body.clips.values()))).pose(0.0)

    def pose(self, t: float) -> np.ndarray:
        return self._pose


def still() -> tuple[Simulation, Still]:
    """The built-in skirt on the built-in body; its waist is held where it is."""
    body, garment, motion = builtin_mannequin(), builtin_garment("skirt"), Still()
    held = highest_loop(garment.vertices, garment.faces)
    mesh = ClothMesh.from_surface(garment.vertices, garment.faces)
    model = build_model(mesh, Fabric(), held, bend_factor=1 / 3)
    return Simulation(model, None, body_source(body), motion.pose(0.0)), motion


def test_a_skirt_on_a_body_that_stands_is_outside_and_whole() -> None:
    found = run_clip(*still())
    assert found["frames"] == 60 and found["finite"] == 1.0
    assert found["inside_s"] <= 2 / 60 and found["crossings_layers"] == 0.0 and found["catastrophic_frames"] == 0.0
    assert found["speed_over_limb"] < MAX_OVER_LIMBS
    assert 0.0 < found["frame_ms_p50"] <= found["frame_ms_p99"]


@pytest.mark.proof
def test_a_clip_comes_with_its_picture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(CLIPS, "still", still)  # pyright: ignore[reportArgumentType]
    monkeypatch.setattr(Still, "duration", 0.7)
    told: list[str] = []
    (row,) = clip_rows(["still"], report=told.append, pictures=tmp_path)
    assert row["clip"] == "still" and row["frames"] == 42 and told == ["1 of 1 clips"]
    width, height = Image.open(tmp_path / "still.png").size
    assert width > 6 * 420 and height > 2 * 560


def test_what_stays_inside_or_is_not_finite_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation, motion = still()
    held = simulation.state.position[simulation.model.held, :3]
    free = int(np.flatnonzero(simulation.model.inverse_mass > 0.0)[0])
    deep = held.mean(axis=0)  # in the waist
    step = simulation.step

    def stuck(pose: np.ndarray, dt: float) -> None:
        step(pose, dt)
        simulation.state.position[free, :3] = deep

    monkeypatch.setattr(simulation, "step", stuck)
    found = run_clip(simulation, motion)
    assert found["inside_s"] == pytest.approx(30 / 60)  # all that is judged
    assert found["catastrophic_frames"] > 0  # its edges are over twice as long
    monkeypatch.setattr(simulation, "step", lambda pose, dt: simulation.state.position.fill(np.nan))
    assert run_clip(simulation, motion)["finite"] == 0.0


def test_a_stretched_garment_shrinks_to_its_pattern_and_never_grows() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.1], [0.0, 0.2, 0.0], [0.3, 0.2, 0.0]])
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    flat = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.2], [0.1, 0.2]])
    mesh = ClothMesh.from_pattern(vertices, faces, flat[faces])
    sizes = [replace(mesh, flat=flat).edge_lengths()[1] for flat in shrinking(mesh, 4)]
    edges = mesh.edge_lengths()[0]
    start = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    assert sizes[-1] == pytest.approx(mesh.edge_lengths()[1])
    assert np.all(np.diff([start, *sizes], axis=0) < 1e-12)


def test_rows_are_written_and_unknown_names_refused(tmp_path: Path) -> None:
    write_clips(tmp_path / "clips.csv", [{"clip": "one", "inside_s": 0.25}])
    with open(tmp_path / "clips.csv", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert (row["clip"], row["inside_s"]) == ("one", "0.25") and row["cpu"] and row["date"]
    with pytest.raises(InputError, match="no such clip"):
        clip_rows(["moonwalk"])


@pytest.mark.proof
@pytest.mark.parametrize("name", CLIPS)
def test_real_garments_on_whole_clips(name: str) -> None:
    data_path("characters")
    (row,) = clip_rows([name])
    assert row["finite"] == 1.0
    assert row["inside_s"] <= 0.5 and row["crossings_layers"] == 0.0, row
    assert row["catastrophic_frames"] == 0.0 and row["speed_over_limb"] < MAX_OVER_LIMBS, row


def test_no_length_is_right_where_the_body_goes_through_itself() -> None:
    ball, faces = icosphere(2)
    body = np.concatenate([ball, ball + [1.2, 0.0, 0.0]])
    distance = BodyDistance(np.concatenate([faces, faces + len(ball)]))
    ends = np.array(
        [[[0.6, 0.0, 0.0], [0.6, 3.0, 0.0]], [[-0.6, 0.0, 0.0], [1.8, 0.0, 0.0]], [[0.0, 0, 0], [0, 0.5, 0]]]
    )
    assert overlapping(distance, ends, body).tolist() == [True, True, False]
    assert overlapping(distance, ends[:0], body).shape == (0,)
