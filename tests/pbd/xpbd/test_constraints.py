"""Constraint functions against independent solutions in float64: numpy, finite differences, the definitions."""

import numpy as np
import pytest
from scipy.optimize import brentq

from pbd.contact.corrections import PUSH_OUT, contact_correction, tether_correction
from pbd.engine import ti
from pbd.fabric import stiffening_stress
from pbd.xpbd.constraints import (
    FRICTION_STIFFNESS,
    MIN_OPENING,
    bent_hinge,
    drag_velocity,
    hinge_multiplier,
    hinge_normal,
    membrane_multipliers,
    stiffened,
    stitch_multiplier,
)
from tests.pbd.meshes import turn

vec3 = ti.math.vec3
Rows = ti.types.ndarray(dtype=ti.f32, ndim=2)
COUNT = 200


# -- Kernels that call the functions on rows of numbers --------------------------------------------------------------


@ti.func
def three(rows: ti.template(), c: ti.i32, first: ti.i32):
    return vec3(rows[c, first], rows[c, first + 1], rows[c, first + 2])


@ti.func
def four(rows: ti.template(), c: ti.i32, first: ti.i32):
    return ti.math.vec4(rows[c, first], rows[c, first + 1], rows[c, first + 2], rows[c, first + 3])


@ti.kernel
def membrane_rows(sides: Rows, data: Rows, compression_scale: ti.f32, out: Rows):
    for c in range(sides.shape[0]):
        g, _ = membrane_multipliers(
            three(sides, c, 0), three(sides, c, 3), four(data, c, 0), three(data, c, 4), four(data, c, 7), data[c, 11],
            compression_scale, vec3(0.0), 0.0, 0.0, False,
        )  # fmt: skip
        for a, b in ti.static(ti.ndrange(3, 2)):
            out[c, 2 * a + b] = g[a, b]


@ti.kernel
def stiffened_rows(sides: Rows, data: Rows, laws: Rows, strains: Rows, out: Rows):
    for c in range(sides.shape[0]):
        compliance, borne = stiffened(
            three(sides, c, 0), three(sides, c, 3), four(data, c, 0), three(data, c, 4), four(data, c, 7),
            four(laws, c, 0), three(strains, c, 0),
        )  # fmt: skip
        for a in ti.static(range(4)):
            out[c, a] = compliance[a]
        for a in ti.static(range(3)):
            out[c, 4 + a] = borne[a]


@ti.kernel
def rubbing_rows(sides: Rows, data: Rows, coarse: Rows, friction: Rows, out: Rows):
    for c in range(sides.shape[0]):
        g, kept = membrane_multipliers(
            three(sides, c, 0), three(sides, c, 3), four(data, c, 0), three(data, c, 4), four(data, c, 7), data[c, 11],
            1.0, three(coarse, c, 0), friction[c, 0], friction[c, 1], True,
        )  # fmt: skip
        for a, b in ti.static(ti.ndrange(3, 2)):
            out[c, 2 * a + b] = g[a, b]
        out[c, 6] = kept


@ti.kernel
def hinge_multipliers(differences: Rows, rows: Rows, inverse_sum: Rows, out: Rows):
    for c in range(differences.shape[0]):
        d1, d2, d3 = three(differences, c, 0), three(differences, c, 3), three(differences, c, 6)
        m = hinge_multiplier(d1, d2, d3, four(rows, c, 0), inverse_sum[c, 0])
        for a in ti.static(range(3)):
            out[c, a] = m[a]


@ti.kernel
def bent_hinges(differences: Rows, rows: Rows, rest: Rows, out: Rows):
    for c in range(differences.shape[0]):
        d1, d2, d3 = three(differences, c, 0), three(differences, c, 3), three(differences, c, 6)
        bent = rows[c, 1] * d1 + rows[c, 2] * d2 + rows[c, 3] * d3
        normal, length, least = hinge_normal(d1, d2 - d3)
        m, p, q = bent_hinge(d1, d2 - d3, bent, normal, length, least, rest[c, 0], 1.0)
        for a in ti.static(range(3)):
            out[c, a] = rows[c, 0] * m[a] - p[a]
            out[c, 3 + a] = rows[c, 1] * m[a] + p[a]
            out[c, 6 + a] = rows[c, 2] * m[a] + q[a]
            out[c, 9 + a] = rows[c, 3] * m[a] - q[a]


