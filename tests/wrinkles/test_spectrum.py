from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbd import ClothMesh
from tests.refusals import refuses
from tests.wrinkles.meshes import flat_sheet, turned
from wrinkles.mesh_measures import bending_energy
from wrinkles.spectrum import BandedEnergy, LowPass, spectrum_band_error_max

SIZE = 1.0


@pytest.fixture(scope="module")
def sheet() -> tuple[np.ndarray, np.ndarray]:
    return flat_sheet(81, SIZE, jitter=0.25)


@pytest.fixture(scope="module")
def banded(sheet: tuple[np.ndarray, np.ndarray]) -> BandedEnergy:
    return BandedEnergy(ClothMesh.from_surface(*sheet))


def wave(rest: np.ndarray, amplitude: float, wavelength: float) -> np.ndarray:
    """The sheet with a plane wave askew to its edges."""
    out = rest.copy()
    out[:, 1] += amplitude * np.sin(2 * np.pi / wavelength * (0.8 * rest[:, 0] + 0.6 * rest[:, 2]) + 0.3)
    return out


def middles(banded: BandedEnergy) -> np.ndarray:
    return np.sqrt(banded.cutoffs[:-1] * banded.cutoffs[1:])


def test_bands_are_octaves_from_the_mesh_to_its_size(banded: BandedEnergy) -> None:
    assert np.allclose(banded.cutoffs[1:] / banded.cutoffs[:-1], 2.0)
    assert banded.cutoffs[0] == pytest.approx(5 * SIZE / 80, rel=0.2)  # the mean edge is a little over the spacing
    assert banded.cutoffs[-1] < SIZE * 2**0.5 <= 2 * banded.cutoffs[-1]
    assert len(banded.names) == len(banded.cutoffs) + 1


@pytest.mark.parametrize("band", [1, 2, 3])
def test_a_wave_falls_in_its_octave_with_its_energy(band: int, sheet: tuple, banded: BandedEnergy) -> None:
    amplitude, wavelength = 0.002, middles(banded)[band - 1]
    energy = banded.energy(wave(sheet[0], amplitude, wavelength))[0]
    share = energy / energy.sum()
    assert share[band] > 0.75 and share.argmax() == band
    assert share[band - 1 : band + 2].sum() > 0.97
    exact = 0.25 * amplitude**2 * (2 * np.pi / wavelength) ** 4 * SIZE**2
    # A wave of seven edges loses what a mesh of straight edges cannot carry: (sin x / x)^4, x = pi / 7.
    assert energy.sum() == pytest.approx(exact, rel=0.08 if band == 1 else 0.03)
    assert banded.amplitude(energy)[band] == pytest.approx(amplitude, rel=0.15)


def test_short_waves_fall_in_the_first_band_and_the_whole_shape_in_the_last(sheet: tuple, banded: BandedEnergy) -> None:
    for band, wavelength in ((0, banded.cutoffs[0] / 2**0.5), (-1, 2.0)):
        energy = banded.energy(wave(sheet[0], 0.002, wavelength))[0]
        assert energy[band] / energy.sum() > 0.75


def test_flat_cloth_and_rigid_motion_have_no_energy(sheet: tuple, banded: BandedEnergy) -> None:
    rest = sheet[0]
    moved = turned(turned(rest, 40.0, axis=0), 65.0, axis=1) + [3.0, 1.0, -2.0]
    bent = wave(rest, 0.002, 0.1)
    reference = banded.energy(bent).sum()
    assert np.abs(banded.energy(np.stack([rest, moved]))).max() < 1e-9 * reference
    turned_bent = turned(turned(bent, 40.0, axis=0), 65.0, axis=1) + [3.0, 1.0, -2.0]
    assert np.allclose(banded.energy(turned_bent), banded.energy(bent), rtol=1e-3, atol=1e-5 * reference)


def test_a_cylinder_has_the_energy_of_its_curvature(sheet: tuple, banded: BandedEnergy) -> None:
    rest, radius = sheet[0], 0.4
    angle = rest[:, 0] / radius
    rolled = np.stack([radius * np.sin(angle), radius * np.cos(angle), rest[:, 2]], axis=1)
    assert banded.energy(rolled).sum() == pytest.approx(0.5 * SIZE**2 / radius**2, rel=0.02)


