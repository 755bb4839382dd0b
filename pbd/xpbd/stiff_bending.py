"""Bending of stiff cloth: all hinges at once, by a sparse factorisation that is made once.

One pass over the hinges lets a correction run over one hinge, so that stiff cloth comes out too soft (by about 40 %
times :func:`pass_ratio`). The energy of hinges that rest flat is 1/2 x . K x with one constant matrix K for all three
coordinates (Bergou et al. 2006, "A quadratic bending model for inextensible surfaces"), which holds for any shape of
the cloth. So an implicit step of all bending is one linear system with the same matrix in every substep, like the
global step of Bouaziz et al. 2014, "Projective Dynamics":

    x1 = x - h^2 (M + THETA k^2 K)^-1 K (x0 + DELTA (x - x0))

Here x0 is the start of the substep, x the prediction, and k the longest substep that the solver takes. A mode with
z = k^2 omega^2 keeps the part sqrt(1 - DELTA q) of its amplitude in a substep, with q = z / (1 + THETA z). So slow
modes lose the part DELTA of what they would lose by implicit Euler, and the fastest ones half in two substeps. The step
is stable for every z and every h up to k, as THETA is at least (1 + 2 DELTA) / 4.
"""

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from pbd.contact.response import substep_start
from pbd.engine import ti
from pbd.geometry import vec4, xyz
from pbd.model import Model
from pbd.xpbd.constraints import hinge_multiplier

__all__ = ["bending_factor", "bounded_hinge_data", "is_stiff", "no_factor", "pass_ratio", "solve_stiff_bending"]

THETA = 0.5  # weight of the end of the substep [-]
DELTA = 0.25  # damping of slow modes, as a part of implicit Euler's [-]
MAX_PASS_RATIO = 0.1  # at which one pass over the hinges leaves cloth 4 % too soft [-]
# A stiffer hinge is taken as this stiff, by the same ratio [-]: float32 would lose the momentum of free cloth and fling
# slivers away. A strip of 20 edges that is as stiff sags by a thousandth of its length.
STIFFEST = 1e4
HEADER = 3  # rows of the factor before its entries, for each unknown


def pass_ratio(model: Model, h: float) -> float:
    """Stiffness of the hinges times h^2 over the mass that they move, the median [-]; h [s]."""
    if not len(model.hinges):
        return 0.0
    sums, compliance = model.hinge_data[:, 1, 0].astype(float), model.hinge_data[:, 1, 1].astype(float)
    return float(np.median(sums * (h * h) / compliance))


def is_stiff(model: Model, h: float) -> bool:
    """Whether all hinges are solved at once in substeps of up to h [s].

    So it is where the fabric is stiff, one pass over the hinges would leave it too soft, and all hinges rest flat and
    without friction. Layers are of several fabrics, and keep the pass.
    """
    plain = not model.plastic_count and not model.layer.any() and not model.hinge_data[:, 1, 2].any()
    return model.stiff and plain and pass_ratio(model, h) > MAX_PASS_RATIO


def bounded_hinge_data(model: Model, h: float) -> np.ndarray:
    """``Model.hinge_data`` with each hinge no stiffer than ``STIFFEST`` allows in substeps of h [s]."""
    law = model.hinge_data[:, 1]
    compliance = np.maximum(law[:, 1], law[:, 0] * np.float32(h * h / STIFFEST))
    if np.array_equal(compliance, law[:, 1]):
        return model.hinge_data
    data = model.hinge_data.copy()
    data[:, 1, 1] = compliance
    return data


def no_factor() -> np.ndarray:
    """The factor of cloth that is not stiff."""
    return np.zeros((0, 2), np.float32)