@ti.kernel
def tethers(offsets: Rows, lengths: Rows, out: Rows):
    for c in range(offsets.shape[0]):
        m = tether_correction(vec3(offsets[c, 0], offsets[c, 1], offsets[c, 2]), lengths[c, 0])
        for a in ti.static(range(3)):
            out[c, a] = m[a]


@ti.kernel
def stitches(to_a: Rows, to_b: Rows, weights: Rows, inverse: Rows, out: Rows):
    for c in range(to_a.shape[0]):
        a, b = vec3(to_a[c, 0], to_a[c, 1], to_a[c, 2]), vec3(to_b[c, 0], to_b[c, 1], to_b[c, 2])
        m = stitch_multiplier(a, b, weights[c, 0], inverse[c, 0], inverse[c, 1], inverse[c, 2])
        for k in ti.static(range(3)):
            out[c, k] = m[k]


@ti.kernel
def contacts(gaps: Rows, normals: Rows, slips: Rows, friction: ti.f32, h: ti.f32, out: Rows):
    for c in range(gaps.shape[0]):
        m = contact_correction(gaps[c, 0], three(normals, c, 0), three(slips, c, 0), friction, h)
        for a in ti.static(range(3)):
            out[c, a] = m[a]


@ti.kernel
def drags(velocities: Rows, normals: Rows, factors: Rows, out: Rows):
    for c in range(velocities.shape[0]):
        m = drag_velocity(three(velocities, c, 0), three(normals, c, 0), factors[c, 0])
        for a in ti.static(range(3)):
            out[c, a] = m[a]


def call(kernel, *rows, width: int = 3) -> np.ndarray:
    out = np.zeros((len(rows[0]), width), np.float32)
    kernel(*(np.ascontiguousarray(r, np.float32) if isinstance(r, np.ndarray) else r for r in rows), out)
    return out.astype(float)


# -- Membrane --------------------------------------------------------------------------------------------------------


