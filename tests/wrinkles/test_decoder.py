from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbd import ClothMesh
from pbd.geometry import surface_normals
from tests.wrinkles.fine_surfaces import patch_sums
from tests.wrinkles.meshes import flat_sheet, icosphere, tube
from wrinkles.charts import Charts
from wrinkles.decoder import Decoder, Upsampler
from wrinkles.dictionary import Atoms, CoefficientNetwork
from wrinkles.features import DYNAMIC_COUNT, Stencil
from wrinkles.fine_surface import FineSurface
from wrinkles.novelty import NoveltyScore
from wrinkles.patches import Patches
from wrinkles.surface import Subdivision
from wrinkles.vertex_mean import turned


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
    np.testing.assert_allclose(upsample.middle[:, :3], subdivision.to_middle @ position[:, :3], atol=2e-6)


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
        size = 3 * self.patches.grid.nodes
        shapes, mean = single(atoms, size, size=0.01), single(size, seed=1, size=0.01)
        vertex_mean = single(self.subdivision.fine_count, 3, seed=11, size=0.01)
        self.atoms = Atoms(shapes, mean, 1.0, vertex_mean)
        self.mapping = CoefficientNetwork(
            center=single(DYNAMIC_COUNT, seed=2, size=0.3),
            scale=np.abs(single(DYNAMIC_COUNT, seed=3)),
            weights_1=single(DYNAMIC_COUNT, 9, seed=4, size=0.2),
            place=single(count, 4, seed=7),
            region=np.random.default_rng(16).integers(0, 3, count).astype(np.int32),
            place_weights=single(4, 9, seed=17),
            bias_1=single(9, seed=18),
            weights_2=single(3, 9, 7, seed=5, size=0.4),
            weights_3=single(3, 7, atoms, seed=6, size=0.4),
            bias_2=single(3, 7, seed=8),
            bias_3=single(3, atoms, seed=9),
        )
        self.position = single(count, 4, seed=10, size=0.01)
        self.position[:, :3] += vertices.astype(np.float32)
        self.contact = single(count, seed=12, size=0.01)

        self.novelty = NoveltyScore(
            single(9, 3, seed=13, size=0.1), single(3, seed=14), np.abs(single(3, seed=15)), 0.2, fade_from=1e9
        )

    def decoder(self, **changes: float) -> Decoder:
        """A decoder whose wrinkles never fade, unless ``changes`` say so."""
        novelty = replace(self.novelty, **changes)
        return Decoder(self.stencil, self.mapping, self.atoms, novelty)

    def add(self, decoder: Decoder) -> np.ndarray:
        """What the decoder adds to the fine vertices [m], shape (N, 3)."""
        surface = FineSurface(self.subdivision, self.patches, self.atoms.vertex_mean)
        fine, flat = (
            np.zeros((self.subdivision.fine_count, 3), np.float32),
            np.zeros((self.subdivision.middle.fine_count, 4), np.float32),
        )
        decoder.predict(self.position, self.contact)
        surface(flat, decoder.grids, decoder.frames, fine)
        return fine


@pytest.fixture(scope="module")
def layer() -> Layer:
    return Layer()


def test_the_decoder_adds_what_the_mapping_predicts(layer: Layer) -> None:
    count = len(layer.position)
    frames, features = np.zeros((count, 9), np.float32), np.zeros((count, DYNAMIC_COUNT), np.float32)
    layer.stencil.read(layer.position, layer.contact, frames, features)
    grids = layer.mapping.predict(features) @ layer.atoms.shapes + layer.atoms.mean
    assert np.median(grids.std(axis=0)) > 1e-3
    expected = patch_sums(layer.patches, grids, frames)
    assert np.abs(expected).max() > 0.01
    expected += turned(layer.patches.turning, frames, layer.atoms.vertex_mean)
    np.testing.assert_allclose(layer.add(layer.decoder()), expected, atol=1e-5)


def test_the_decoder_keeps_nothing(layer: Layer) -> None:
    decoder = layer.decoder()
    first = layer.add(decoder)
    decoder.predict(2.0 * layer.position, layer.contact)  # another state in between
    assert np.array_equal(layer.add(decoder), first)


def test_wrinkles_fade_where_the_state_is_unfamiliar(layer: Layer) -> None:
    count = len(layer.position)
    frames, features = np.zeros((count, 9), np.float32), np.zeros((count, DYNAMIC_COUNT), np.float32)
    layer.stencil.read(layer.position, layer.contact, frames, features)
    score = layer.novelty.score(layer.mapping.hidden(features))
    middle = float(np.exp(np.median(score)))
    some, none = layer.decoder(fade_from=middle), layer.decoder(fade_from=1e-9)
    full, faded, flat = layer.add(layer.decoder()), layer.add(some), layer.add(none)
    expected = layer.novelty.amplitude(score + np.float32(np.log(1e9) - np.log(middle)))
    np.testing.assert_allclose(some.amplitude, expected, atol=1e-4)
    assert 0.4 < (some.amplitude == 1.0).mean() < 0.6 and (some.amplitude < 1.0).sum() > 20
    assert not none.amplitude.any()
    familiar = (some.amplitude[layer.patches.corners] == 1.0).all(axis=1)
    np.testing.assert_allclose(faded[familiar], full[familiar], atol=1e-6)
    # What is left are the means, the same in every state.
    rest = flat - turned(layer.patches.turning, frames, layer.atoms.vertex_mean)
    assert np.linalg.norm(rest, axis=1).max() <= np.linalg.norm(layer.atoms.mean.reshape(-1, 3), axis=1).max()
    between = np.linalg.norm(faded - flat, axis=1).sum() / np.linalg.norm(full - flat, axis=1).sum()
    assert 0.4 < between < 0.95
