"""The list of known failures as scenes for :func:`precompute.failures.failure_play.play`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh

from pbd import Body, Capsule, ClothMesh, Colliders, Fabric, Model, ModelOptions, Plane, Sphere, build_model
from pbd.crossings import crossings
from pbd.layers import layered
from precompute.experiment.measures import FRAME_RATE, GRAVITY
from precompute.experiment.sheets import band, square, tube
from precompute.failures.failure_play import FailureScene, FrameConditions

__all__ = ["HUNG", "scenes"]

COTTON = Fabric(friction=0.5)
VACUUM = replace(COTTON, air_drag=0.0)


def _corners(edges: int) -> list[int]:
    """Upper corners of a square."""
    return [edges, (edges + 1) ** 2 - 1]


HUNG = (square(10), _corners(10))  # 5 cm edges


def _crossed(mesh: ClothMesh) -> Callable[[np.ndarray], bool]:
    return lambda x: len(crossings(x, mesh.faces)) > 0


def scenes() -> list[FailureScene]:
    """Every scene that one run decides, in the order of the list."""
    return [*_motion(), *_contact(), *_shape(), *_input(), *_events()]


def _motion() -> list[FailureScene]:
    level, upright = square(8, upright=False), square(8)
    hung, corners = HUNG
    far = replace(level, vertices=level.vertices + [100.0, 0.0, 100.0])
    thrown = np.array([3.0, 4.0, 1.0])
    return [
        FailureScene(
            "flat cloth of 0.15 kg/m2 in free fall", "flat cloth falls in vacuum", level, VACUUM,
            truth=lambda t: level.vertices - [0.0, 0.5 * GRAVITY * t * t, 0.0], speed=20.0,
        ),
        FailureScene(
            "drift or damping in free fall", "cloth thrown without weight, 140 m from the origin", far, VACUUM,
            velocity=(3.0, 4.0, 1.0), gravity=0.0, truth=lambda t: far.vertices + t * thrown, speed=6.0,
        ),
        FailureScene(
            "one pinned corner spinning", "level square let go, held by a corner", level, COTTON, [0],
            seconds=5.0, free=True,
        ),
        FailureScene("extreme wind and recovery", "wind of 60 m/s for a second", hung, COTTON, corners,
              seconds=4.0, direct=_gust, quiet=1.5, speed=120.0),  # brought up short it whips to twice the wind's speed
        FailureScene("a huge dt after a pause, dt = 0", "2 s pass in one frame", upright, COTTON, _corners(8),
              seconds=5.0, direct=_pause, quiet=3.0),
        FailureScene("a huge dt after a pause, dt = 0", "half a second of frames without time",
              upright, COTTON, _corners(8),
              start=upright.vertices * [1.0, 0.866, 1.0] + [[0.0, 0.0, 0.5]] * -upright.vertices[:, 1:2],
              direct=_standstill, seconds=2.0),
    ]  # fmt: skip


def _gust(stage: FrameConditions) -> None:
    stage.wind = (5.0, 0.0, 60.0) if 0.5 <= stage.time < 1.5 else (0.0, 0.0, 0.0)


def _pause(stage: FrameConditions) -> None:
    stage.dt = 2.0 if abs(stage.time - 1.0) < 0.5 / FRAME_RATE else 1.0 / FRAME_RATE


def _standstill(stage: FrameConditions) -> None:
    stage.dt = 0.0 if 0.5 <= stage.time < 0.503 else 1.0 / FRAME_RATE


def _stack(fabric: Fabric) -> Model:
    """Three sheets of a hand's length upon one another."""
    flat = square(8, 0.24, upright=False)
    sheets = [replace(flat, vertices=flat.vertices + [0.0, 0.004 * k, 0.0]) for k in range(3)]
    return layered([build_model(mesh, fabric, options=ModelOptions(), bend_factor=1 / 3) for mesh in sheets])