class Triangles:
    """Random triangles in random fabrics, and the exact XPBD correction of their three strains."""

    def __init__(self, seed: int, deform: float, free_corners: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.flat = 0.05 * (np.eye(2) + rng.uniform(-0.3, 0.3, (COUNT, 2, 2)))
        self.inverse = np.linalg.inv(self.flat)
        # Flat triangle in space, deformed in the plane and out of it, then turned and moved.
        shape = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0]
        bent = (np.eye(3) + rng.uniform(-deform, deform, (COUNT, 3, 3)))[:, :, :2] @ self.flat
        self.sides = shape @ bent  # (c, 3, 2)
        self.weight = rng.uniform(0.2, 5.0, (COUNT, 3)) * 1e4
        self.weight[:, free_corners:] = 0.0
        root = rng.normal(size=(COUNT, 2, 2))
        self.alpha = np.zeros((COUNT, 3, 3))
        self.alpha[:, :2, :2] = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
        self.alpha[:, 2, 2] = rng.uniform(0.1, 3.0, COUNT)
        # Beside w b b^T, about 1e7, it is (edge / (h c))^2 with c the speed of sound: 1e-3 for 1 cm, 1/1200 s, 400 m/s.
        self.alpha *= 10.0 ** rng.uniform(4.0, 8.0, (COUNT, 1, 1))

    def corners(self) -> np.ndarray:
        return np.concatenate([np.zeros((COUNT, 1, 3)), self.sides.transpose(0, 2, 1)], axis=1)

    def strains(self, corners: np.ndarray) -> np.ndarray:
        """The definition: |w_u| - 1, |w_v| - 1 and the cosine between w_u and w_v; shape (c, 3)."""
        sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        w = sides @ self.inverse
        length = np.linalg.norm(w, axis=1)
        return np.concatenate([length - 1.0, np.prod(w / length[:, None, :], axis=2).sum(axis=1)[:, None]], axis=1)

    def gradients(self) -> np.ndarray:
        """By central differences in float64: shape (c, 3 strains, 3 corners, 3)."""
        x, step = self.corners(), 1e-7
        out = np.zeros((COUNT, 3, 3, 3))
        for corner in range(3):
            for axis in range(3):
                for sign in (1.0, -1.0):
                    moved = x.copy()
                    moved[:, corner, axis] += sign * step
                    out[:, :, corner, axis] += sign * self.strains(moved) / (2.0 * step)
        return out

    def exact(self) -> np.ndarray:
        """Corrections of the corners [m], shape (c, 3, 3): -W J^T (J W J^T + alpha/h^2)^-1 C."""
        jacobian = self.gradients()
        weighted = jacobian * self.weight[:, None, :, None]
        system = np.einsum("cakx,cbkx->cab", jacobian, weighted) + self.alpha
        multiplier = -np.linalg.solve(system, self.strains(self.corners())[:, :, None])
        return np.einsum("cakx,ca->ckx", weighted, multiplier[:, :, 0])

    def rubbing(self, coarse: np.ndarray, slips_at: np.ndarray, plastic: np.ndarray) -> tuple[np.ndarray, ...]:
        """The same with friction of shear; the plastic shear after it; and whether it slipped.

        The element is found by trying: stuck, and where its force is too great, with the force at which it slips.
        """
        jacobian, strains, k = self.gradients(), self.strains(self.corners()) - coarse, FRICTION_STIFFNESS
        weighted = jacobian * self.weight[:, None, :, None]
        system = np.einsum("cakx,cbkx->cab", jacobian, weighted)

        def solve(softness: float, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            alpha, left = self.alpha.copy(), strains.copy()
            alpha[:, 2, 2] *= softness
            left[:, 2] = strains[:, 2] + coarse[:, 2] - rest
            multiplier = -np.linalg.solve(system + alpha, left[:, :, None])[:, :, 0]
            return multiplier, rest - alpha[:, 2, 2] * multiplier[:, 2]

        stuck, shear = solve(1.0 / (1.0 + k), (coarse[:, 2] + k * plastic) / (1.0 + k))
        slips = k * np.abs(shear - plastic) > slips_at
        slipping = np.sign(shear - plastic) * slips_at
        loose, slid = solve(1.0, coarse[:, 2] - slipping)
        multiplier = np.where(slips[:, None], loose, stuck)
        after = np.where(slips, slid - slipping / k, plastic)
        return np.einsum("cakx,ca->ckx", weighted, multiplier), after, slips

    def solved(self, compression_scale: float = 1.0) -> np.ndarray:
        """What the function gives for the corners [m], shape (c, 3, 3)."""
        rows, sides, data = self.data()
        g = call(membrane_rows, sides, data, compression_scale, width=6).reshape(-1, 3, 2)
        return self.weight[:, :, None] * np.einsum("ckb,cxb->ckx", rows, g)

    def rubbed(self, coarse: np.ndarray, friction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same with friction of shear, and the plastic shear after it."""
        rows, sides, data = self.data()
        found = call(rubbing_rows, sides, data, coarse, friction, width=7)
        g = found[:, :6].reshape(-1, 3, 2)
        return self.weight[:, :, None] * np.einsum("ckb,cxb->ckx", rows, g), found[:, 6]

    def data(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows b of the corners, and the function's arguments: sides, and all else."""
        rows = np.concatenate([-self.inverse.sum(axis=1, keepdims=True), self.inverse], axis=1)  # (c, corner, 2)
        gram = np.einsum("ck,cka,ckb->cab", self.weight, rows, rows)
        unit = 1.0 / np.trace(gram, axis1=1, axis2=2)
        system = np.stack([gram[:, 0, 0], gram[:, 0, 1], gram[:, 1, 1]], axis=1)
        soft = np.stack([self.alpha[:, a, b] for a, b in ((0, 0), (0, 1), (1, 1), (2, 2))], axis=1)
        data = np.concatenate([self.inverse.reshape(-1, 4), system * unit[:, None], soft * unit[:, None]], axis=1)
        data = np.concatenate([data, unit[:, None]], axis=1)
        return rows, self.sides.transpose(0, 2, 1).reshape(-1, 6), data


def test_a_stiff_triangle_whose_held_corners_are_in_one_point_keeps_its_free_one_near() -> None:
    """Warp and weft lie along each other, and shear changes nothing: float32 left less than nothing of its row."""
    some = Triangles(5, 0.2)
    some.weight[:, :2] = 0.0
    some.alpha *= 1e-12
    some.sides[:, :, 0] = 0.0
    found = some.solved()
    moved, side = np.linalg.norm(found[:, 2], axis=1), np.linalg.norm(some.sides[:, :, 1], axis=1)
    assert np.isfinite(found).all() and (moved < 10.0 * side).all()  # soft cloth moves by 2.5 sides


def stiffened_by(strain: float, law: np.ndarray, softness: float, borne: float) -> tuple[np.ndarray, np.ndarray]:
    """Compliance and strain of the coarser levels of 200 triangles that the warp is stretched by; mobility is 1."""
    sides = np.tile([1.0 + strain, 0.0, 0.0, 0.0, 0.99, 0.0], (COUNT, 1))
    data = np.tile([1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, softness, -0.2 * softness, 2.0 * softness, softness], (COUNT, 1))
    laws = np.tile([*law, *law], (COUNT, 1))
    out = call(stiffened_rows, sides, data, laws, np.tile([borne, 0.0, 0.0], (COUNT, 1)), width=7)[0]
    return out[:4], out[4:]


@pytest.mark.parametrize("strain", [0.05, 0.15, 0.5])
@pytest.mark.parametrize("softness", [0.05, 1.0, 50.0])
@pytest.mark.parametrize("borne", [0.0, 0.02])
def test_a_stiffened_triangle_has_the_tension_at_which_its_substep_ends(
    strain: float, softness: float, borne: float
) -> None:
    """The warp alone: c + (g/alpha) (c + s(c) - e) = strain, and tension by the secant at c; the weft is slack."""
    law = np.array([10.0, 40.0])
    ends = brentq(lambda c: c + (c + stiffening_stress(np.array(c), law)[1] - borne) / softness - strain, 0.0, strain)
    ratio = float(stiffening_stress(np.array(ends), law)[1]) / ends
    plain = softness * np.array([[1.0, -0.2], [-0.2, 2.0]])
    stiff = np.linalg.inv(np.linalg.inv(plain) + np.diag([ratio / softness, 0.0]))
    found, left = stiffened_by(strain, law, softness, borne)
    assert found == pytest.approx([stiff[0, 0], stiff[0, 1], stiff[1, 1], softness], rel=5e-3)
    assert left == pytest.approx([*(stiff @ np.linalg.inv(plain) @ [borne, 0.0]), 0.0], rel=5e-3, abs=1e-6)


def test_a_slack_triangle_and_a_fabric_that_does_not_stiffen_keep_their_bits() -> None:
    for strain, law in ((-0.1, np.array([10.0, 40.0])), (0.1, np.zeros(2))):
        found, left = stiffened_by(strain, law, 0.7, 0.03)
        assert np.array_equal(found, np.float32([0.7, -0.2 * 0.7, 1.4, 0.7]))
        assert np.array_equal(left, np.float32([0.03, 0.0, 0.0]))


@pytest.mark.parametrize("deform", [0.01, 0.3])
@pytest.mark.parametrize("free_corners", [1, 2, 3])
def test_the_membrane_solves_its_three_strains_together(deform: float, free_corners: int) -> None:
    triangles = Triangles(int(100 * deform), deform, free_corners)
    exact, solved = triangles.exact(), triangles.solved()
    error = np.abs(solved - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))
    assert error.max() < 1e-3
    assert np.median(error) < 1e-5


def test_friction_of_shear_is_solved_with_the_three_strains() -> None:
    triangles, rng = Triangles(3, 0.05), np.random.default_rng(1)
    coarse, plastic = rng.uniform(-0.01, 0.01, (COUNT, 3)), rng.uniform(-0.05, 0.05, COUNT)
    slips_at = rng.uniform(0.0, 0.1, COUNT)
    exact, after, slips = triangles.rubbing(coarse, slips_at, plastic)
    assert 0.2 < slips.mean() < 0.8
    solved, kept = triangles.rubbed(coarse, np.stack([slips_at, plastic], axis=1))
    error = np.abs(solved - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))
    assert error.max() < 1e-3
    assert np.median(error) < 1e-5
    assert kept == pytest.approx(after, abs=1e-5)


