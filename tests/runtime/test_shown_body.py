"""The body as it is drawn: thinner under garments, away from their rims."""

from __future__ import annotations

import numpy as np
import pytest

from assets.io.scene import parse_scene
from assets.io.sequence import Sequence
from assets.procedural.mannequin import builtin_mannequin
from pbd import ClothMesh
from runtime.draw.shown_body import FULL, INSET, RIM, depth_under_cloth, insets, shown_body
from runtime.export.free_run import posed_bodies
from runtime.play.simulation import body_source
from runtime.setup.garment_setup import GarmentSetup
from tests.wrinkles.meshes import tube

SCENE = '[[garment]]\nname = "g"\nmesh = "builtin:tshirt"\n[character]\nfile = "builtin:mannequin"\nclip = "walk"\n'


@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("layered", [False, True])
def test_what_lies_under_a_tube_is_drawn_in_but_at_its_rims(inside_out: bool, layered: bool) -> None:
    body, faces = tube(40, 0.1)
    length = float(np.ptp(body[:, 1]))
    cloth = body * [1.1, 0.8, 1.1] + [0.0, 0.1 * length, 0.0]
    mesh = ClothMesh.from_surface(cloth, faces[:, ::-1] if inside_out else faces, warp=(0.0, 1.0, 0.0))
    layer = None
    if layered:  # a short tube over it changes nothing
        short = body * [1.2, 0.3, 1.2] + [0.0, 0.3 * length, 0.0]
        both = np.concatenate([cloth, short]), np.concatenate([mesh.faces, mesh.faces + len(cloth)])
        mesh = ClothMesh.from_surface(*both, warp=(0.0, 1.0, 0.0))
        layer = np.repeat([0, 1], len(cloth))
    away = np.minimum(body[:, 1] - 0.1 * length, 0.9 * length - body[:, 1])
    depth = depth_under_cloth(mesh, layer, body, faces)
    assert (depth[away < 0.0] == 0.0).all() or np.abs(depth[away < -0.01]).max() < 0.01
    found = insets(mesh, layer, body, faces)
    step = length / 20  # vertices of cloth and body do not lie beside one another
    assert found[away > FULL + step] == pytest.approx(INSET)
    assert (found[away < RIM - step] == 0.0).all() and (found >= 0.0).all()


def test_the_trunk_under_a_tshirt_is_drawn_in_and_hands_and_legs_are_not() -> None:
    scene = parse_scene(SCENE, "shown.toml")
    levels, body = GarmentSetup.of(scene).levels, builtin_mannequin()
    shown = shown_body(body, levels)
    assert np.array_equal(shown.faces, body.faces)
    moved = np.linalg.norm(shown.vertices - body.vertices, axis=1)
    low, high = levels.coarse.vertices.min(axis=0), levels.coarse.vertices.max(axis=0)
    under = body.vertices[:, 1]
    assert moved[(under < low[1]) | (under > high[1]) | (np.abs(body.vertices[:, 0]) > high[0])].max() == 0.0
    chest = (np.abs(body.vertices[:, 0]) < 0.1) & (under > low[1] + 2 * FULL) & (under < high[1] - 2.5 * FULL)
    assert chest.sum() > 20 and moved[chest] == pytest.approx(INSET, rel=1e-3)


def test_a_sequence_is_drawn_in_as_it_is_posed() -> None:
    levels, body = GarmentSetup.of(parse_scene(SCENE, "shown.toml")).levels, builtin_mannequin()
    posed = body.vertices.astype(np.float32)
    shown = shown_body(Sequence("still", posed[None], body.faces, 1.0 / 60.0), levels)
    origin = np.array([0.0, 1.0, 0.0])
    (drawn,) = posed_bodies(shown, [body.vertices])
    assert drawn == pytest.approx(shown_body(body, levels).vertices, abs=1e-5)
    moved = np.zeros_like(posed)
    body_source(shown).skin(body.vertices + origin, origin, moved)
    assert moved == pytest.approx(drawn, abs=1e-6)
