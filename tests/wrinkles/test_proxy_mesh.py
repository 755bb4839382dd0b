"""The mesh below the coarse one: what hangs on it lies where it did, weighs the same and keeps its momentum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.fabrics import PRESETS
from pbd import build_model
from pbd.mesh import hinges_of
from tests.assets.panels import two_panels
from tests.runtime.players import skirt_stage
from tests.wrinkles.delivered import NOBODY, bent
from wrinkles.coarsening import bind
from wrinkles.levels import Levels, build_levels
from wrinkles.proxy_mesh import ProxyMesh, proxy_mesh_of


@pytest.fixture(scope="module")
def levels() -> Levels:
    return skirt_stage().levels


@pytest.fixture(scope="module")
def proxy(levels: Levels) -> ProxyMesh:
    found = proxy_mesh_of(levels)
    assert found is not None
    return found


def test_a_third_of_the_vertices_carries_all_of_them(proxy: ProxyMesh, levels: Levels) -> None:
    count = len(levels.coarse.vertices)
    assert count / 4 < len(proxy.mesh.vertices) <= count / 3
    assert len(hinges_of(proxy.mesh.faces)) > len(proxy.mesh.vertices)
    assert np.abs(proxy.matrix.sum(axis=1) - 1.0).max() < 1e-12
    away = np.linalg.norm(proxy.matrix @ proxy.mesh.vertices - levels.coarse.vertices, axis=1)
    # Edges are 79 mm long; the skirt hangs in folds that are hardly longer than four of them.
    assert np.sqrt((away**2).mean()) < 0.005 and away.max() < 0.015


def test_masses_sum_to_the_same(proxy: ProxyMesh, levels: Levels) -> None:
    masses = [build_model(mesh, PRESETS["cotton"], bend_factor=1 / 3).mass for mesh in (proxy.mesh, levels.coarse)]
    assert masses[0].sum() == pytest.approx(masses[1].sum(), rel=1e-12)
    assert masses[0].min() > 0.0


def test_what_is_bound_comes_back_as_it_was(proxy: ProxyMesh, levels: Levels) -> None:
    """Rigid motion, momentum, and whatever the mesh below can show."""
    rng = np.random.default_rng(0)
    own = proxy.mesh.vertices + 0.01 * rng.standard_normal(proxy.mesh.vertices.shape)
    assert np.abs(proxy.inverse @ (proxy.matrix @ own) - own).max() < 1e-12
    velocity, mass = rng.standard_normal(levels.coarse.vertices.shape), levels.coarse.vertex_cloth_areas
    kept = proxy.matrix @ (proxy.inverse @ velocity)
    assert mass @ kept == pytest.approx(mass @ velocity, abs=1e-12)
    assert np.abs(proxy.matrix @ (proxy.inverse @ np.ones(len(mass))) - 1.0).max() < 1e-9


def test_what_is_held_stays_held(proxy: ProxyMesh, levels: Levels) -> None:
    top = levels.coarse.vertices[levels.coarse_held, 1].min()
    assert len(proxy.held) >= 8 and proxy.mesh.vertices[proxy.held, 1].min() > top - 0.005
    pins = np.array([5, 300])
    one = proxy_mesh_of(replace(levels, coarse_held=pins))
    assert one is not None and len(one.held) == 2
    away = np.linalg.norm(one.mesh.vertices[one.held][:, None] - levels.coarse.vertices[pins], axis=2)
    assert away.min(axis=0).max() < 0.005


def test_a_longer_metric_is_taken_over_where_it_is(levels: Levels) -> None:
    """Patterns that are draped are longer than the mesh that is drawn."""
    coarse = levels.coarse
    left = coarse.vertices[coarse.faces].mean(axis=1)[:, 0] < 0.0
    flat = coarse.flat * np.where(left, 1.2, 1.0)[:, None, None]
    longer, plain = proxy_mesh_of(replace(levels, coarse=replace(coarse, flat=flat))), proxy_mesh_of(levels)
    ratio = longer.mesh.side_lengths().mean(axis=1) / plain.mesh.side_lengths().mean(axis=1)
    side = plain.mesh.vertices[plain.mesh.faces].mean(axis=1)[:, 0]
    for there, factor in ((side < -0.15, 1.2), (side > 0.15, 1.0)):
        assert there.sum() > 40
        assert np.percentile(np.abs(ratio[there] / factor - 1.0), 90) < 0.01
    assert longer.mesh.face_areas.sum() == pytest.approx(0.5 * np.linalg.det(flat).sum(), rel=1e-12)


def test_a_delivered_garment_has_one_too() -> None:
    vertices, faces, seams = two_panels(20, 20, 17)
    for count, there in ((80, True), (45, False)):
        coarse, subdivision = bind(bent(vertices), faces, vertices[:, :2], seams, count, 2)
        held = np.flatnonzero(coarse[:, 0] < 0.02)
        made = proxy_mesh_of(
            build_levels(coarse, subdivision.coarse_faces, held, *NOBODY, 2, binding=subdivision.binding)
        )
        assert (made is not None) == there