def test_friction_of_no_force_is_no_friction() -> None:
    triangles = Triangles(4, 0.05)
    solved, _ = triangles.rubbed(np.zeros((COUNT, 3)), np.zeros((COUNT, 2)))
    assert solved == pytest.approx(triangles.solved(), rel=1e-4, abs=1e-7)


def test_a_triangle_at_rest_is_left_alone_however_it_is_turned() -> None:
    triangles = Triangles(7, 0.0)
    triangles.sides = np.linalg.qr(np.random.default_rng(7).normal(size=(COUNT, 3, 3)))[0][:, :, :2] @ triangles.flat
    assert np.abs(triangles.solved()).max() < 2e-7 * 0.05 * 5


def test_turning_a_triangle_turns_its_correction() -> None:
    triangles = Triangles(8, 0.2)
    before = triangles.solved()
    rotation = turn((1.0, -2.0, 0.5), 123.0)
    triangles.sides = rotation @ triangles.sides
    after = triangles.solved()
    assert np.abs(after - before @ rotation.T).max() < 1e-4 * np.abs(before).max()


def test_the_membrane_keeps_momentum() -> None:
    triangles = Triangles(9, 0.2)
    impulse = triangles.solved() / triangles.weight[:, :, None]
    scale = np.abs(impulse).max(axis=(1, 2))
    assert (np.abs(impulse.sum(axis=1)).max(axis=1) / scale).max() < 1e-6
    # Internal forces have no moment at the positions where they act.
    moment = np.cross(triangles.corners(), impulse).sum(axis=1)
    assert (np.abs(moment).max(axis=1) / (0.05 * scale)).max() < 1e-5


