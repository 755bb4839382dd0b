from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbd import Body, ClothMesh
from pbd.geometry import FAR
from tests.pbd.meshes import grid
from tests.wrinkles.meshes import flat_sheet, icosphere, tube
from wrinkles.charts import Charts, leading_vertices
from wrinkles.decoder import Decoder, Relaxation, Upsampler, surface_normals
from wrinkles.dictionary import FABRIC_COUNT, Atoms, Mapping
from wrinkles.features import DYNAMIC_COUNT, Stencil
from wrinkles.levels import Levels, build_levels
from wrinkles.patches import NODES, SIDE, Patches
from wrinkles.surface import Subdivision
from wrinkles.unfamiliarity import Unfamiliarity

NOBODY = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
THICKNESS = 0.002


def single(*shape: int, seed: int = 0, size: float = 1.0) -> np.ndarray:
    return (size * np.random.default_rng(seed).standard_normal(shape)).astype(np.float32)


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_the_upsampler_is_the_matrix(levels: int) -> None:
    vertices, faces = flat_sheet(6, 1.0, jitter=0.3)
    subdivision = Subdivision.of(faces, len(vertices), levels)
    position = single(len(vertices), 4)
    fine = single(subdivision.fine_count, 3, seed=1)
    upsample = Upsampler(subdivision)
    upsample(position, fine)
    np.testing.assert_allclose(fine, subdivision.matrix @ position[:, :3], atol=2e-6)
    np.testing.assert_allclose(upsample.middle, subdivision.to_middle @ position[:, :3], atol=2e-6)


def test_normals_of_a_sphere_point_outward() -> None:
    vertices, faces = icosphere(3)
    normals = single(len(vertices), 3)
    surface_normals((vertices * 0.2 + [0.3, -0.1, 0.5]).astype(np.float32), faces, normals)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    assert np.degrees(np.arccos(np.clip((normals * vertices).sum(axis=1), -1, 1))).max() < 1.0


class Layer:
    """A dictionary of random numbers on a crumpled tube."""

    def __init__(self) -> None:
        vertices, faces = tube(12)
        count, atoms = len(vertices), 4
        self.subdivision = Subdivision.of(faces, count, 2)
        charts = Charts.of(ClothMesh.from_surface(vertices, faces))
        self.stencil, self.patches = Stencil.of(charts, np.array([0])), Patches.of(self.subdivision, charts)
        self.middle_patches = Patches.of(self.subdivision.middle, charts)
        shapes, mean = single(atoms, 3 * NODES, size=0.01), single(3 * NODES, seed=1, size=0.01)
        self.atoms = Atoms(shapes, mean, 1.0)
        self.mapping = Mapping(
            center=single(DYNAMIC_COUNT, seed=2, size=0.3),
            scale=np.abs(single(DYNAMIC_COUNT, seed=3)),
            weights_1=single(DYNAMIC_COUNT, 9, seed=4, size=0.2),
            weights_2=single(9, 7, seed=5, size=0.4),
            weights_3=single(7, atoms, seed=6, size=0.4),
            place_bias=single(count, 9, seed=7),
            fabric_weights=single(FABRIC_COUNT, 9, seed=10),
            bias_2=single(7, seed=8),
            bias_3=single(atoms, seed=9),
        )
        self.position = single(count, 4, seed=10, size=0.01)
        self.position[:, :3] += vertices.astype(np.float32)
        self.contact = single(count, seed=12, size=0.01)

        self.unfamiliarity = Unfamiliarity(
            single(9, 3, seed=13, size=0.1), single(3, seed=14), np.abs(single(3, seed=15)), 0.2, fade_from=1e9
        )

    def decoder(self, **changes: float) -> Decoder:
        """A decoder whose wrinkles never fade, unless ``changes`` say so."""
        unfamiliarity = replace(self.unfamiliarity, **changes)
        return Decoder(self.stencil, self.patches, self.middle_patches, self.mapping, self.atoms, unfamiliarity)

    def add(self, decoder: Decoder) -> np.ndarray:
        """What the decoder adds to the fine vertices [m], shape (N, 3)."""
        fine = np.zeros((self.subdivision.fine_count, 3), np.float32)
        decoder.add(self.position, self.contact, fine, self.middle())
        return fine

    def middle(self) -> np.ndarray:
        return np.zeros((self.subdivision.middle.fine_count, 3), np.float32)