def _contact() -> list[FailureScene]:
    slope = np.array([np.sin(np.radians(15.0)), np.cos(np.radians(15.0)), 0.0])
    level, hung = square(8, 0.4, upright=False), HUNG
    thickness = COTTON.thickness
    lying = level.vertices - np.outer(level.vertices @ slope - thickness, slope)
    sleeve, ring = tube(0.099, 0.3, 16, 8)
    wide = sleeve.vertices * [1.045, 1.0, 1.045]
    thin = replace(COTTON, thickness=0.001)
    ball = trimesh.creation.icosphere(3, 0.15)
    folded, curtain = square(16, 0.6, upright=False), square(16, 0.8)
    arm = trimesh.creation.capsule(0.8, 0.1, count=[16, 16])
    arm.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0.0, 1.0, 0.0)))
    arm.apply_translation(-arm.bounds.mean(axis=0) + [0.0, -0.25, 0.0])
    return [
        FailureScene("friction that creeps", "sheet on a slope of 15 deg, friction 0.5", level, COTTON, start=lying,
              seconds=4.0, colliders=lambda: Colliders([Plane((0.0, 0.0, 0.0), tuple(slope))]),
              truth=lambda t: lying, at_rest=True),
        FailureScene("contact band crossed in one step, then ejection", "sheet meets the ground at 30 m/s",
              level, COTTON, start=level.vertices + [0.0, 1.0, 0.0], velocity=(0.0, -30.0, 0.0), speed=30.0, quiet=0.05,
              colliders=lambda: Colliders([Plane((0.0, 0.0, 0.0))])),
        FailureScene("contact band crossed in one step, then ejection", "ball of 20 m/s into a curtain",
              curtain, COTTON,
              np.flatnonzero(curtain.vertices[:, 1] > -1e-9).tolist(), seconds=3.0, direct=_shot, speed=20.0, quiet=1.0,
              colliders=lambda: Colliders([Sphere((0.01, -0.4, -1.5), 0.1)]),
              through=lambda x: bool((x[:, 2] > 0.15).sum() < 3)),
        FailureScene("self contact that breaks body contact", "sheet in folds over a ball", folded, COTTON,
              start=folded.vertices + [0.0, 0.16, 0.0], seconds=3.0, self_collision=True, default_only=True,
              colliders=lambda: Colliders([Sphere((0.0, 0.0, 0.0), 0.15)]), quiet=0.5,
              through=_crossed(folded)),
        FailureScene("tight garment jitter", "sleeve 4 % too small on an arm", sleeve,
              replace(COTTON, stretch_warp=500.0, stretch_weft=500.0, shear=100.0), ring, start=wide, at_rest=True,
              seconds=3.0, colliders=lambda: Colliders([Capsule((0.0, 0.2, 0.0), (0.0, -0.6, 0.0), 0.1)])),
        FailureScene("thin layers stacked", "three sheets of 1 mm on the ground", _stack(thin).mesh, thin, build=_stack,
              seconds=3.0, default_only=True, colliders=lambda: Colliders([Plane((0.0, -0.01, 0.0))]), quiet=0.5,
              through=_crossed(_stack(thin).mesh), at_rest=True),
        FailureScene("limbs that pinch cloth between them", "two arms close on cloth and open",
              hung[0], COTTON, hung[1],
              seconds=4.0, colliders=lambda: Colliders(_arms(0.3)), direct=_pinch, speed=0.5, quiet=2.5),
        FailureScene("limbs that pinch cloth between them", "two arms of triangles close on cloth and open",
              hung[0], COTTON,
              hung[1], seconds=4.0, colliders=lambda: Colliders((), _limbs(arm)), direct=_pinch_mesh(arm), speed=0.5,
              quiet=2.5, default_only=True),
        FailureScene("garment that starts inside the body or through itself", "sheet starts 5 cm inside a ball",
              level, COTTON, start=level.vertices + [0.01, 0.1, 0.02], quiet=1.0, seconds=2.5,
              colliders=lambda: Colliders([Sphere((0.0, 0.0, 0.0), 0.15)])),
        FailureScene("garment that starts inside the body or through itself",
              "sheet starts 5 cm inside a ball of triangles",
              level, COTTON, start=level.vertices + [0.01, 0.1, 0.02], quiet=1.0, seconds=2.5, default_only=True,
              colliders=lambda: Colliders((), _body(np.array(ball.vertices), ball.faces)),
              through=lambda x: bool((np.linalg.norm(x, axis=1) < 0.147).any())),
        FailureScene("teleport and dash of the body", "body and cloth 3 m away in one frame", sleeve, COTTON, ring,
              start=wide, seconds=3.0, direct=_teleport, speed=3.0 * FRAME_RATE, quiet=1.0,
              colliders=lambda: Colliders([Capsule((0.0, 0.2, 0.0), (0.0, -0.6, 0.0), 0.08)])),
        FailureScene("teleport and dash of the body", "body dashes at 15 m/s for a third of a second",
              sleeve, COTTON, ring, start=wide, seconds=3.0, direct=_dash, speed=15.0, quiet=1.0,
              colliders=lambda: Colliders([Capsule((0.0, 0.2, 0.0), (0.0, -0.6, 0.0), 0.08)])),
    ]  # fmt: skip


def _body(vertices: np.ndarray, faces: np.ndarray) -> Body:
    body = Body(np.asarray(faces, np.int32), len(vertices))
    body.place(vertices.astype(np.float32))
    return body


