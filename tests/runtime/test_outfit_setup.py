"""Scenes with several garments on a body: one mesh in layers, each garment in its own fabric."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pygltflib
import pytest

from assets.fabrics import PRESETS
from assets.io.scene import parse_scene
from pbd import InputError
from runtime.cli import command
from runtime.setup.garment_mesh import pattern_of
from runtime.setup.garment_setup import GarmentSetup, fabric_of
from runtime.setup.scene_simulation import garments_of, simulation_of
from tests.assets.panels import two_panels
from tests.refusals import refuses
from tests.runtime.players import TROUSERS

SKIRT = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
fabric = "silk"
attach = "top"
subdivisions = 1
"""
REST = """
[character]
file = "builtin:mannequin"
clip = "walk"

[training]
fabrics = []

[[training.held_out]]
file = "builtin:mannequin"
clip = "walk"
end = 1.2
"""
OUTFIT = TROUSERS + SKIRT + REST


def setup_of(text: str) -> GarmentSetup:
    return GarmentSetup.of(parse_scene(text, "outfit.toml"))


@pytest.fixture(scope="module")
def setup() -> GarmentSetup:
    return setup_of(OUTFIT)


@pytest.fixture(scope="module")
def trousers() -> GarmentSetup:
    return setup_of(TROUSERS + REST)


def test_an_outfit_is_one_mesh_in_layers(setup: GarmentSetup, trousers: GarmentSetup) -> None:
    levels, alone = setup.levels, trousers.levels
    count = len(alone.coarse.vertices)
    assert setup.name == "trousers + skirt" and setup.subdivisions_of_mesh == 1
    assert levels.layers is not None and levels.layers.names == ("trousers", "skirt")
    assert levels.layers.fabrics == (PRESETS["silk"],)
    assert levels.layers.layer.tolist() == [0] * count + [1] * 624
    opened = max(one.moved for one in setup.openings)  # trousers and skirt start through one another, and are parted
    assert 0.0 < opened < 0.05 and not any(one.after for one in setup.openings)
    np.testing.assert_allclose(levels.coarse.vertices[:count], alone.coarse.vertices, atol=opened)
    np.testing.assert_allclose(levels.coarse.flat[: len(alone.coarse.faces)], alone.coarse.flat)
    fine = levels.layers.subdivided(levels.subdivision).layer
    assert (fine[levels.fine.faces] == fine[levels.fine.faces[:, :1]]).all()
    assert np.bincount(fine)[0] == len(alone.fine.vertices)


def test_a_garment_that_starts_inside_one_below_it_is_refused() -> None:
    """The message says where, how deep, and that the other order would do."""
    with pytest.raises(InputError, match="starts inside one below") as refused:
        setup_of(SKIRT + TROUSERS + REST)
    error = refused.value
    assert error.key == "garment[1].mesh" and "mm deep at (" in str(error.received)
    assert "'trousers' listed before 'skirt'" in str(error.expected)


HELD_UP = SKIRT.replace('attach = "top"', 'fasten = "top"')


@pytest.mark.proof
def test_a_garment_that_is_fastened_hangs_on_the_one_below_it_until_it_is_opened() -> None:
    sliding = TROUSERS + 'attach = "none"\n'
    setup = setup_of(sliding + HELD_UP + REST)
    model = setup.levels.model(fabric_of(setup.settings))
    v, a, b = model.stitches[model.layer[model.stitches[:, 0]] == 1].T
    across = model.layer[a] == 0
    assert across.sum() > 10 and (model.layer[b[across]] == 0).all() and (model.stitch_gaps > 0.0).sum() == across.sum()
    fine = setup.levels.model(fabric_of(setup.settings), fine=True)
    assert (fine.stitch_gaps > 0.0).sum() == 2 * across.sum()

    simulation, motion = simulation_of(parse_scene(sliding + HELD_UP + REST, "outfit.toml"))
    assert motion is not None
    top, gaps = v[across], []

    def step(frames: range) -> None:
        for frame in frames:
            simulation.step(motion.pose(frame / 60), 1 / 60)
        world, model = simulation.state.world(), simulation.model
        w = model.stitch_weights[model.stitch_gaps > 0.0, None]
        apart = (1 - w) * world[a[across]] + w * world[b[across]] - world[top]
        gaps.append((np.linalg.norm(apart, axis=1) - model.stitch_gaps[model.stitch_gaps > 0.0]).max())

    step(range(1, 40))
    assert gaps[-1] < 0.004
    simulation.fasten(1, closed=False)
    step(range(40, 75))
    assert gaps[-1] > 0.01
    simulation.fasten(1, closed=True)
    step(range(75, 76))
    assert gaps[-1] > 0.005  # it comes together and does not jump
    step(range(76, 92))
    assert gaps[-1] < 0.004


def test_what_cannot_be_fastened_is_refused() -> None:
    refuses("garment.0..fasten: nothing below", setup_of, TROUSERS + 'fasten = "top"\n' + SKIRT + REST)
    refuses("mm from the nearest one at", setup_of, TROUSERS + SKIRT + "fasten = [0, 1]\n" + REST)


@pytest.mark.proof
def test_all_garments_are_as_fine_as_the_one_that_needs_it_most() -> None:
    setup = setup_of(TROUSERS + SKIRT.replace("subdivisions = 1", "subdivisions = 2") + REST)
    assert {garment.subdivisions for garment in setup.scene.garments} == {2}
    assert len(setup.levels.subdivision.steps) == 2