def bending_factor(model: Model, hinge_data: np.ndarray, h: float) -> np.ndarray:
    """Sparse factors L D L^T of M + THETA h^2 K, for :func:`solve_stiff_bending`.

    Args:
        model: the garment.
        hinge_data: see :func:`bounded_hinge_data`.
        h: the longest substep [s].

    Returns:
        Shape (k, 2), float32. Three rows for each unknown in the order of elimination, and one more unknown for the
        ends: (1/D [1/kg], vertex), (0, where its row of L begins), (0, where its row of L^T begins). Then the entries
        (value, unknown) below and above the diagonal. The second column holds the bits of int32.
    """
    free = np.flatnonzero(model.inverse_mass > 0.0)
    hinges = np.arange(len(model.hinges)).repeat(4)
    rows = csr_matrix(
        (hinge_data[:, 0].ravel().astype(float), (hinges, model.hinges.ravel())),
        (len(model.hinges), model.vertex_count),
    )[:, free]
    stiffness = rows.T @ diags(1.0 / hinge_data[:, 1, 1].astype(float)) @ rows
    system = csc_matrix(diags(model.mass[free]) + THETA * h * h * stiffness)
    with threadpool_limits(1, "blas"):  # so that rounding does not depend on the number of threads
        factors = splu(system, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    order = np.argsort(factors.perm_c)  # unknown -> free vertex
    lower = csr_matrix(factors.L)
    lower.setdiag(0.0)
    lower.eliminate_zeros()
    lower.sort_indices()
    upper = csr_matrix(lower.T)
    upper.sort_indices()
    count = len(free)
    begin = HEADER * (count + 1)
    values, places = np.zeros((2, begin + 2 * lower.nnz))
    values[:begin:HEADER][:count] = 1.0 / factors.U.diagonal()
    places[:begin:HEADER][:count] = free[order]
    places[1:begin:HEADER] = begin + lower.indptr
    places[2:begin:HEADER] = begin + lower.nnz + upper.indptr
    values[begin:] = np.concatenate([lower.data, upper.data])
    places[begin:] = np.concatenate([lower.indices, upper.indices])
    return np.stack([values.astype(np.float32), places.astype(np.int32).view(np.float32)], axis=1)


@ti.func
def place(factor: ti.template(), row: ti.i32) -> ti.i32:
    """The whole number in a row of the factor."""
    return ti.bit_cast(factor[row][1], ti.i32)


@ti.func
def solve_stiff_bending(
    cloth: ti.template(), constraints: ti.template(), factor: ti.template(), work: ti.template(), h: ti.f32
):
    """Move all vertices by the bending of all hinges, right after the prediction.

    Args:
        cloth, constraints: views of the garment.
        factor: see :func:`bending_factor`.
        work: vec4 for two times all vertices; is written over.
        h: [s].
    """
    count = cloth.position.shape[0]
    for i in range(count):
        start = substep_start(cloth, i, h)
        work[i] = vec4(start + DELTA * (xyz(cloth.position_delta[i]) - start))
        work[count + i] = ti.math.vec4(0.0)
    for c in range(constraints.hinges.shape[0]):
        q = constraints.hinges[c]
        i, j, k, m = q[0], q[1], q[2], q[3]
        p0, u0 = cloth.position[i], work[i]
        d1 = (cloth.position[j] - p0) + (work[j] - u0)
        d2 = (cloth.position[k] - p0) + (work[k] - u0)
        d3 = (cloth.position[m] - p0) + (work[m] - u0)
        rows = constraints.hinge_data[c, 0]
        force = hinge_multiplier(d1, d2, d3, rows, 1.0 / constraints.hinge_data[c, 1][1])
        work[count + i] = work[count + i] + rows[0] * force
        work[count + j] = work[count + j] + rows[1] * force
        work[count + k] = work[count + k] + rows[2] * force
        work[count + m] = work[count + m] + rows[3] * force
    unknowns = (place(factor, 1) // HEADER) - 1
    for i in range(unknowns):
        row = HEADER * i
        y = work[count + place(factor, row)]
        for e in range(place(factor, row + 1), place(factor, row + HEADER + 1)):
            y -= factor[e][0] * work[place(factor, e)]
        work[i] = y
    for down in range(unknowns):
        row = HEADER * (unknowns - 1 - down)
        y = factor[row][0] * work[unknowns - 1 - down]
        for e in range(place(factor, row + 2), place(factor, row + HEADER + 2)):
            y -= factor[e][0] * work[place(factor, e)]
        work[unknowns - 1 - down] = y
        i = place(factor, row)
        cloth.position_delta[i] = vec4(xyz(cloth.position_delta[i]) + (h * h) * xyz(y))