@pytest.fixture(scope="module")
def layer() -> Layer:
    return Layer()


def test_the_decoder_adds_what_the_mapping_predicts(layer: Layer) -> None:
    count = len(layer.position)
    frames, features = np.zeros((count, 9), np.float32), np.zeros((count, DYNAMIC_COUNT), np.float32)
    layer.stencil.gather(layer.position, layer.contact, frames, features)
    grids = layer.mapping.predict(features) @ layer.atoms.shapes + layer.atoms.mean
    assert np.median(grids.std(axis=0)) > 1e-3
    # Turned into space first and read afterwards, vertex by vertex.
    spatial = np.einsum("inx,ixy->iny", grids.reshape(count, NODES, 3), frames.reshape(count, 3, 3))
    p, expected = layer.patches, np.zeros((layer.subdivision.fine_count, 3))
    for i in range(len(expected)):
        for c in range(3):
            u, v = p.within[i, 2 * c : 2 * c + 2]
            node = p.cell[i, c]
            near = spatial[p.corners[i, c]][[node, node + 1, node + SIDE, node + SIDE + 1]]
            expected[i] += p.blend[i, c] * (np.array([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v]) @ near)
    added = layer.add(layer.decoder())
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(added, expected, atol=1e-5)


def test_the_decoder_adds_to_what_is_there_and_keeps_nothing(layer: Layer) -> None:
    decoder = layer.decoder()
    first = layer.add(decoder)
    fine = first.copy()
    decoder.add(2.0 * layer.position, layer.contact, fine, layer.middle())  # another state in between
    assert np.abs(fine - 2.0 * first).max() > 1e-3
    assert np.array_equal(layer.add(decoder), first)
    fine = np.full_like(first, 0.5)
    decoder.add(layer.position, layer.contact, fine, layer.middle())
    np.testing.assert_allclose(fine - 0.5, first, atol=1e-6)


def test_middle_vertices_get_what_the_fine_ones_there_get(layer: Layer) -> None:
    fine, middle = np.zeros((layer.subdivision.fine_count, 3), np.float32), layer.middle()
    layer.decoder().add(layer.position, layer.contact, fine, middle)
    np.testing.assert_allclose(middle, fine[: len(middle)], atol=1e-6)


def test_wrinkles_fade_where_the_state_is_unfamiliar(layer: Layer) -> None:
    count = len(layer.position)
    frames, features = np.zeros((count, 9), np.float32), np.zeros((count, DYNAMIC_COUNT), np.float32)
    layer.stencil.gather(layer.position, layer.contact, frames, features)
    score = layer.unfamiliarity.score(layer.mapping.hidden(features))
    middle = float(np.exp(np.median(score)))
    some, none = layer.decoder(fade_from=middle), layer.decoder(fade_from=1e-9)
    full, faded, flat = layer.add(layer.decoder()), layer.add(some), layer.add(none)
    expected = layer.unfamiliarity.amplitude(score + np.float32(np.log(1e9) - np.log(middle)))
    np.testing.assert_allclose(some.amplitude, expected, atol=1e-4)
    assert 0.4 < (some.amplitude == 1.0).mean() < 0.6 and (some.amplitude < 1.0).sum() > 20
    assert not none.amplitude.any()
    familiar = (some.amplitude[layer.patches.corners] == 1.0).all(axis=1)
    np.testing.assert_allclose(faded[familiar], full[familiar], atol=1e-6)
    # What is left is the mean patch, the same in every state.
    assert np.linalg.norm(flat, axis=1).max() <= np.linalg.norm(layer.atoms.mean.reshape(NODES, 3), axis=1).max()
    between = np.linalg.norm(faded - flat, axis=1).sum() / np.linalg.norm(full - flat, axis=1).sum()
    assert 0.4 < between < 0.95