def _shot(stage: FrameConditions) -> None:
    ball = stage.colliders.primitives[0]
    assert isinstance(ball, Sphere)
    z = min(-1.5 + 20.0 * max(stage.time + stage.dt - 0.5, 0.0), 0.15)
    ball.centre = (0.01, -0.4, z)


def _gap(t: float) -> float:
    """Distance of an arm's axis from the middle [m]: closes to overlap by 4 cm, stays, opens."""
    return 0.3 - 0.22 * float(np.clip((t - 0.5) / 0.5, 0.0, 1.0) - np.clip((t - 2.0) / 0.5, 0.0, 1.0))


def _arms(gap: float) -> list[Plane | Sphere | Capsule]:
    return [Capsule((-0.4, -0.25, side * gap), (0.4, -0.25, side * gap), 0.1) for side in (-1.0, 1.0)]


def _pinch(stage: FrameConditions) -> None:
    stage.colliders.primitives[:] = _arms(_gap(stage.time + stage.dt))


def _limbs(arm: trimesh.Trimesh) -> Body:
    faces = np.concatenate([arm.faces, arm.faces + len(arm.vertices)])
    return _body(_placed(arm, 0.3), faces)


def _placed(arm: trimesh.Trimesh, gap: float) -> np.ndarray:
    return np.concatenate([arm.vertices + [0.0, 0.0, -gap], arm.vertices + [0.0, 0.0, gap]])


def _pinch_mesh(arm: trimesh.Trimesh) -> Callable[[FrameConditions], None]:
    def direct(stage: FrameConditions) -> None:
        body = stage.colliders.body
        assert body is not None
        body.advance((_placed(arm, _gap(stage.time + stage.dt)) - body.origin).astype(np.float32))

    return direct


def _moved(stage: FrameConditions, x: float) -> None:
    limb = stage.colliders.primitives[0]
    assert isinstance(limb, Capsule)
    stage.targets = stage.targets + [x - limb.start[0], 0.0, 0.0]
    limb.start, limb.end = (x, 0.2, 0.0), (x, -0.6, 0.0)


def _teleport(stage: FrameConditions) -> None:
    _moved(stage, 3.0 if stage.time >= 1.0 - 1e-6 else 0.0)


def _dash(stage: FrameConditions) -> None:
    _moved(stage, 15.0 * float(np.clip(stage.time + stage.dt - 0.6, 0.0, 1.0 / 3.0)))


def _shape() -> list[FailureScene]:
    strip, rows = band(0.5, 0.1, 20)
    ends = np.flatnonzero((rows == 0) | (rows == 20)).tolist()
    top = np.flatnonzero(rows == 0).tolist()
    stiff = replace(COTTON, bend_warp=1e-3, bend_weft=1e-3)
    lean = np.radians(75.0)  # neighbours stand at 150 deg
    zigzag = strip.vertices * [1.0, np.cos(lean), 1.0] + np.stack(
        [0 * rows, 0 * rows, 0.025 * np.sin(lean) * (rows % 2)], 1
    )
    sleeve, ring = tube(0.05, 0.3, 12, 8)
    hung, corners = HUNG
    doubled = hung.vertices.copy()
    doubled[:, 0] = -np.abs(doubled[:, 0])
    inverted = hung.vertices.copy()
    free = np.setdiff1d(np.arange(len(inverted)), corners)
    pairs = np.random.default_rng(0).permutation(free)[:60].reshape(-1, 2)
    inverted[pairs] = inverted[pairs[:, ::-1]]

    def twist(stage: FrameConditions) -> None:
        done = float(np.clip((stage.time + stage.dt) / 3.0, 0.0, 1.0))
        end = rows[ends] == 20
        rest = strip.vertices[ends]
        angle = 12.0 * np.pi * done
        turned = np.stack([rest[:, 0] * np.cos(angle), rest[:, 1] + 0.1 * done, rest[:, 0] * np.sin(angle)], axis=1)
        stage.targets = np.where(end[:, None], turned, rest)

    return [
        FailureScene("a strip twisted many turns", "six turns in three seconds", strip, COTTON, ends, seconds=4.5,
              direct=twist, quiet=3.0, speed=0.7),
        FailureScene("large bend angles", "stiff strip starts in pleats of 150 deg", strip, stiff, top, start=zigzag),
        FailureScene("nonzero rest angles", "sleeve of stiff cloth, 30 deg an edge", sleeve, stiff, ring, seconds=3.0,
              at_rest=True),
        FailureScene("compressed or inverted triangles", "ten times compressed",
              hung, COTTON, start=0.1 * hung.vertices),
        FailureScene("compressed or inverted triangles", "60 vertices in one another's place", hung, COTTON, corners,
              start=inverted),
        FailureScene("compressed or inverted triangles", "all on one line", hung, COTTON, corners,
              start=hung.vertices * [1.0, 0.0, 0.0]),
        FailureScene("180 degree folds", "folded upon itself, held by a corner",
              hung, COTTON, [corners[0]], start=doubled),
    ]  # fmt: skip


