"""Every public function that takes arrays refuses those of another kind with InputError, and takes good ones."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import gube
from assets.character import Clip
from pbd.arrays import floats, integers
from pbd.limits import Limits, LimitTargets
from pbd.models.stepping import Options
from runtime.play.simulation import body_source
from tests.refusals import refuses
from tests.runtime.players import skirt_database, skirt_stage
from tests.wrinkles.databases import small_database

GRID = gube.ClothMesh.grid(1.0, 1.0, 2, 2)
COUNT, FACES = len(GRID.vertices), len(GRID.faces)
SIDES, CORNERS = GRID.vertices[GRID.faces], GRID.vertices[GRID.faces][:, :, [1, 0]]
THREE = np.array([0.1, 0.2, 0.3])
ONES = np.ones(FACES)
BENDS = np.zeros(8)  # of the hinges of the grid
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
CORNER_POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0]])
FRAMES = np.stack([GRID.vertices, GRID.vertices + 0.1])


@cache
def model() -> gube.Model:
    """A sheet with held vertices, a stitch and a limited vertex."""
    mesh = replace(GRID, stitches=np.array([[0, 4, 5]], np.int32), stitch_weights=np.array([0.5]))
    return gube.build_model(
        mesh, gube.load_fabric("cotton"), np.array([2, 8]), limits=Limits(np.array([1]), *np.full((3, 1), 0.1))
    )


@cache
def solver(name: str = "default") -> Any:
    return gube.make_solver(name, model() if name == "default" else gube.build_model(GRID, gube.load_fabric("cotton")))


def step(name: str = "default", change: dict[str, Any] | None = None, **arguments: Any) -> None:
    state = gube.State.at_rest(solver(name).model)
    for attribute, value in (change or {}).items():
        setattr(state, attribute, value)
    solver(name).step(state, gube.Colliders(), 1.0 / 240.0, **arguments)


@cache
def body() -> gube.Character:
    character = skirt_stage().body
    assert isinstance(character, gube.Character)
    return character


@cache
def dressed() -> gube.Simulation:
    """A sheet that falls beside the mannequin."""
    sheet = gube.build_model(GRID, gube.load_fabric("cotton"))
    return gube.Simulation(sheet, None, body_source(body()), body().bind_pose())


@cache
def player() -> gube.Player:
    return gube.Player(skirt_database(), body())


def placed(call: str, array: Any) -> None:
    getattr(gube.Body(TRIANGLES, 4), call)(array)


def collided(*primitives: Any) -> None:
    gube.Colliders(primitives).rows(np.zeros(3))
    gube.Colliders(primitives).fields(np.zeros(3))


def field(**changes: Any) -> gube.DistanceField:
    return gube.DistanceField(**{"values": np.ones((2, 2, 2)), "origin": THREE, "spacing": 0.1} | changes)


def character(name: str, array: Any) -> None:
    replace(body(), **{name: array})


def rest_local(number: int, array: Any) -> None:
    parts = list(body().rest_local)
    parts[number] = array
    replace(body(), rest_local=tuple(parts))


def local(call: str, number: int, array: Any) -> None:
    parts = list(body().rest_local)
    parts[number] = array
    getattr(body(), call)(*parts)


def clip(name: str, array: Any) -> None:
    good = {
        "translation": np.zeros((2, 1, 3)),
        "rotation": np.tile([0.0, 0, 0, 1], (2, 1, 1)),
        "scale": np.ones((2, 1, 3)),
    }
    Clip("a", 30.0, **good | {name: array})


def cloth(**changes: Any) -> None:
    given: dict[str, Any] = {"vertices": GRID.vertices, "faces": GRID.faces, "flat": GRID.flat}
    gube.ClothMesh(**given | changes)


def limited(name: str, array: Any) -> None:
    given = {part: np.zeros((1, 3)) for part in LimitTargets._fields} | {name: array}
    step(limit_targets=LimitTargets(**given))


def baked(folder: Any, **changes: Any) -> None:
    given = {"garment_faces": GRID.faces, "garment_frames": FRAMES} | changes
    gube.bake_glb(folder / "a.glb", rate_hz=30.0, **given)


def pose() -> np.ndarray:
    return body().bind_pose()


NAMES = ("translation", "rotation", "scale")
# What takes an array, by "name(argument)": the call, and a good array or what makes one.
CALLS: dict[str, tuple[Callable[..., Any], Any]] = {
    "Body(faces)": (lambda a: gube.Body(a, 4), TRIANGLES),
    "Body.advance(vertices)": (lambda a: placed("advance", a), CORNER_POINTS),
    "Body.place(vertices)": (lambda a: placed("place", a), CORNER_POINTS),
    "Body.thinned(vertices)": (lambda a: gube.Body(TRIANGLES, 4).thinned(a, 0.1), CORNER_POINTS),
    "Body.move_origin(origin)": (lambda a: placed("move_origin", a), THREE),
    "Capsule(start)": (lambda a: collided(gube.Capsule(a, THREE, 0.1)), np.zeros(3)),
    "Capsule(end)": (lambda a: collided(gube.Capsule(np.zeros(3), a, 0.1)), THREE),
    "Plane(point)": (lambda a: collided(gube.Plane(a)), THREE),
    "Plane(normal)": (lambda a: collided(gube.Plane(THREE, a)), THREE),
    "Sphere(centre)": (lambda a: collided(gube.Sphere(a, 0.1)), THREE),
    "DistanceField(values)": (lambda a: field(values=a), np.ones((2, 3, 2))),
    "DistanceField(origin)": (lambda a: field(origin=a), THREE),
    "DistanceField(position)": (lambda a: collided(field(position=a)), THREE),
    "DistanceField(rotation)": (lambda a: collided(field(rotation=a)), np.eye(3)),
    "Colliders.rows(origin)": (lambda a: gube.Colliders([gube.Sphere(THREE, 0.1)]).rows(a), THREE),
    "Colliders.fields(origin)": (lambda a: gube.Colliders([field()]).fields(a), THREE),
    "Character(vertices)": (lambda a: character("vertices", a), lambda: body().vertices),
    "Character(faces)": (lambda a: character("faces", a), lambda: body().faces),
    "Character(joint_parents)": (lambda a: character("joint_parents", a), lambda: body().joint_parents),
    "Character(joint_indices)": (lambda a: character("joint_indices", a), lambda: body().joint_indices),
    "Character(joint_weights)": (lambda a: character("joint_weights", a), lambda: body().joint_weights),
    "Character(inverse_bind)": (lambda a: character("inverse_bind", a), lambda: body().inverse_bind),
    "Character(texture)": (lambda a: character("texture", a), lambda: np.zeros((*body().faces.shape, 2))),
    "Character(root_transform)": (lambda a: character("root_transform", a), lambda: body().root_transform),
    **{
        f"Character(rest_local){name}": (lambda a, k=k: rest_local(k, a), lambda k=k: body().rest_local[k])
        for k, name in enumerate(NAMES)
    },
    **{
        f"Character.{call}({name})": (lambda a, k=k, c=call: local(c, k, a), lambda k=k: body().rest_local[k])
        for call in ("joint_transforms", "pose_from_local")
        for k, name in enumerate(NAMES)
    },
    "Clip(translation)": (lambda a: clip("translation", a), np.zeros((2, 1, 3))),
    "Clip(rotation)": (lambda a: clip("rotation", a), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1, 1))),
    "Clip(scale)": (lambda a: clip("scale", a), np.ones((2, 1, 3))),
    "ClothMesh(vertices)": (lambda a: cloth(vertices=a), GRID.vertices),
    "ClothMesh(faces)": (lambda a: cloth(faces=a), GRID.faces),
    "ClothMesh(flat)": (lambda a: cloth(flat=a), GRID.flat),
    "ClothMesh(stitches)": (lambda a: cloth(stitches=a, stitch_weights=np.ones(1)), np.array([[0, 4, 5]])),
    "ClothMesh(stitch_weights)": (
        lambda a: cloth(stitches=np.array([[0, 4, 5], [1, 4, 5]]), stitch_weights=a), np.array([0.5, 0.5]),
    ),
    "ClothMesh(rest_bends)": (lambda a: cloth(rest_bends=a), BENDS),
    "ClothMesh(cloth_areas)": (lambda a: cloth(cloth_areas=a), ONES),
    "ClothMesh(layers)": (lambda a: cloth(layers=a), ONES),
    "ClothMesh(max_stretch)": (lambda a: cloth(max_stretch=a), ONES),
    "ClothMesh.from_surface(vertices)": (lambda a: gube.ClothMesh.from_surface(a, GRID.faces), GRID.vertices),
    "ClothMesh.from_surface(faces)": (lambda a: gube.ClothMesh.from_surface(GRID.vertices, a), GRID.faces),
    "ClothMesh.from_surface(warp)": (
        lambda a: gube.ClothMesh.from_surface(GRID.vertices, GRID.faces, a), THREE,
    ),
    "ClothMesh.from_pattern(vertices)": (
        lambda a: gube.ClothMesh.from_pattern(a, GRID.faces, CORNERS), GRID.vertices,
    ),
    "ClothMesh.from_pattern(faces)": (
        lambda a: gube.ClothMesh.from_pattern(GRID.vertices, a, CORNERS), GRID.faces,
    ),
    "ClothMesh.from_pattern(pattern)": (
        lambda a: gube.ClothMesh.from_pattern(GRID.vertices, GRID.faces, a), CORNERS,
    ),
    "ClothMesh.from_pattern(layers)": (
        lambda a: gube.ClothMesh.from_pattern(GRID.vertices, GRID.faces, CORNERS, a), ONES,
    ),
    "ClothMesh.grid(centre)": (lambda a: gube.ClothMesh.grid(1.0, 1.0, 2, 2, a), THREE),
    "build_model(held)": (lambda a: gube.build_model(GRID, gube.Fabric(), a), np.array([1, 2])),
    "Limits(vertices)": (lambda a: Limits(a, ONES[:2], ONES[:2], ONES[:2]), np.array([1, 2])),
    "Limits(stiffness)": (lambda a: Limits(np.array([1, 2]), ONES[:2], ONES[:2], a), ONES[:2]),
    "Player(pose)": (lambda a: gube.Player(skirt_database(), body(), a), pose),
    "player_of(pose)": (lambda a: gube.player_of(skirt_database(), body(), a), pose),
    "Player.update(pose)": (lambda a: player().update(a, 0.01), pose),
    "Player.update(wind)": (lambda a: player().update(pose(), 0.01, a), THREE),
    "Player.step(pose)": (lambda a: player().step(a, 0.01), pose),
    "Player.step(wind)": (lambda a: player().step(pose(), 0.01, a), THREE),
    "Player.go_back(pose)": (lambda a: player().go_back(player().start, a), pose),
    "Player.of_scene(pose)": (lambda a: gube.Player.of_scene(player().simulation, a, 60.0), pose),
    "Player.drag(target)": (lambda a: player().drag(3, a), THREE),
    "Simulation(pose)": (
        lambda a: gube.Simulation(dressed().model, None, body_source(body()), a), pose,
    ),
    "Simulation.place_body(pose)": (lambda a: dressed().place_body(a), pose),
    "Simulation.step(pose)": (lambda a: dressed().step(a), pose),
    "Simulation.step(wind)": (lambda a: dressed().step(pose(), wind=a), THREE),
    "Simulation.pose_body(pose)": (lambda a: dressed().pose_body(a), pose),
    "Simulation.step_cloth(wind)": (lambda a: dressed().step_cloth(0.01, a), THREE),
    "Simulation.drag(target)": (lambda a: dressed().drag(3, a), THREE),
    "Solver.step(targets)": (lambda a: step(targets=a), GRID.vertices[[2, 8]]),
    "Solver.step(wind)": (lambda a: step(wind=a), THREE),
    "Solver.step(wind) of each vertex": (lambda a: step(wind=a), GRID.vertices),
    **{
        f"Solver.step(limit_targets){name}": (lambda a, n=name: limited(n, a), np.zeros((1, 3)))
        for name in LimitTargets._fields
    },
    "Solver.step(stitch_gaps)": (lambda a: step(stitch_gaps=a), np.zeros((2, 1))),
    "make_solver.step(targets)": (lambda a: step("xpbd", targets=a), np.zeros((0, 3))),
    "make_solver.step(wind)": (lambda a: step("xpbd", wind=a), THREE),
    "make_solver(gravity)": (lambda a: Options(gravity=a), THREE),
    "SolverOptions(gravity)": (lambda a: gube.SolverOptions(gravity=a), THREE),
    "State.at_rest(vertices)": (lambda a: gube.State.at_rest(model(), a), GRID.vertices),
    "State.move_origin(origin)": (lambda a: gube.State.at_rest(model()).move_origin(a), np.ones(3)),
    "Wind(velocity)": (lambda a: gube.Wind(a), THREE),
    "Wind(gust)": (lambda a: gube.Wind((0.0, 0.0, 1.0), gust=a), THREE),
    "Wind.at(points)": (lambda a: gube.Wind((0.0, 0.0, 1.0), 0.2).at(a, 0.0), GRID.vertices),
    "WrinkleDatabase.levels(body_vertices)": (lambda a: small_database().levels(a, TRIANGLES), CORNER_POINTS),
    "WrinkleDatabase.levels(body_faces)": (lambda a: small_database().levels(CORNER_POINTS, a), TRIANGLES),
    "bake_glb(garment_faces)": (lambda a, to: baked(to, garment_faces=a), GRID.faces),
    "bake_glb(garment_frames)": (lambda a, to: baked(to, garment_frames=a), FRAMES),
    "bake_glb(normals)": (lambda a, to: baked(to, normals=a), np.ones_like(FRAMES)),
    "bake_glb(poses)": (lambda a, to: baked(to, body=body(), poses=a), lambda: np.stack([pose()] * 2)),
    "bake_glb(texture)": (lambda a, to: baked(to, texture=a), np.zeros((FACES, 3, 2))),
    "bake_glb(garments)": (lambda a, to: baked(to, garments={"a": a}), np.arange(COUNT)),
}  # fmt: skip


# Objects that other functions make, and one that hands every pose on.
MADE_BY_OTHERS = ("Model", "State", "WrinkleDatabase")
HANDED_ON = {"GarmentGroup.update(poses)", "GarmentGroup.update(wind)"}
ARRAY = re.compile(r"ndarray|Floats|NDArray|Air\b|tuple\[float|Sequence\[float|LimitTargets|^tuple$")


def arguments() -> Iterator[str]:
    """Arguments of the public functions, classes and methods that are arrays by their annotations."""
    for name in gube.__all__:
        value = getattr(gube, name)
        functions = {name: value} if inspect.isroutine(value) else {}
        if inspect.isclass(value) and not issubclass(value, (Exception, tuple)):
            functions = {} if name in MADE_BY_OTHERS else {name: value}
            members = {key: getattr(held, "__func__", held) for key, held in vars(value).items() if key[0] != "_"}
            functions |= {f"{name}.{key}": held for key, held in members.items() if inspect.isfunction(held)}
        for called, function in functions.items():
            for argument in inspect.signature(function).parameters.values():
                if ARRAY.search(str(argument.annotation)):
                    yield f"{called}({argument.name})"


def test_every_argument_that_is_an_array_is_tried() -> None:
    tried = {name.partition(")")[0] + ")" for name in CALLS}
    assert set(arguments()) - HANDED_ON - tried == set()


def bad_arrays(good: np.ndarray) -> Iterator[tuple[str, Any]]:
    """Arrays of another kind than a good one, each with its fault."""
    yield "a number", 1.0
    yield "a word", "many"
    yield "a dictionary", {"a": 1}
    yield "rows of different lengths", [[1.0, 2.0], [3.0]]
    yield "words", np.full(good.shape, "a")
    yield "objects", np.full(good.shape, None)
    yield "complex numbers", good.astype(complex)
    yield "truth values", np.ones(good.shape, bool)
    yield "an axis more", good[None]
    if good.ndim > 1:
        yield "an axis less", good.ravel()
        yield "a column less", good[..., :-1]
        yield "a column more", np.concatenate([good, good[..., :1]], axis=-1)
    if good.size:
        for name, value in (("NaN", np.nan), ("infinite", np.inf)):
            spoiled = good.astype(float)
            spoiled[(-1,) * good.ndim] = value
            yield name, spoiled
    if good.dtype.kind == "i":
        yield "fractions", good + 0.4
        for name, value in (("negative", -2), ("out of range", 2**31)):
            spoiled = good.astype(np.int64)
            spoiled[(-1,) * good.ndim] = value
            yield name, spoiled


@pytest.mark.parametrize("name", CALLS)
def test_bad_arrays_are_refused_and_good_ones_taken(name: str, tmp_path: Any) -> None:
    call, good = CALLS[name]
    run = (lambda array: call(array, tmp_path)) if name.startswith("bake") else call
    good = np.asarray(good() if callable(good) else good)
    if not name.startswith(("Player(", "player_of(")):  # which take seconds, and are tried elsewhere
        run(good)
        run(good.tolist() if good.size else good)
    passed = []
    for fault, array in bad_arrays(good):
        if (name, fault) == ("DistanceField(values)", "a column more"):  # a grid of any size
            continue
        try:
            run(array)
        except gube.InputError as error:
            assert "received" in str(error) and "expected" in str(error), (fault, str(error))
        except Exception as error:  # noqa: BLE001 any other is a fault
            passed.append(f"{fault}: {type(error).__name__}: {error}")
        else:
            passed.append(f"{fault}: taken")
    assert passed == []


@pytest.mark.parametrize("vertex", [-1, 10**6, 2**40, 1.5, np.nan, "1", None, [1], True], ids=str)
@pytest.mark.parametrize("target", [THREE, None], ids=["held", "let go"])
def test_a_vertex_that_is_none_is_not_dragged(vertex: Any, target: np.ndarray | None) -> None:
    before = dressed().state.hash()
    refuses("vertex.*received.*expected", dressed().drag, vertex, target)
    assert dressed().state.hash() == before


def test_a_vertex_may_be_a_number_of_numpy() -> None:
    for vertex in (np.int64(3), np.uint8(3), 3.0):
        dressed().drag(vertex, THREE)  # type: ignore[arg-type]
        assert dressed().vertices[3] == pytest.approx(THREE, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("position", np.zeros((COUNT, 4))),
        ("position", np.zeros((COUNT, 3), np.float32)),
        ("position", [[0.0] * 4] * COUNT),
        ("velocity", np.zeros((COUNT, 4), np.float32)),
        ("velocity", None),
        ("nearest", np.zeros(COUNT, np.float32)),
        ("contact_faces", np.zeros((COUNT, 3), np.int32)),
    ],
)
def test_a_state_with_arrays_of_another_kind_is_not_stepped(name: str, array: Any) -> None:
    refuses(f"state.{name}.*another model.*received.*expected", step, change={name: array})


def test_a_body_that_is_written_in_place_must_be_finite_too() -> None:
    body, state = gube.Body(TRIANGLES, 4), gube.State.at_rest(model())
    body.place(CORNER_POINTS)
    body.begin_pose()
    body.current[2, 1] = np.nan
    body.finish_pose()
    before = state.hash()
    refuses("body.*not finite", solver().step, state, gube.Colliders(body=body), 0.01)
    assert state.hash() == before


def test_what_float32_does_not_hold_is_no_body() -> None:
    body = gube.Body(TRIANGLES, 4)
    body.place(CORNER_POINTS)
    refuses("not finite", body.advance, 1e300 * CORNER_POINTS)
    assert np.array_equal(body.current, CORNER_POINTS.astype(np.float32))


def test_a_bad_time_step_leaves_the_time_as_it_is() -> None:
    falling = gube.Simulation(dressed().model)
    for dt in (np.nan, -0.1, "a", [0.1]):
        with pytest.raises(gube.InputError, match="dt"):
            falling.step(dt=dt)  # type: ignore[arg-type]
    assert falling.time == 0.0


def test_whole_numbers_may_come_as_floating_point_numbers() -> None:
    mesh = gube.ClothMesh.from_surface(GRID.vertices, GRID.faces.astype(float))
    assert mesh.faces.dtype == np.int32 and np.array_equal(mesh.faces, GRID.faces)


def test_an_array_is_handed_on_as_it_is() -> None:
    array = np.zeros((4, 3), np.float32)
    assert floats(array, "a", ("n", 3)) is array and integers(TRIANGLES, "b", ("m", 3), 4) is TRIANGLES


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (
            lambda: floats(np.zeros((4, 2)), "a", ("n", 3)),
            "a: bad shape (received (4, 2), expected finite numbers, shape (n, 3))",
        ),
        (
            lambda: floats([0, np.inf], "a", (2,)),
            "a[1]: values that are not finite (received inf, expected finite numbers, shape (2,))",
        ),
        (lambda: floats("x", "a", (2,)), "a: no numbers (received 'str', expected finite numbers, shape (2,))"),
        (lambda: floats([[1], []], "a", (2,)), "a: no array (received 'list of rows of different lengths', expected"),
        (
            lambda: floats([1], "a", [(3,), ("n", 3)], "bad air"),
            "a: bad air (received (1,), expected finite numbers, shape (3,) or (n, 3))",
        ),
        (
            lambda: integers([1, 2.5], "a", ("n",), 9),
            "a[1]: no whole number (received 2.5, expected whole numbers, 0 to 8)",
        ),
        (
            lambda: integers([[1, 9]], "a", ("n", 2), 9, outside="gone"),
            "a[0]: gone (received 9, expected whole numbers, 0 to 8)",
        ),
        (lambda: integers(-1, "a", (), 9), "a: out of range (received -1, expected whole numbers, 0 to 8)"),
    ],
)
def test_messages_name_what_came_and_what_is_expected(check: Callable[[], Any], message: str) -> None:
    refuses(re.escape(message), check)
