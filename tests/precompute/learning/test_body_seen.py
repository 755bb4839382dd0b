from __future__ import annotations

import math
import sys

import numpy as np
import pytest

from assets.io.scene import load_scene
from pbd.crossings import SelfCrossings
from precompute.learning.body_seen import BEHIND, body_seen_figures
from precompute.learning.nearest_faces import FAR, nearest_faces
from runtime.draw.picture_content import Camera
from runtime.draw.shown_body import depth_under_cloth, shown_body
from runtime.export.free_run import posed_bodies
from runtime.play.plain_surface import PlainSurface
from runtime.play.simulation import poses_of
from runtime.setup.garment_setup import GarmentSetup, fabrics_of
from runtime.setup.scene_simulation import simulation_of
from tests.data import ROOT, data_path
from tests.wrinkles.meshes import icosphere
from wrinkles.clearance import facing

SPHERE, FACES = icosphere(4, 0.5)
FRONT = Camera(np.array([0.0, 0.0, 3.0]), np.zeros(3), 30.0)


@pytest.mark.parametrize("outside", [True, False])
def test_the_nearest_faces_of_a_sphere_are_those_that_perspective_shows(outside: bool) -> None:
    faces = FACES if outside else FACES[:, ::-1]
    depth, owner = nearest_faces(SPHERE, faces, FRONT, (300, 400))
    radius = 200 * math.tan(math.asin(0.5 / 3.0)) / math.tan(math.radians(15.0))
    assert np.count_nonzero(owner) == pytest.approx(math.pi * radius**2, rel=0.01)
    assert (owner >= 0).all() if outside else (owner <= 0).all()
    shown = np.abs(owner[owner != 0]) - 1
    assert SPHERE[faces[shown]].mean(axis=1)[:, 2].min() > 0.0
    assert depth[200, 150] == pytest.approx(2.5, abs=2e-3) and depth[0, 0] == pytest.approx(FAR)
    rows, columns = np.nonzero(owner)
    assert (rows.mean(), columns.mean()) == pytest.approx((199.5, 149.5), abs=0.5)


def test_what_lies_before_and_behind_is_told_apart_and_a_face_behind_the_camera_left_out() -> None:
    triangle = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    three = np.concatenate([triangle + [0.0, 0.0, z] for z in (0.0, 1.0, 4.0)])
    depth, owner = nearest_faces(three, np.arange(9).reshape(3, 3), FRONT, (100, 100))
    assert (depth[50, 50], owner[50, 50]) == (pytest.approx(2.0), 2)


@pytest.mark.parametrize(("out", "seen"), [(-0.005, False), (0.5 * BEHIND, True), (2.0 * BEHIND, False)])
def test_a_body_counts_where_it_stands_out_of_the_front_of_the_garment(out: float, seen: bool) -> None:
    body = SPHERE * (1.0 + out / 0.5)
    frames, dressed = [(SPHERE, body, body)], np.ones(len(SPHERE), bool)
    whole = body_seen_figures(frames, FACES, FACES, dressed)
    assert whole["body_seen_px"] == whole["body_seen_whole_px"]
    assert (whole["body_seen_px"] > 1e4) == seen == (whole["body_seen_frames_percent"] == 100.0)
    inwards = body_seen_figures(frames, FACES[:, ::-1], FACES, dressed)
    assert inwards["body_seen_whole_px"] == 0.0  # the garment's inner side covers nothing
    drawn_in = body_seen_figures([(SPHERE, 0.99 * SPHERE, body)], FACES, FACES, dressed)
    assert drawn_in["body_seen_px"] == 0.0 and drawn_in["body_seen_whole_px"] == whole["body_seen_px"]
    bare = body_seen_figures(frames, FACES, FACES, ~dressed)
    assert bare["body_seen_whole_px"] == 0.0  # an arm before the garment


@pytest.mark.proof
@pytest.mark.parametrize(("name", "seconds"), [("sewn_outfit", 10.0), ("cipc_dress", 4.0)])
def test_plain_cloth_lets_no_body_through(name: str, seconds: float) -> None:
    """100 frames of an outfit and of a dress that are simulated coarse and shown fine, at rest after two passes."""
    data_path("characters/mh_female_bandai_NC.glb")
    scene = load_scene(ROOT / "docs" / "scenes" / f"{name}.toml")
    if not all(garment.mesh.exists() for garment in scene.garments):
        pytest.skip("`make scenes` has not sewn its garments")
    stage, (simulation, motion) = GarmentSetup.of(scene), simulation_of(scene)
    assert motion is not None and simulation.source is not None
    poses = poses_of(motion, 1.0 / 60.0, min(seconds, motion.duration))
    source, levels, body = simulation.source, stage.levels, simulation.body
    surface = PlainSurface(levels, next(iter(fabrics_of(scene, stage.settings).values())), None, source, 2)
    every, garments, shown, crossed = max(1, (len(poses) - 1) // 100), [], [], 0
    crossings = SelfCrossings(simulation.model.mesh)
    for number, pose in enumerate(poses[1:], 1):
        simulation.step(pose, 1.0 / 60.0)
        if number % every == 0 and len(garments) < 100:
            fine = np.zeros((levels.subdivision.fine_count, 3), np.float32)
            surface(simulation.state.position, simulation.state, body, body.current, fine)
            garments.append(fine + simulation.state.origin)
            shown.append(number)
            crossed = max(crossed, len(crossings.faces_of(crossings.find(simulation.vertices))))
    faces, layer = levels.subdivision.faces, None if levels.layers is None else levels.layers.layer
    if facing(levels.coarse, source.vertices, source.faces) < 0.0:
        faces = faces[:, ::-1]
    bodies = posed_bodies(shown_body(stage.body, levels), poses[shown]), posed_bodies(stage.body, poses[shown])
    dressed = depth_under_cloth(levels.coarse, layer, source.vertices, source.faces) > 0.0
    figures = body_seen_figures(zip(garments, *bodies, strict=True), faces, source.faces, dressed)
    sys.stdout.write(f"\n{name}: {len(shown)} frames, {crossed} faces cross at worst: {figures}\n")
    assert figures["body_seen_px"] == 0.0 and figures["body_seen_whole_px"] <= 5.0