def test_the_scale_softens_what_is_compressed_and_nothing_else() -> None:
    triangles = Triangles(10, 0.2)
    strains = triangles.strains(triangles.corners())
    stretched = (strains[:, :2] > 0).all(axis=1)
    plain, soft = triangles.solved(1.0), triangles.solved(50.0)
    assert stretched.any() and np.array_equal(plain[stretched], soft[stretched])
    short = np.flatnonzero((strains[:, :2] < 0).all(axis=1))
    triangles.alpha[:, [0, 1], [0, 1]] *= 50.0
    assert short.size and soft[short] == pytest.approx(triangles.exact()[short], rel=1e-3, abs=1e-7)


@pytest.mark.parametrize("edge", [1e-4, 1e-3, 1.0, 100.0])
def test_the_membrane_works_at_any_size(edge: float) -> None:
    triangles = Triangles(11, 0.1)
    size = edge / 0.05
    triangles.flat, triangles.inverse = triangles.flat * size, triangles.inverse / size
    triangles.sides = triangles.sides * size
    triangles.weight, triangles.alpha = triangles.weight / size**2, triangles.alpha / size**4
    solved, first = triangles.solved() / size, Triangles(11, 0.1).solved()
    assert np.abs(solved - first).max() < 1e-4 * np.abs(first).max()


@pytest.mark.parametrize("shape", ["point", "line", "mirrored"])
def test_collapsed_triangles_give_finite_corrections(shape: str) -> None:
    triangles = Triangles(12, 0.1)
    if shape == "point":
        triangles.sides[:] = 0.0
    elif shape == "line":
        triangles.sides[:, :, 1] = 0.5 * triangles.sides[:, :, 0]
    else:
        triangles.sides[:, :, 0] *= -1.0
    correction = triangles.solved()
    assert np.isfinite(correction).all() and np.abs(correction).max() < 1.0