def _input() -> list[FailureScene]:
    huge, tiny = square(10, 50.0), square(10, 0.01)
    leaning = np.array([[1.0, 0.0, 0.0], [0.0, 0.94, 0.34], [0.0, -0.34, 0.94]])
    slivers = square(10)
    moved = slivers.vertices.copy()
    inner = np.flatnonzero((np.abs(moved[:, 0]) < 0.24) & (np.abs(moved[:, 1] + 0.25) < 0.24))
    moved[inner[::3], 0] += 0.0495  # next to the neighbour, faces 0.5 mm high
    slivers = ClothMesh.from_surface(moved, slivers.faces, warp=(1.0, 0.0, 0.0))
    heavy = replace(COTTON, areal_density=150.0, stretch_warp=1e5, stretch_weft=1e5, shear=3e4)
    graded, top = _graded()
    found = [
        FailureScene("centimetre/metre scale mistakes, tiny cloth", "a hundred times too large",
              huge, COTTON, _corners(10), seconds=4.0),
        FailureScene("centimetre/metre scale mistakes, tiny cloth", "1 cm with edges of 1 mm, falls over", tiny, COTTON,
              start=tiny.vertices @ leaning, seconds=2.0, colliders=lambda: Colliders([Plane((0.0, -0.02, 0.0))])),
        FailureScene("centimetre/metre scale mistakes, tiny cloth", "1 cm with edges of 1 mm, hung", tiny, COTTON,
              _corners(10), seconds=2.0),
        FailureScene("slivers, duplicate and non-manifold faces", "faces a hundred times as long as high",
              slivers, COTTON, _corners(10)),
        FailureScene("heavy cloth, mass ratio 1:1000", "150 kg/m2 by two corners",
              HUNG[0], heavy, HUNG[1], seconds=3.0),
        FailureScene("heavy cloth, mass ratio 1:1000", "edges of 1 cm bear edges of 30 cm",
              graded, COTTON, top, seconds=3.0),
    ]  # fmt: skip
    return found + [
        FailureScene("resolution sweep", f"{edges} edges", square(edges), COTTON, _corners(edges))
        for edges in (2, 4, 8, 16, 32)
    ]


def _graded() -> tuple[ClothMesh, list[int]]:
    """Strip 9 cm wide whose rows grow from 1 cm to a flap of 30 cm: vertex masses of 1 to 1000."""
    rows = [(0.0, 0.09, 10), (-0.01, 0.09, 10), (-0.02, 0.09, 10), (-0.35, 0.6, 3), (-0.65, 0.6, 3)]
    flat = np.concatenate([
        np.stack([np.linspace(-width / 2, width / 2, count), np.full(count, y)], axis=1) for y, width, count in rows
    ])  # fmt: skip
    faces, start = [], 0
    for (_, _, count), (_, _, following) in zip(rows[:-1], rows[1:], strict=True):
        a, b = 0, 0  # a band between two rows, closed from left to right
        below = start + count
        while a < count - 1 or b < following - 1:
            upper = a < count - 1 and (b == following - 1 or (a + 1) / (count - 1) <= (b + 1) / (following - 1))
            if upper:
                faces.append([start + a, below + b, start + a + 1])
                a += 1
            else:
                faces.append([start + a, below + b, below + b + 1])
                b += 1
        start = below
    vertices = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
    return ClothMesh.from_surface(vertices, np.array(faces), warp=(1.0, 0.0, 0.0)), list(range(10))


def _events() -> list[FailureScene]:
    hung, corners = HUNG

    def harden(stage: FrameConditions) -> None:
        stretch = 1e7 if 1.0 <= stage.time < 2.0 else 500.0
        if stage.fabric.stretch_warp != stretch:
            stage.fabric = replace(COTTON, stretch_warp=stretch, stretch_weft=stretch, shear=0.3 * stretch)

    soft = replace(COTTON, stretch_warp=500.0, stretch_weft=500.0, shear=150.0)
    return [
        FailureScene("a stiffness step during the run", "E h 500, 1e7, 500 N/m", hung, soft, corners, seconds=3.5,
              direct=harden, quiet=2.0),
    ]  # fmt: skip