class Cloth:
    """A flat sheet above a body, to relax."""

    def __init__(self, held: tuple = (), body: tuple[np.ndarray, np.ndarray] = NOBODY, facing: float = 1.0) -> None:
        vertices, faces = grid(8, 8, 0.03, "equilateral")
        self.levels: Levels = build_levels(vertices, faces, np.array(held, int), *NOBODY, 2)
        leading = leading_vertices(self.levels.subdivision)
        clearance = np.full(max(1, len(body[0])), THICKNESS, np.float32)
        self.relax = Relaxation(self.levels.fine, self.levels.fine_held, leading, clearance, facing)
        self.frames = np.zeros((len(vertices), 9), np.float32)
        self.frames[:, 8] = facing  # the sheet's own faces look up or down; it covers what is under it
        self.body = Body(body[1], max(1, len(body[0])))
        if len(body[0]):
            self.body.place(body[0].astype(np.float32))
        self.rest = self.levels.fine.vertices
        self.edges, self.lengths = self.levels.fine.edge_lengths()

    def __call__(self, fine: np.ndarray, targets: np.ndarray | None = None, passes: int = 1) -> np.ndarray:
        """Relaxed vertices, from contacts that were found on the way."""
        count = len(self.levels.coarse.vertices)
        nearest, contact = np.full(count, -1, np.int32), np.full(count, FAR, np.float32)
        if len(self.body.faces):
            away = np.linalg.norm(self.levels.coarse.vertices[:, None] - self.body.current, axis=2)
            nearest, contact = away.argmin(axis=1).astype(np.int32), away.min(axis=1).astype(np.float32)
        fine = fine.astype(np.float32)
        targets = np.zeros((0, 3)) if targets is None else targets
        self.relax(fine, targets, self.frames, nearest, contact, self.body, self.body.current, passes)
        return fine.astype(float)

    def strain(self, vertices: np.ndarray) -> np.ndarray:
        side = vertices[self.edges[:, 1]] - vertices[self.edges[:, 0]]
        return np.linalg.norm(side, axis=1) / self.lengths - 1.0


def test_relaxation_takes_stretch_back() -> None:
    cloth = Cloth()
    pull = lambda x: np.maximum(cloth.strain(x), 0.0).mean()  # noqa: E731
    # Of single edges at once, of the whole sheet from its rim inwards.
    noisy = cloth.rest + 5e-4 * np.random.default_rng(0).standard_normal(cloth.rest.shape)
    assert pull(cloth(noisy)) < 0.8 * pull(noisy) and pull(cloth(noisy, passes=3)) < 0.8 * pull(cloth(noisy))
    large = 1.03 * cloth.rest
    assert pull(cloth(large, passes=100)) < 0.8 * pull(cloth(large)) < 0.8 * pull(large)
    for start in (noisy, large):
        np.testing.assert_allclose(cloth(start).mean(axis=0), start.mean(axis=0), atol=1e-6)  # no vertex weighs more


def test_relaxation_does_not_push_short_edges_apart() -> None:
    cloth = Cloth()
    centre = cloth.rest.mean(axis=0)
    shrunk = (centre + 0.9 * (cloth.rest - centre)).astype(np.float32)
    assert np.array_equal(cloth(shrunk), shrunk)


def test_a_mesh_that_fits_stays() -> None:
    cloth = Cloth()
    np.testing.assert_allclose(cloth(cloth.rest), cloth.rest, atol=1e-7)
    bent = cloth.rest.copy()  # rolled up: chords are shorter than the cloth, nothing is stretched
    bent[:, 0], bent[:, 2] = 0.1 * np.sin(cloth.rest[:, 0] / 0.1), 0.1 * np.cos(cloth.rest[:, 0] / 0.1)
    np.testing.assert_allclose(cloth(bent, passes=3), bent, atol=1e-5)


