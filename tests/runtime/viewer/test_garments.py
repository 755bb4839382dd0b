"""The meshes of what is viewed, and the values that colour them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.io.scene import load_scene
from runtime.draw.shown_body import INSET
from runtime.viewer.colors import SCALES
from runtime.viewer.garments import FabricFactors, ShownTruth, ViewedGarment
from runtime.viewer.sources import DatabaseSource, SceneSource
from tests.runtime.viewer.views import FLAG, skirt_source

TICK = 1.0 / 60.0


@pytest.fixture(scope="module")
def garment() -> ViewedGarment:
    source = skirt_source()
    garment = source.garment(source.motions[0], source.fabrics[0], False)
    for tick in range(1, 4):
        garment.player.step(source.motions[0].pose(tick * TICK), TICK)
        garment.player.decode()
    return garment


def test_a_database_shows_coarse_smooth_and_ours(garment: ViewedGarment) -> None:
    levels = garment.player.levels
    assert list(garment.meshes) == ["coarse", "smooth", "ours"]
    assert garment.main == "ours"
    smooth = levels.subdivision.upsample(garment.player.simulation.state.position[:, :3])
    assert garment.vertices("smooth", 3) == pytest.approx(smooth, abs=1e-5)
    assert np.array_equal(garment.vertices("ours", 3), garment.player.vertices)
    for name in garment.meshes:
        assert garment.meshes[name].faces.max() < len(garment.vertices(name, 3))


@pytest.mark.parametrize("name", ["coarse", "smooth", "ours"])
@pytest.mark.parametrize("coloring", SCALES)
def test_each_colour_has_a_value_for_each_face(garment: ViewedGarment, name: str, coloring: str) -> None:
    values = garment.values(name, coloring, np.array(garment.vertices(name, 3)))
    assert values is not None and values.shape == (len(garment.meshes[name].faces),)
    assert np.isfinite(values).all()


def test_level_of_detail_is_seen_and_without_atoms_nothing_is_novel(garment: ViewedGarment) -> None:
    vertices = garment.vertices("ours", 3)
    full = garment.values("ours", "level of detail", vertices)
    garment.set_detail("no wrinkles")
    try:
        reduced = garment.values("ours", "level of detail", vertices)
        assert full is not None and reduced is not None and (full != reduced).all()
        assert garment.values("ours", "novelty", vertices) is None
        assert len(garment.kinds) == len(garment.details) + 1
    finally:
        garment.set_detail("full")


def test_stiffer_cloth_is_worn_at_once(garment: ViewedGarment) -> None:
    player = garment.player
    before = player.simulation.model.fabric
    position = player.simulation.state.position.copy()
    garment.wear(FabricFactors(bending=4.0, weight=0.5))
    try:
        fabric = player.simulation.model.fabric
        assert fabric.bend_warp == 4.0 * before.bend_warp and fabric.areal_density == 0.5 * before.areal_density
        assert fabric.stretch_warp == before.stretch_warp
        assert np.array_equal(player.simulation.state.position[:, :3], position[:, :3])
        player.step(garment.motion.pose(4 * TICK), TICK)
        assert np.isfinite(player.simulation.state.position).all()
    finally:
        garment.wear(FabricFactors())
    assert player.simulation.model.fabric == before  # factors are on the garment's own fabric, not on the last one


def test_truth_is_interpolated_and_stays_at_its_ends() -> None:
    truth = ShownTruth(np.array([2, 4]), np.array([[[0.0, 0, 0]], [[1.0, 2, 3]]], np.float32))
    assert truth.at(0.0).tolist() == truth.at(2.0).tolist() == [[0.0, 0.0, 0.0]]
    assert truth.at(3.0).tolist() == [[0.5, 1.0, 1.5]]
    assert truth.at(9.0).tolist() == [[1.0, 2.0, 3.0]]
    assert ShownTruth(np.array([2]), np.ones((1, 1, 3), np.float32)).at(5.0).tolist() == [[1.0, 1.0, 1.0]]


def test_a_recorded_truth_is_shown_in_the_place_of_the_garment() -> None:
    source = skirt_source()
    motion = source.motions[0]
    count = source.database.fine_vertex_count
    positions = np.full((2, count, 3), 1.5, np.float32)
    truth = ShownTruth(np.array([2, 4]), positions)
    garment = replace(source, truths={motion.name: truth}).garment(motion, source.fabrics[0], False)
    assert list(garment.meshes) == ["coarse", "smooth", "ours", "truth"]
    shown = garment.vertices("truth", 3) + garment.player.origin
    assert shown == pytest.approx(positions[0])
    assert garment.values("truth", "novelty", shown) is None
    assert garment.values("truth", "strain", garment.vertices("truth", 3)) is not None


def plain_source() -> DatabaseSource:
    """The skirt, of which a comparison has found that plain cloth is the better choice."""
    source = skirt_source()
    quality = {
        "cost_advantage": 0.5,
        "cost_advantage_is_at_least": 0.0,
        "plain_frame_ms": 1.0,
        "plain_substeps": 4.0,
        "plain_passes": 1.0,
        "plain_vertex_count": float(len(source.database.coarse_vertices)),
    }
    return replace(source, database=replace(source.database, quality=quality))


def test_plain_cloth_is_played_where_it_is_the_better_choice() -> None:
    source = plain_source()
    assert source.prefers_plain_cloth and "that cloth is played instead. 'play the wrinkles'" in source.notice
    assert source.wrinkles_notice.endswith("that cloth is played instead. Here the learned folds are played.")
    garment = source.garment(source.motions[0], source.fabrics[0], False)
    assert garment.player.cloth is not None
    assert np.array_equal(garment.body_faces, source.inputs.body.faces)
    inwards = np.linalg.norm(garment.body_vertices() - garment.player.interpolated()[1], axis=1)
    assert inwards.max() == pytest.approx(INSET, rel=1e-3) and (inwards == 0.0).any()  # under the skirt, and elsewhere
    assert list(garment.meshes) == ["plain cloth"] and garment.main == "plain cloth"
    assert [name for name in SCALES if garment.colors_by(name)] == ["strain", "bending", "contact"]
    values = garment.values("plain cloth", "contact", garment.vertices("plain cloth", 0))
    assert values is not None and len(values) == len(garment.meshes["plain cloth"].faces)
    assert "ours" in source.garment(source.motions[0], source.fabrics[0], True).meshes


def test_a_scene_without_a_body_is_simulated(tmp_path: Path) -> None:
    (tmp_path / "flag.toml").write_text(FLAG)
    source = SceneSource(tmp_path / "flag.toml", load_scene(tmp_path / "flag.toml"))
    garment = source.garment(None, "", False)
    assert list(garment.meshes) == ["coarse", "smooth"] and garment.main == "smooth"
    assert garment.motion is None and not len(garment.body_faces)
    strains = [garment.values(name, "strain", np.array(garment.vertices(name, 0))) for name in garment.meshes]
    coarse, smooth = (np.asarray(strain) for strain in strains)
    assert len(smooth) == len(garment.meshes["smooth"].faces)
    assert smooth.reshape(len(coarse), -1).std(axis=1).max() == 0.0 and np.array_equal(smooth[::16], coarse)
    before = garment.vertices("coarse", 0).copy()
    for _ in range(5):
        garment.player.step(None, TICK)
    garment.player.decode()
    assert np.abs(garment.vertices("coarse", 5) - before).max() > 1e-3