@pytest.mark.parametrize("fine", [False, True])
def test_each_garment_has_its_own_fabric(setup: GarmentSetup, trousers: GarmentSetup, fine: bool) -> None:
    levels = setup.levels
    model = levels.model(PRESETS["denim"], bend_factor=1 / 3, fine=fine)
    mesh = levels.fine if fine else levels.coarse
    assert model.mesh is mesh
    for number, fabric in enumerate((PRESETS["denim"], PRESETS["silk"])):
        mine = model.layer == number
        area = mesh.vertex_cloth_areas[mine].sum()
        assert model.mass[mine].sum() == pytest.approx(fabric.areal_density * area, rel=1e-6)
    np.testing.assert_array_equal(model.held, levels.fine_held if fine else levels.coarse_held)
    assert set(model.layer[model.held].tolist()) == {0, 1}  # the trousers by their band, the skirt as it says
    alone = trousers.levels.model(PRESETS["denim"], bend_factor=1 / 3, fine=fine)
    inner = model.layer[model.hinges[:, 0]] == 0
    np.testing.assert_allclose(np.sort(model.hinge_data[inner, 1, 1]), np.sort(alone.hinge_data[:, 1, 1]), rtol=1e-5)


def test_a_plain_outfit_is_simulated() -> None:
    simulation, motion = simulation_of(parse_scene(OUTFIT, "outfit.toml"))
    assert motion is not None and simulation.model.layer.max() == 1
    start = simulation.vertices.copy()
    for frame in range(1, 11):
        simulation.step(motion.pose(frame / 60))
    moved = np.linalg.norm(simulation.vertices - start, axis=1)
    assert np.isfinite(moved).all() and 0.001 < moved.max() < 0.5


def test_the_fine_substep_is_that_of_the_finest_garment() -> None:
    """A skirt that is cut once before it is simulated and once after it, beside trousers that are cut once."""
    scene = parse_scene(TROUSERS + SKIRT + "coarse_subdivisions = 1\n" + REST, "outfit.toml")
    simulation, _ = simulation_of(scene, fine=True)
    assert simulation.solver.options.substep == pytest.approx(scene.training.substep / 4.0)


def test_the_pattern_is_that_of_all_garments() -> None:
    pattern = pattern_of(parse_scene(OUTFIT, "outfit.toml"))
    assert pattern is not None and pattern.shape == (2216 + 1176, 3, 2)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('"silk"', '"silk"\npressure = 5.0', r"garment\[1\].pressure: another pressure in an outfit"),
        ("fabrics = []", 'fabrics = ["wool"]', "training.fabrics: other fabrics of an outfit"),
        ('name = "skirt"', 'name = "trousers"', "trousers"),
        ('attach = "top"', 'attach = "top"\npins = [3]', r"garment\[1\].pins: pins beside a body"),
    ],
)
def test_what_makes_no_outfit_is_refused(old: str, new: str, problem: str) -> None:
    refuses(problem, setup_of, OUTFIT.replace(old, new))


def test_a_decimated_garment_is_refused(tmp_path: Path) -> None:
    vertices, faces, _ = two_panels(20, 20, 17)
    lines = [f"v {x} {1 + y} 0.3" for x, y, _ in vertices] + [f"vt {x} {y}" for x, y, _ in vertices]
    lines += ["f " + " ".join(f"{v + 1}/{v + 1}" for v in face) for face in faces]
    (tmp_path / "cloth.obj").write_text("\n".join(lines))
    mesh = f'"{(tmp_path / "cloth.obj").as_posix()}"\npattern = true\ncoarse_vertices = 60'
    cloth = SKIRT.replace('"builtin:skirt"', mesh).replace('attach = "top"', "")
    refuses(r"garment\[1\].coarse_vertices: a decimated mesh in an outfit", setup_of, TROUSERS + cloth + REST)


@pytest.mark.parametrize("fine", [False, True])
def test_each_garment_of_a_simulated_outfit_is_a_mesh_of_its_own(fine: bool, setup: GarmentSetup) -> None:
    scene = parse_scene(OUTFIT, "outfit.toml")
    levels = setup.levels
    model = levels.model(fabric_of(setup.settings), fine=fine)
    found = garments_of(scene, SimpleNamespace(model=model))  # pyright: ignore[reportArgumentType]
    assert found is not None and list(found) == ["trousers", "skirt"]
    layer = levels.fine_layer if fine else levels.layers and levels.layers.layer
    for number, vertices in enumerate(found.values()):
        np.testing.assert_array_equal(vertices, np.flatnonzero(layer == number))
    assert garments_of(parse_scene(SKIRT + REST, "skirt.toml"), SimpleNamespace(model=model)) is None  # pyright: ignore[reportArgumentType]


def test_a_simulated_outfit_is_written_by_garments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, out = tmp_path / "outfit.toml", tmp_path / "outfit.glb"
    path.write_text(OUTFIT, encoding="utf-8")
    monkeypatch.setattr("runtime.export.animation_baking.clip_begin", lambda motion: 0.0)
    assert command.main(["simulate", str(path), "-o", str(out), "--seconds", "0.02"]) == 0
    document = pygltflib.GLTF2().load(str(out))
    assert document is not None
    assert [mesh.name for mesh in document.meshes] == ["trousers", "skirt", "body"]
    assert [node.name for node in document.nodes[:2]] == ["trousers", "skirt"]