# -- Hinge, tether, drag ---------------------------------------------------------------------------------------------


def test_the_hinge_minimises_its_energy() -> None:
    """Moving by w K lambda solves (sum w K^2 + alpha/h^2) lambda = -K x: inertia against |K x|^2/(2 alpha)."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(COUNT, 4))
    rows[:, 0] = -rows[:, 1:].sum(axis=1)
    x, weight, alpha = rng.normal(size=(COUNT, 4, 3)), rng.uniform(0.1, 2.0, (COUNT, 4)), rng.uniform(0.01, 10.0, COUNT)
    sums = (weight * rows**2).sum(axis=1)
    far = x + 100.0  # x_i drops out
    differences = (far[:, 1:] - far[:, :1]).reshape(-1, 9)
    multiplier = call(hinge_multipliers, differences, rows, (1.0 / (sums + alpha))[:, None])
    moved = x + (weight * rows)[:, :, None] * multiplier[:, None, :]
    bent = np.einsum("ck,ckx->cx", rows, moved)
    # At the minimum the force of the hinge balances inertia: K x' = -alpha lambda.
    assert bent == pytest.approx(-alpha[:, None] * multiplier, abs=1e-4)


def test_a_hinge_that_rests_bent_pulls_down_its_energy_and_turns_nothing() -> None:
    """Forces are the slope of |K x - c n|^2 / 2 where the hinge is not nearly closed; everywhere they add to none."""
    rng = np.random.default_rng(6)
    rows = rng.normal(size=(COUNT, 4))
    rows[:, 0] = -rows[:, 1:].sum(axis=1)
    x, rest = rng.normal(size=(COUNT, 4, 3)), rng.uniform(-1.0, 1.0, COUNT)
    x[: COUNT // 4, 2] = x[: COUNT // 4, 3] + 0.05 * rng.normal(size=(COUNT // 4, 3))  # closed, or nearly

    def energy(x: np.ndarray) -> np.ndarray:
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 3])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return 0.5 * ((np.einsum("ck,ckx->cx", rows, x) - rest[:, None] * normal) ** 2).sum(axis=1)

    moves = call(bent_hinges, (x[:, 1:] - x[:, :1]).reshape(-1, 9), rows, rest[:, None], width=12).reshape(-1, 4, 3)
    size = np.abs(moves).max(axis=(1, 2))
    assert np.abs(moves.sum(axis=1)).max(axis=1) == pytest.approx(0.0, abs=1e-5 * size.max())
    assert np.abs(np.cross(x, moves).sum(axis=1)).max(axis=1) == pytest.approx(0.0, abs=1e-5 * size.max())
    along = x[:, 1] - x[:, 0]
    crossed = np.linalg.norm(np.cross(along, x[:, 2] - x[:, 3]), axis=1)
    opened = crossed > MIN_OPENING * (along**2).sum(axis=1)
    assert COUNT // 2 < opened.sum() < COUNT
    for a, axis in np.ndindex(4, 3):
        step = np.zeros((4, 3))
        step[a, axis] = 1e-6
        slope = (energy(x + step) - energy(x - step)) / 2e-6
        assert moves[opened, a, axis] == pytest.approx(-slope[opened], abs=1e-4 * size[opened].max())


def test_a_tether_pulls_only_what_is_beyond_its_length() -> None:
    offsets = np.random.default_rng(1).normal(size=(COUNT, 3))
    distance = np.linalg.norm(offsets, axis=1)
    lengths = np.random.default_rng(2).uniform(0.2, 3.0, COUNT)
    moved = offsets + call(tethers, offsets, lengths[:, None])
    assert np.linalg.norm(moved, axis=1) == pytest.approx(np.minimum(distance, lengths), rel=1e-6)
    assert np.array_equal(moved[distance < lengths], offsets[distance < lengths])


def test_a_stitch_closes_at_once_and_keeps_momentum() -> None:
    rng = np.random.default_rng(3)
    v, a, b = rng.normal(size=(3, COUNT, 3))
    w, inverse = rng.uniform(size=(COUNT, 1)), rng.uniform(0.5, 5.0, (COUNT, 3))
    inverse[::5, 0] = inverse[1::5, 1] = 0.0  # held ends do not move
    multiplier = call(stitches, a - v, b - v, w, inverse)
    moves = inverse[:, :1] * multiplier, -inverse[:, 1:2] * (1.0 - w) * multiplier, -inverse[:, 2:] * w * multiplier
    gap = (v + moves[0]) - (1.0 - w) * (a + moves[1]) - w * (b + moves[2])
    assert np.abs(gap).max() < 1e-5
    # Momentum, where nothing is held: sum of m dx.
    free = (inverse > 0.0).all(axis=1)
    total = sum(move[free] / inverse[free, k : k + 1] for k, move in enumerate(moves))
    assert np.abs(total).max() < 1e-5


def test_drag_is_the_exact_solution_of_its_equation() -> None:
    """dv/dt = -k |v| v over h gives v / (1 + h k |v|); along the normal only."""
    rng = np.random.default_rng(3)
    velocities, normals = 10.0 * rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    factors = 10.0 ** rng.uniform(-6.0, 6.0, COUNT)
    along = (velocities * normals).sum(axis=1)
    change = call(drags, velocities, normals, factors[:, None])
    exact = along / (1.0 + factors * np.abs(along)) - along
    assert change == pytest.approx(normals * exact[:, None], rel=1e-4, abs=1e-5)
    assert np.array_equal(call(drags, velocities, normals, np.zeros((COUNT, 1))), np.zeros((COUNT, 3)))


# -- Contact ---------------------------------------------------------------------------------------------------------

H = 1.0 / 1200.0


def contact(gap: float, slip: tuple, friction: float) -> np.ndarray:
    return call(contacts, np.array([[gap]]), np.array([[0.0, 1.0, 0.0]]), np.array([slip]), friction, H)[0]


def test_without_contact_nothing_is_corrected_inside_the_cone_it_sticks_and_outside_it_slides() -> None:
    assert np.array_equal(contact(1e-6, (1e-3, -1e-3, 0.0), 0.5), np.zeros(3))
    depth = 1e-5
    for slip, stopped in ((0.29 * depth, 0.29 * depth), (3.0 * depth, 0.3 * depth)):
        correction = contact(-depth, (slip * 0.6, -depth, slip * 0.8), 0.3)
        assert correction == pytest.approx([-stopped * 0.6, depth, -stopped * 0.8], rel=1e-5)


@pytest.mark.parametrize("speed", [-3.0, 0.0, 0.4, 2.0])
def test_old_depth_comes_out_gently_and_motion_inward_is_stopped_whole(speed: float) -> None:
    """A correction is also a velocity: after it the vertex leaves at PUSH_OUT, or as fast as it did already."""
    slip = speed * H
    normal = contact(-0.02, (0.0, slip, 0.0), 0.0)[1]
    assert (slip + normal) / H == pytest.approx(max(PUSH_OUT, speed), rel=1e-5)
    # No deeper than it was: less depth than that is taken out whole.
    shallow = 0.1 * PUSH_OUT * H
    assert contact(-shallow, (0.0, 0.0, 0.0), 0.0)[1] == pytest.approx(shallow, rel=1e-6)


@pytest.mark.parametrize("degrees", [1.0, 5.0, 179.0])
def test_a_triangle_sheared_flat_is_not_thrown(degrees: float) -> None:
    """Warp and weft lie along each other: no corner moves by more than a side."""
    angle = np.radians(degrees)
    sides = np.array([[1.0, 0.0, 0.0, np.cos(angle), np.sin(angle), 0.0]], np.float32)
    data = np.array([[1.0, 0.0, 0.0, 1.0, 2.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0]], np.float32)
    out = np.zeros((1, 6), np.float32)
    membrane_rows(sides, data, 1.0, out)
    assert 0.0 < np.abs(out).max() < 1.0