def test_many_frames_are_each_frame(sheet: tuple, banded: BandedEnergy) -> None:
    rng = np.random.default_rng(0)
    frames = sheet[0] + rng.normal(scale=1e-3, size=(40, len(sheet[0]), 3))
    energy = banded.energy(frames)
    assert energy.shape == (40, len(banded.names)) and (energy > 0).all()
    assert np.allclose(energy[35], banded.energy(frames[35])[0], rtol=1e-4)


def test_ratios_see_the_band_that_differs(sheet: tuple, banded: BandedEnergy) -> None:
    # Two waves two octaves apart with like energies; in the test the short one has twice the amplitude.
    rest = sheet[0]
    short, _, long = middles(banded)[:3]
    short_wave, long_wave = wave(rest, 0.0005, short) - rest, wave(rest, 0.0005 * (long / short) ** 2, long) - rest
    truth = banded.energy(np.stack([rest + short_wave + long_wave] * 3))
    test = banded.energy(np.stack([rest + 2 * short_wave + long_wave] * 2))
    ratios = banded.band_ratios(test, truth)
    assert ratios[banded.names[1]] == pytest.approx(4.0, rel=0.05)
    assert ratios[banded.names[3]] == pytest.approx(1.0, abs=0.05)
    assert spectrum_band_error_max(ratios) == pytest.approx(3.0, rel=0.05)
    assert spectrum_band_error_max(banded.band_ratios(truth, truth)) == 0.0
    assert spectrum_band_error_max(banded.band_ratios(0 * test, truth)) == 1.0


def test_bands_without_energy_in_the_truth_are_left_out(sheet: tuple, banded: BandedEnergy) -> None:
    truth = banded.energy(wave(sheet[0], 0.002, middles(banded)[0]))
    assert truth[0, -1] < 1e-3 * truth.sum()
    test = truth.copy()
    test[0, -1] += 0.5 * truth.sum()
    assert banded.names[-1] not in banded.band_ratios(test, truth)
    assert spectrum_band_error_max(banded.band_ratios(test, truth)) == 0.0


def test_low_pass_halves_the_amplitude_at_its_cutoff(sheet: tuple) -> None:
    # Cosines whose slope vanishes at the border are eigenvectors there: no border effect.
    rest, faces = sheet
    for halves, expected in ((2, 1.0), (10, 0.5), (30, 0.0)):
        low_pass = LowPass(ClothMesh.from_surface(rest, faces), 2 * SIZE / 10)
        field = np.cos(np.pi * halves * rest[:, 0] / SIZE)
        low = low_pass(np.stack([rest[:, 0] * 0 + 1.0, field, 0 * field], axis=1))
        assert np.allclose(low[:, 0], 1.0)
        assert low[:, 1] @ field / (field @ field) == pytest.approx(expected, abs=0.02)


def test_low_pass_filters_each_frame(sheet: tuple) -> None:
    rest, faces = sheet
    low_pass = LowPass(ClothMesh.from_surface(rest, faces), 0.2)
    frames = rest + np.random.default_rng(0).normal(scale=0.01, size=(34, len(rest), 3))
    assert np.allclose(low_pass(frames)[33], low_pass(frames[33]))


def test_bad_input_is_refused(sheet: tuple) -> None:
    rest, faces = sheet
    mesh = ClothMesh.from_surface(rest, faces)
    flat = mesh.flat * (np.arange(len(faces)) != 7)[:, None, None]
    loose = np.concatenate([rest, [[0.0, 9.0, 0.0]]])
    refuses("wavelength", LowPass, mesh, 0.0)
    refuses("without area", lambda: LowPass(replace(mesh, flat=flat), 0.2))
    refuses(f"vertex {len(rest)}", lambda: LowPass(replace(mesh, vertices=loose), 0.2))


def test_the_flat_faces_set_the_metric_and_not_the_start_shape(sheet: tuple) -> None:
    """A sewn garment starts on its body, and that shape's edges have other lengths than the pattern's."""
    rest, faces = sheet
    squeezed = rest.copy()
    squeezed[:, 0] = SIZE * (rest[:, 0] / SIZE) ** 1.5
    mesh = replace(ClothMesh.from_surface(rest, faces), vertices=squeezed)
    folded = wave(rest, 0.002, 0.1)
    expected = BandedEnergy(ClothMesh.from_surface(rest, faces))
    found = BandedEnergy(mesh)
    assert np.allclose(found.energy(folded), expected.energy(folded))
    assert found.energy(rest).sum() < 1e-6 * found.energy(folded).sum()
    assert bending_energy(rest[None], mesh)[0] < 1e-6 * bending_energy(folded[None], mesh)[0]
