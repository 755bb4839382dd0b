"""Relaxation on the fine mesh: what is stretched, what is held, what a body pushes out."""

from __future__ import annotations

import numpy as np
import pytest

from pbd import Body, Fabric
from pbd.geometry import FAR
from pbd.model import build_model
from tests.pbd.meshes import grid
from tests.wrinkles.delivered import delivered_levels, delivered_panels
from tests.wrinkles.meshes import icosphere
from wrinkles.charts import leading_vertices
from wrinkles.levels import Levels, build_levels
from wrinkles.out_of_body import GAP_SHARE, MAX_LIFT, SLOPE
from wrinkles.relaxation import LEVEL, PLEATED, SPEED, Relaxation

NOBODY = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
THICKNESS = 0.002


class Cloth:
    """A flat sheet above a body, to relax."""

    def __init__(
        self, held: tuple = (), body: tuple[np.ndarray, np.ndarray] = NOBODY, facing: float = 1.0, level: float = LEVEL
    ) -> None:
        vertices, faces = grid(8, 8, 0.03, "equilateral")
        self.levels: Levels = build_levels(vertices, faces, np.array(held, int), *NOBODY, 2)
        leading = leading_vertices(self.levels.subdivision)
        clearance = np.full(max(1, len(body[0])), THICKNESS, np.float32)
        model = build_model(self.levels.fine, Fabric(), self.levels.fine_held)
        self.model, self.mass = model, model.mass
        self.relax = Relaxation(model, leading, clearance, facing, level)
        self.frames = np.zeros((len(vertices), 9), np.float32)
        self.frames[:, 8] = facing  # the sheet's own faces look up or down; it covers what is under it
        self.body = Body(body[1], max(1, len(body[0])))
        if len(body[0]):
            self.body.place(body[0].astype(np.float32))
        self.rest = self.levels.fine.vertices
        self.edges, self.lengths = self.levels.fine.edge_lengths()

    def contacts(self, of: slice | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The body's nearest vertex to each coarse vertex, of some of them, and how far it is."""
        offered = np.arange(len(self.body.current))[of or slice(None)]
        away = np.linalg.norm(self.levels.coarse.vertices[:, None] - self.body.current[offered], axis=2)
        return offered[away.argmin(axis=1)].astype(np.int32), away.min(axis=1).astype(np.float32)

    def __call__(
        self, fine: np.ndarray, targets: np.ndarray | None = None, passes: int = 1, contacts: tuple | None = None
    ) -> np.ndarray:
        """Relaxed vertices, from contacts that were found on the way."""
        count = len(self.levels.coarse.vertices)
        nearest, contact = np.full(count, -1, np.int32), np.full(count, FAR, np.float32)
        if len(self.body.faces):
            nearest, contact = contacts or self.contacts()
        fine = fine.astype(np.float32)
        targets = np.zeros((0, 3)) if targets is None else targets
        self.relax(fine, targets, self.frames, nearest, contact, self.body, self.body.current, passes)
        return fine.astype(float)

    def strain(self, vertices: np.ndarray) -> np.ndarray:
        side = vertices[self.edges[:, 1]] - vertices[self.edges[:, 0]]
        return np.linalg.norm(side, axis=1) / self.lengths - 1.0


def test_what_is_not_at_rest_comes_nearer_to_it_pass_by_pass() -> None:
    """Stretched and pushed together, of single edges at once and of the whole sheet from its rim inwards."""
    cloth = Cloth()
    off = lambda x: np.abs(cloth.strain(x)).mean()  # noqa: E731
    noisy = cloth.rest + 5e-4 * np.random.default_rng(0).standard_normal(cloth.rest.shape) * [1.0, 1.0, 0.0]
    assert off(cloth(noisy)) < 0.6 * off(noisy) and off(cloth(noisy, passes=3)) < 0.8 * off(cloth(noisy))
    for start in (noisy, 1.03 * cloth.rest):
        assert off(cloth(start, passes=30)) < 0.8 * off(cloth(start)) < 0.8 * off(start)
        centres = [cloth.mass @ vertices / cloth.mass.sum() for vertices in (start, cloth(start))]
        np.testing.assert_allclose(*centres, atol=1e-6)  # momentum is kept


def test_short_folds_come_to_rest_and_long_ones_stay() -> None:
    """A sine of two edges is bent half flat; one over the whole sheet is kept."""
    cloth = Cloth()
    x = cloth.rest[:, 0]
    edge, width = cloth.lengths.mean(), np.ptp(x)
    height = {}
    for name, length in (("short", 2.1 * edge), ("long", 2.0 * width)):
        start = cloth.rest + 1e-4 * np.sin(2.0 * np.pi * x / length)[:, None] * [0.0, 0.0, 1.0]
        height[name] = np.std(cloth(start, passes=8)[:, 2]) / np.std(start[:, 2])
    assert height["short"] < 0.5 and height["long"] > 0.98


def test_a_pass_goes_to_where_bending_comes_to_rest() -> None:
    """An implicit step of the bending forces ends where E(x) + |x - x0|^2_M / (2 h^2) is least, by a direct solver."""
    cloth = Cloth(held=tuple(range(9)))
    hinges, data = cloth.model.hinges, cloth.model.hinge_data.astype(float)
    curl = np.zeros((len(hinges), len(cloth.rest)))
    np.add.at(curl, (np.arange(len(hinges))[:, None], hinges), data[:, 0])
    stiffness = curl.T @ (curl / data[:, 1, 1, None])
    free = cloth.model.inverse_mass > 0
    inertia = np.diag(cloth.mass[free] * (SPEED / cloth.lengths.mean()) ** 2)
    start = cloth.rest.copy()  # folds so flat that nothing is stretched by them
    start[free, 2] += 1e-6 * np.random.default_rng(3).standard_normal(free.sum())
    height = start[free, 2]
    stiffness = stiffness[np.ix_(free, free)]
    rest = np.linalg.solve(inertia + stiffness, inertia @ height)

    def total(z: np.ndarray) -> float:
        return float(z @ stiffness @ z + (z - height) @ inertia @ (z - height))

    relaxed = cloth(start, start[cloth.levels.fine_held])[free, 2]
    assert total(height) > 1.1 * total(rest)
    assert 0.0 <= total(relaxed) - total(rest) < 0.02 * (total(height) - total(rest))


def test_a_mesh_that_fits_stays() -> None:
    cloth = Cloth()
    np.testing.assert_allclose(cloth(cloth.rest), cloth.rest, atol=1e-7)
    bent = cloth.rest.copy()  # rolled up: nothing is stretched by more than its chord
    bent[:, 0], bent[:, 2] = 0.1 * np.sin(cloth.rest[:, 0] / 0.1), 0.1 * np.cos(cloth.rest[:, 0] / 0.1)
    np.testing.assert_allclose(cloth(bent, passes=3), bent, atol=1e-4)


@pytest.mark.parametrize("delivered", [False, True])
def test_a_delivered_mesh_does_not_come_to_rest(delivered: bool) -> None:
    """Its pleats would get sharper."""
    if delivered:
        _, _, coarse, subdivision = delivered_panels()
        levels = delivered_levels(coarse, subdivision)
    else:
        levels = Cloth(held=tuple(range(9))).levels
    relax, body = Relaxation.of(levels, *NOBODY, Fabric(), 1 / 3), Body(NOBODY[1], 1)
    rng, count = np.random.default_rng(2), levels.subdivision.coarse_count
    start = (levels.fine.vertices + rng.normal(0.0, 0.0003, levels.fine.vertices.shape)).astype(np.float32)
    fine, targets = start.copy(), start[levels.fine_held] + np.float32(0.001)
    nothing = np.full(count, -1, np.int32), np.full(count, FAR, np.float32)
    relax(fine, targets, np.zeros((count, 9), np.float32), *nothing, body, body.current, 2)
    np.testing.assert_array_equal(fine[levels.fine_held], targets)
    free = np.setdiff1d(np.arange(len(fine)), levels.fine_held)
    assert np.array_equal(fine[free], start[free]) == delivered


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
    assert after[inside].max() < 0.1 + THICKNESS + 3.3e-3  # what is lifted less is lifted by what is lifted more
    to_lifted = np.linalg.norm(start[:, None] - start[inside], axis=2).min(axis=1)
    away = to_lifted > MAX_LIFT / SLOPE
    assert away.sum() > 30
    np.testing.assert_allclose(relaxed[away], start[away], atol=1e-6)
    # They go out where they are, not to somewhere else on the body.
    outward = (start[inside] - centre) / radius[inside][:, None]
    moved = relaxed[inside] - start[inside]
    assert np.linalg.norm(moved - (moved * outward).sum(axis=1, keepdims=True) * outward, axis=1).max() < 1e-3


def test_cloth_stands_over_a_small_part_of_the_body_like_a_tent() -> None:
    ball, faces = icosphere(3, 0.008)
    centre = np.array([0.1, 0.13, -0.004])  # 4 mm of it are over the sheet at z = 0
    cloth = Cloth(body=(ball + centre, faces))
    relaxed = cloth(cloth.rest, passes=0)
    height, away = relaxed[:, 2] - cloth.rest[:, 2], np.linalg.norm(cloth.rest[:, :2] - centre[:2], axis=1)
    assert 0.004 < height.max() < 0.008
    tent = (away > 0.011) & (away < 0.02)  # beside the ball, where it reaches nothing
    assert tent.sum() > 8
    assert (height[tent] > height.max() - 1.3 * SLOPE * away[tent] - 1e-3).all()
    assert np.abs(height[away > 0.07]).max() < 1e-6


@pytest.mark.parametrize(("level", "outside"), [(LEVEL, False), (PLEATED, True)])
def test_pleats_that_go_deep_below_the_coarse_garment_are_pushed_out_where_they_are_looked_for(
    level: float, outside: bool
) -> None:
    ball, faces = icosphere(4, 0.1)
    centre = np.array([0.1, 0.13, -0.135])  # 35 mm under the sheet
    cloth = Cloth(body=(ball + centre, faces), level=level)
    start = cloth.rest.copy()
    pleat = np.argsort(np.linalg.norm(start[:, :2] - centre[:2], axis=1))[:40]
    start[pleat, 2] -= 0.045  # 10 mm into the ball
    depth = 0.1 - np.linalg.norm(cloth(start)[pleat] - centre, axis=1)
    assert depth.max() < 1e-3 if outside else depth.max() > 5e-3


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
    if room < 0.0:  # and what is outside one by much is not inside the other by more than they overlap
        assert np.minimum(own, other).min() > (1.0 + GAP_SHARE) * room - 2.0 * sag


def test_what_strikes_the_cloth_from_its_other_side_is_left_too() -> None:
    """Some coarse vertices see what strikes, the others what they cover, which is far below."""
    ball, faces = icosphere(4, 0.1)
    strikes, covered = np.array([0.1, 0.13, 0.09]), np.array([0.1, 0.13, -0.16])
    cloth = Cloth(body=(np.concatenate([ball + strikes, ball + covered]), np.concatenate([faces, faces + len(ball)])))
    one, other = cloth.contacts(slice(0, len(ball))), cloth.contacts(slice(len(ball), None))
    alternating = np.arange(len(one[0])) % 2 == 0
    contacts = tuple(np.where(alternating, a, b) for a, b in zip(one, other, strict=True))
    depth = lambda x: 0.1 - np.linalg.norm(x - strikes, axis=1).min()  # noqa: E731
    assert depth(cloth.rest) > 0.009
    assert depth(cloth(cloth.rest, contacts=contacts)) < 1e-3


def test_a_vertex_is_pushed_out_where_any_coarse_vertex_around_it_touches_the_body() -> None:
    ball, faces = icosphere(4, 0.1)
    centre = np.array([0.1, 0.13, -0.09])
    cloth = Cloth(body=(ball + centre, faces))
    nearest, contact = cloth.contacts()
    toucher = int(contact.argmin())
    contact[np.arange(len(contact)) != toucher] = FAR
    leading = leading_vertices(cloth.levels.subdivision)
    beside = (leading[:, 1:] == toucher).any(axis=1) & (np.linalg.norm(cloth.rest - centre, axis=1) < 0.099)
    assert beside.sum() > 5
    relaxed = cloth(cloth.rest, contacts=(nearest, contact))
    assert np.linalg.norm(relaxed[beside] - centre, axis=1).min() > 0.099


def test_a_coarse_vertex_that_goes_over_to_another_part_remembers_the_one_that_it_left() -> None:
    """First the middle touches the upper part and its surroundings the lower one, then all of them touch the lower."""
    ball, faces = icosphere(4, 0.1)
    under, over = np.array([0.1, 0.13, -0.102]), np.array([0.1, 0.13, 0.102])
    cloth = Cloth(body=(np.concatenate([ball + under, ball + over]), np.concatenate([faces, faces + len(ball)])))
    low, high = cloth.contacts(slice(0, len(ball))), cloth.contacts(slice(len(ball), None))
    middle = np.linalg.norm(cloth.levels.coarse.vertices[:, :2] - under[:2], axis=1) < 0.04
    cloth(cloth.rest, contacts=tuple(np.where(middle, a, b) for a, b in zip(high, low, strict=True)))
    raised = cloth.rest + [0.0, 0.0, 0.006]
    depth = lambda x: 0.1 - np.linalg.norm(x - over, axis=1).min()  # noqa: E731
    assert middle.sum() > 3 and depth(raised) > 0.003
    assert depth(cloth(raised, contacts=low)) < 1e-3


def follow(cloth: Cloth, poses: list[np.ndarray], noise: float = 3e-4) -> list[float]:
    """Relax the cloth over a body that moves, with what was remembered and from scratch: both must be the same bits.

    Returns:
        the share of remembered body vertices that each frame kept.
    """
    rng, kept = np.random.default_rng(0), []
    for pose in poses:
        cloth.body.advance(pose.astype(np.float32))
        start = cloth.rest + noise * rng.standard_normal(cloth.rest.shape)
        remembering, before = cloth.relax, np.asarray(cloth.relax.memory[0])
        ours = cloth(start)
        kept.append(float(np.mean((remembering.memory[0] == before)[before >= 0])) if (before >= 0).any() else 0.0)
        cloth.relax = remembering.fresh()
        np.testing.assert_array_equal(ours, cloth(start))
        cloth.relax = remembering
    return kept


def ball_under() -> tuple[np.ndarray, np.ndarray]:
    """A ball whose top is 3 mm over the sheet [m], and its faces."""
    ball, faces = icosphere(4, 0.08)
    return ball + np.array([0.1, 0.1, 0.003 - 0.08]), faces


def turned_about(vertices: np.ndarray, angle: float, centre: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return (vertices - centre) @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) + centre


def test_remembered_places_of_the_body_are_those_of_a_search() -> None:
    """The ball glides, sinks, rises and turns."""
    ball, faces = ball_under()
    cloth = Cloth(body=(ball, faces))
    centre = ball.mean(axis=0)
    poses = [
        turned_about(ball, 0.02 * k, centre) + [0.001 * k, 0.0, 0.002 * np.sin(0.5 * k)] for k in range(30)
    ]  # fmt: skip
    assert 0.3 < np.median(follow(cloth, poses)) < 1.0  # some were remembered, the others had to be searched


@pytest.mark.parametrize("jump", [(0.0, 0.0, -1.0), (0.03, 0.02, 0.002), (0.0, 0.0, 0.02)])
def test_a_body_that_jumps_or_dashes_is_searched_anew(jump: tuple[float, float, float]) -> None:
    """Away and back, to another place, and 2 cm into the cloth in one frame."""
    ball, faces = ball_under()
    follow(Cloth(body=(ball, faces)), [ball, ball, ball + np.array(jump), ball + np.array(jump), ball], noise=0.0)


def test_a_body_vertex_with_many_neighbours_is_a_vertex_like_others() -> None:
    """The pole of a flat cone with 12 faces, over the sheet from above and moved along it."""
    turn = 2.0 * np.pi * np.arange(12) / 12
    rim = np.stack([0.06 * np.cos(turn), 0.06 * np.sin(turn), np.full(12, -0.02)], axis=1)
    cone = np.concatenate([[[0.0, 0.0, 0.0]], rim]) + [0.1, 0.1, 0.004]
    faces = np.stack([np.zeros(12, int), 1 + np.arange(12), 1 + (np.arange(12) + 1) % 12], axis=1)
    cloth = Cloth(body=(cone, faces))
    kept = follow(cloth, [cone + [0.002 * k, 0.0, 0.0] for k in range(10)], noise=0.0)
    assert kept[-1] > 0.5
    height = lambda x: x[:, 2] - (0.004 - np.linalg.norm(x[:, :2] - [0.118, 0.1], axis=1) / 3.0)  # noqa: E731
    assert (height(cloth.rest) < -5e-4).sum() > 5 and height(cloth(cloth.rest)).min() > 0.5 * THICKNESS


def test_what_was_remembered_can_be_set_again() -> None:
    ball, faces = ball_under()
    cloth = Cloth(body=(ball, faces))
    cloth(cloth.rest)
    memory, noisy = cloth.relax.memory, cloth.rest + 3e-4 * np.random.default_rng(1).standard_normal(cloth.rest.shape)
    first = cloth(noisy)
    cloth.body.advance((ball + [0.02, 0.0, 0.01]).astype(np.float32))
    cloth(cloth.rest)
    cloth.body.advance(ball.astype(np.float32))
    cloth.relax.memory = memory
    assert np.array_equal(cloth(noisy), first)
