"""Measures wrinkles by wavelength on an irregular mesh: bending energy in octave bands, and a low-pass filter.

An irregular mesh has no Fourier transform, but it has a Laplacian L = M^-1 S (cotangent stiffness S and lumped mass M
of the rest mesh). A plane wave of wavelength w is nearly an eigenvector of L, with the eigenvalue q^2 = (2 pi / w)^2.
A function G(L) therefore filters by wavelength on any triangles. Here G is a Butterworth response,

    G_c(q) = 1 / (1 + (q / q_c)^8),

which is one half at the cut-off q_c. G_c has four simple poles in q^2, two of them conjugate to the other two, so that
it needs two sparse complex factorisations and no eigenvectors.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags

from pbd import ClothMesh
from pbd.errors import InputError
from pbd.mesh import edges_of
from wrinkles.nested_dissection import BlockSolver, Dissection

__all__ = ["BandedEnergy", "LowPass", "cotangent_laplacian", "curvature_matrix", "spectrum_band_error_max"]

_ORDER = 4  # poles of G in q^2; with four, 88 % of a wave at the middle of an octave falls in that octave
_MIN_ENERGY_SHARE = 1e-3  # of the truth's whole energy; a ratio to a band with less is not meaningful
_CHUNK_FRAMES = 64  # frames that are processed at once: enough right-hand sides for large products, and little memory


class LowPass:
    """Low-pass filter on positions: it keeps waves longer than the cut-off and halves the amplitude at the cut-off.

    At twice the cut-off wavelength 99.6 % of the amplitude remain, at half of it 0.4 %. Open borders are free: the
    normal derivative tends to zero there.

    Args:
        mesh: the cloth, whose flat faces set the metric.
        wavelength: cut-off [m].

    Raises:
        InputError: a wavelength that is not positive, a face without area or a vertex without a face.
    """

    def __init__(self, mesh: ClothMesh, wavelength: float) -> None:
        if not wavelength > 0:
            raise InputError("bad cut-off", key="wavelength", received=wavelength, expected="a positive length [m]")
        stiffness, self._mass = cotangent_laplacian(mesh)
        self._filter = _Butterworth(stiffness, self._mass, wavelength, Dissection(stiffness), np.complex128)

    def __call__(self, vertices: np.ndarray) -> np.ndarray:
        """Filtered positions [m], of the shape of the input.

        Args:
            vertices: positions [m], shape (f, n, 3), or (n, 3) for one frame.
        """
        frames = np.asarray(vertices, float).reshape(-1, *np.shape(vertices)[-2:])
        out = np.zeros_like(frames)
        for start in range(0, len(frames), _CHUNK_FRAMES):
            points = frames[start : start + _CHUNK_FRAMES].transpose(1, 0, 2)
            low = self._filter.apply(self._mass[:, None] * points.reshape(len(points), -1))
            out[start : start + _CHUNK_FRAMES] = low.reshape(points.shape).transpose(1, 0, 2)
        return out.reshape(np.shape(vertices))


class BandedEnergy:
    """Bending energy of a mesh in octave bands of wavelength.

    With the curvature vector y = L x, the bending energy is 1/2 int |y|^2 per unit of bending stiffness. Its part at
    wavelengths over a cut-off is 1/2 int y . G_c y, and a band is the difference of two such parts: all bands are
    positive, and their sum is exactly the whole energy. The first band contains all shorter waves (mesh noise), and
    the last all longer ones. Rest angles are zero, so that the start shape's own curvature counts.

    L is that of the flat faces. With the metric of a start shape in space that is not isometric to them, L x has a part
    in the cloth's plane, where nothing is bent.

    Curvature is that of :func:`curvature_matrix`.

    Args:
        mesh: the cloth, whose flat faces set the metric.

    Attributes:
        cutoffs: wavelengths between the bands [m], shape (b - 1,), octaves: the first is 5 mean edge lengths, and the
            last is below the diagonal of the start shape's bounding box by an octave or less.
        names: of the b bands, shortest wavelengths first, such as "72-144 mm".

    Raises:
        InputError: a face without area or a vertex without a face.
    """

    def __init__(self, mesh: ClothMesh) -> None:
        shortest = 5.0 * mesh.edge_lengths()[1].mean()
        octaves = np.log2(np.linalg.norm(np.ptp(mesh.vertices, axis=0)) / shortest)
        self.cutoffs = shortest * 2.0 ** np.arange(max(int(np.ceil(octaves)), 1))
        millimetres = [f"{1e3 * length:.3g}" for length in self.cutoffs]
        between = [f"{a}-{b} mm" for a, b in zip(millimetres[:-1], millimetres[1:], strict=True)]
        self.names = (f"under {millimetres[0]} mm", *between, f"over {millimetres[-1]} mm")

        stiffness, self._mass = cotangent_laplacian(mesh)
        self._curvature = curvature_matrix(mesh)
        # Single precision halves the time and costs 1e-5 of a band's energy.
        order = Dissection(stiffness)
        self._filters = [_Butterworth(stiffness, self._mass, length, order, np.complex64) for length in self.cutoffs]

    def energy(self, vertices: np.ndarray, where: np.ndarray | None = None) -> np.ndarray:
        """Bending energy in each band, per unit of bending stiffness [-], shape (f, b).

        Args:
            vertices: positions [m], shape (f, n, 3).
            where: bool, shape (n,); curvature counts at these vertices only. None counts all.
        """
        counted = np.ones(len(self._mass)) if where is None else np.asarray(where, float)
        frames = np.asarray(vertices, float).reshape(-1, len(self._mass), 3)
        parts = (frames[start : start + _CHUNK_FRAMES] for start in range(0, len(frames), _CHUNK_FRAMES))
        return np.concatenate([self._energy_of_part(part, counted) for part in parts])

    def amplitude(self, energy: np.ndarray) -> np.ndarray:
        """Amplitude of a plane wave over the whole mesh that has the energy of the band [m], shape of the energies.

        The wave has the band's middle wavelength; for the two open bands, half an octave beyond their only limit. Its
        amplitude is a = sqrt(4 E / A) / q^2, because its mean squared curvature is a^2 q^4 / 2.

        Args:
            energy: as :meth:`energy` gives, shape (..., b).
        """
        limits = np.concatenate([self.cutoffs[:1] / 2.0, self.cutoffs, self.cutoffs[-1:] * 2.0])
        wave_numbers = 2.0 * np.pi / np.sqrt(limits[:-1] * limits[1:])
        return np.sqrt(4.0 * np.maximum(energy, 0.0) / self._mass.sum()) / wave_numbers**2

    def band_ratios(self, test_energy: np.ndarray, truth_energy: np.ndarray) -> dict[str, float]:
        """Mean energy of the test over that of the truth, by band name [-].

        Bands with under 0.1 % of the truth's energy are left out, because a ratio to almost zero is not meaningful.

        Args:
            test_energy: as :meth:`energy` gives, shape (f, b).
            truth_energy: the same of the truth, shape (g, b); the sequences may differ in length.
        """
        test, truth = np.mean(test_energy, axis=0), np.mean(truth_energy, axis=0)
        counted = truth > _MIN_ENERGY_SHARE * truth.sum()
        return {self.names[band]: float(test[band] / truth[band]) for band in np.flatnonzero(counted)}

    def _energy_of_part(self, frames: np.ndarray, counted: np.ndarray) -> np.ndarray:
        """Bending energy in each band of a few frames, shape (f, n, 3) to (f, b)."""
        curvature = counted[:, None] * (self._curvature @ frames.transpose(1, 0, 2).reshape(len(self._mass), -1))
        weighted = self._mass[:, None] * curvature
        columns = [(weighted * curvature).sum(axis=0), *(low_pass.kept(weighted) for low_pass in self._filters)]
        total, *over = (0.5 * column.reshape(-1, 3).sum(axis=1) for column in columns)
        # The larger the cut-off, the less energy remains above it; each band is the difference to the next cut-off.
        return -np.diff(np.stack([total, *over, np.zeros_like(total)], axis=1), axis=1)


def spectrum_band_error_max(band_ratios: Mapping[str, float]) -> float:
    """Largest |test / truth - 1| over the bands [-]; 1 where a band has lost all of its energy, nan without bands.

    Args:
        band_ratios: as :meth:`BandedEnergy.band_ratios` gives.
    """
    return max((abs(ratio - 1.0) for ratio in band_ratios.values()), default=float("nan"))


class _Butterworth:
    """G(L) = 1 / (1 + (L / q_c^2)^m), by partial fractions.

    G = (2/m) Re sum of (1 - L / (q_c^2 z_j))^-1 over the roots z_j of z^m = -1 in the upper half plane.

    Args:
        stiffness: S, shape (n, n).
        mass: diagonal of M [m2], shape (n,).
        wavelength: cut-off [m].
        order: of elimination, for the pattern of S.
        dtype: complex type in which systems are solved.
    """

    def __init__(
        self, stiffness: csc_matrix, mass: np.ndarray, wavelength: float, order: Dissection, dtype: type
    ) -> None:
        roots = np.exp(1j * np.pi * (2 * np.arange(_ORDER // 2) + 1) / _ORDER)
        scale = (wavelength / (2.0 * np.pi)) ** 2
        # After rotation in the complex plane by half the root's angle, the matrix has a positive definite real part, so
        # no pivoting is needed (Higham 1998, "Factorizing complex symmetric matrices with positive definite real and
        # imaginary parts").
        self._solvers = [
            BlockSolver(csc_matrix(diags(mass) - (scale / root) * stiffness), order, dtype) for root in roots
        ]

    def apply(self, weighted: np.ndarray) -> np.ndarray:
        """G times a field, given the field times the mass: real, shape (n, k)."""
        return (2.0 / _ORDER) * sum((np.real(solver.solve(weighted)) for solver in self._solvers), np.zeros(()))

    def kept(self, weighted: np.ndarray) -> np.ndarray:
        """Integral of a field times G times the field, given the field times the mass: real, shape (k,)."""
        return (2.0 / _ORDER) * sum((np.real(solver.quadratic(weighted)) for solver in self._solvers), np.zeros(()))


def cotangent_laplacian(mesh: ClothMesh) -> tuple[csc_matrix, np.ndarray]:
    """Cotangent stiffness of the flat faces, shape (n, n), and lumped mass: mixed Voronoi areas [m2], shape (n,).

    Meyer et al. 2003, "Discrete differential-geometry operators for triangulated 2-manifolds". With thirds of the face
    areas 5 % of a long wave's energy would leak into the shortest band where valences vary; with these areas 0.5 % do.
    """
    faces, count = np.asarray(mesh.faces), len(mesh.vertices)
    corners = np.concatenate([np.zeros((len(faces), 1, 2)), np.swapaxes(mesh.flat, 1, 2)], axis=1)
    area = mesh.face_areas
    if not np.all(area > 1e-14):
        face = int(np.argmin(np.nan_to_num(area)))
        raise InputError("face without area", key=f"face {face}", received=float(area[face]), expected="over 1e-14 m2")
    rows, columns, values = [], [], []
    cotangents, of_edge = np.zeros((2, len(faces), 3))
    for k in range(3):
        i, j = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        to_i, to_j = (corners[:, (k + n) % 3] - corners[:, k] for n in (1, 2))
        cotangents[:, k] = np.einsum("fi,fi->f", to_i, to_j) / (2.0 * area)
        of_edge[:, k] = cotangents[:, k] * ((to_i - to_j) ** 2).sum(axis=1) / 8.0  # half of it to each end
        half = 0.5 * cotangents[:, k]
        rows += [i, j, i, j]
        columns += [j, i, i, j]
        values += [-half, -half, half, half]
    share = np.roll(of_edge, -1, axis=1) + np.roll(of_edge, -2, axis=1)
    obtuse = cotangents < 0
    share = np.where(obtuse.any(axis=1)[:, None], np.where(obtuse, 0.5, 0.25) * area[:, None], share)
    mass = np.bincount(faces.ravel(), weights=share.ravel(), minlength=count)
    if not np.all(mass > 0):
        raise InputError("vertex without a face", key=f"vertex {int(np.argmin(mass))}")
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return csc_matrix(entries, shape=(count, count)), mass


def curvature_matrix(mesh: ClothMesh) -> csr_matrix:
    """Matrix that gives the curvature vectors L x of positions x [1/m2], shape (n, n).

    At an open border L x is a boundary force and no curvature; border vertices take the mean of their inner neighbours.

    Raises:
        InputError: as for :func:`cotangent_laplacian`.
    """
    stiffness, mass = cotangent_laplacian(mesh)
    edges, side_edge = edges_of(mesh.faces)
    border = np.unique(edges[np.bincount(side_edge.ravel()) == 1])
    return _extrapolation(edges, border, len(mass)) @ diags(1.0 / mass) @ stiffness


def _extrapolation(edges: np.ndarray, border: np.ndarray, count: int) -> csr_matrix:
    """Matrix that keeps inner values and gives border vertices the mean of their inner neighbours, shape (n, n).

    A border vertex without inner neighbours gets zero.

    Args:
        edges: int, shape (e, 2).
        border: vertices of the border, int, shape (k,).
        count: number of vertices n.
    """
    outer = np.zeros(count, bool)
    outer[border] = True
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[outer[both[:, 0]] & ~outer[both[:, 1]]]
    share = 1.0 / np.maximum(np.bincount(both[:, 0], minlength=count), 1)
    inner = np.flatnonzero(~outer)
    rows, columns = np.concatenate([both[:, 0], inner]), np.concatenate([both[:, 1], inner])
    values = np.concatenate([share[both[:, 0]], np.ones(len(inner))])
    return csr_matrix((values, (rows, columns)), shape=(count, count))