def test_held_vertices_go_to_their_targets_and_others_to_them() -> None:
    cloth = Cloth(held=tuple(range(9)))
    held = cloth.levels.fine_held
    assert len(held) == 33
    targets = cloth.rest[held] + [-0.004, 0.0, 0.003]
    relaxed = cloth(cloth.rest, targets)
    assert np.array_equal(relaxed[held], targets.astype(np.float32))
    moved = np.linalg.norm(relaxed - cloth.rest, axis=1)
    ring = np.setdiff1d(cloth.edges[np.isin(cloth.edges, held).any(axis=1)], held)
    assert (moved[ring] > 5e-4).all()


def test_relaxation_pushes_vertices_out_of_the_body_and_leaves_others() -> None:
    ball, faces = icosphere(4, 0.1)
    centre = np.array([0.1, 0.13, -0.09])  # under the sheet at z = 0, which cuts 1 cm into it
    cloth = Cloth(body=(ball + centre, faces))
    start = cloth.rest + [0.0, 0.0, 0.0]
    radius = np.linalg.norm(start - centre, axis=1)
    inside = radius < 0.1
    assert 30 < inside.sum() < 500 and radius.min() < 0.091
    relaxed = cloth(start)
    after = np.linalg.norm(relaxed - centre, axis=1)
    sag = 0.1 - np.linalg.norm((ball[faces]).mean(axis=1), axis=1).min()  # faces lie inside the sphere
    assert after.min() > 0.1 + THICKNESS - sag - 1e-4
    assert after[inside].max() < 0.1 + THICKNESS + 1e-4
    away = radius > 0.1 + THICKNESS + 1e-3
    np.testing.assert_allclose(relaxed[away], start[away], atol=1e-6)
    # They go out where they are, not to somewhere else on the body.
    outward = (start[inside] - centre) / radius[inside][:, None]
    moved = relaxed[inside] - start[inside]
    assert np.linalg.norm(moved - (moved * outward).sum(axis=1, keepdims=True) * outward, axis=1).max() < 1e-3


@pytest.mark.parametrize("facing", [1.0, -1.0])
@pytest.mark.parametrize("room", [0.002, 0.0, -0.004])
def test_cloth_between_two_parts_of_a_body_ends_inside_neither(facing: float, room: float) -> None:
    """Less room than the clearances of both, or none."""
    ball, faces = icosphere(4, 0.1)
    middle, apart = np.array([0.1, 0.13, 0.0]), (0.1 + 0.5 * room) * np.array([0.3, 0.0, np.sqrt(0.91)])
    under, over = middle - apart, middle + apart
    both = np.concatenate([ball + under, ball + over]), np.concatenate([faces, faces + len(ball)])
    cloth = Cloth(body=both, facing=facing)
    nearest = np.linalg.norm(cloth.levels.coarse.vertices[:, None] - both[0].astype(np.float32), axis=2).argmin(axis=1)
    assert min((nearest < len(ball)).sum(), (nearest >= len(ball)).sum()) > 20  # each part is touched by some
    start = cloth.rest.copy()
    start[:, 2] -= 0.3 * (start[:, 0] - middle[0])  # between both, with folds that cut into them
    start[:, 2] += 0.005 * np.sin(200.0 * start[:, 0])
    relaxed = cloth(start)
    pinched = np.linalg.norm(start[:, :2] - middle[:2], axis=1) < 0.03
    sag = 0.1 - np.linalg.norm(ball[faces].mean(axis=1), axis=1).min()  # faces lie inside the sphere
    assert pinched.sum() > 30 and (np.linalg.norm(start - relaxed, axis=1)[pinched] > 1e-3).sum() > 15
    own, other = (np.linalg.norm(relaxed[pinched] - c, axis=1) - 0.1 for c in (under, over))
    assert own.min() > -sag
    nearer = np.where(np.abs(own) < np.abs(other), own, other)  # where they overlap the nearer surface counts
    assert (nearer if room < 0.0 else other).min() > -2.0 * sag
