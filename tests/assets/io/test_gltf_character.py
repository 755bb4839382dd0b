"""Characters out of glTF files: what is read, and what is refused with the element named."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from assets.character import Character
from assets.loading import load_character
from assets.skinning import skin_vertices
from pbd.errors import InputError
from tests.assets.files import Glb, bar_glb, turn_z
from tests.data import data_path
from tests.refusals import refuses


def load(glb: Glb, folder: Path) -> Character:
    return load_character(glb.write(folder / "bar.glb"))


def bent(character: Character, frame: int, clip: str = "bend") -> np.ndarray:
    motion = character.clip(clip)
    pose = character.pose_from_local(motion.translation[frame], motion.rotation[frame], motion.scale[frame])
    return skin_vertices(character, pose)


def test_a_bar_bends_at_its_joint(tmp_path: Path) -> None:
    bar = load(bar_glb(), tmp_path)
    assert (bar.name, bar.joint_names, bar.joint_parents.tolist()) == ("bar", ("root", "tip"), [-1, 0])
    assert (bar.vertices.dtype, bar.faces.dtype, bar.joint_weights.dtype) == (np.float64, np.int32, np.float32)
    assert bar.faces.shape == (8, 3)
    clip = bar.clip("bend")
    assert (clip.rate, clip.frame_count, clip.duration) == (2.0, 3, 1.0)
    top = bent(bar, 2)[-2:]  # turned by 90 degrees about (0, 1, 0): up becomes -x
    np.testing.assert_allclose(top, [[-1.0, 0.75, 0.0], [-1.0, 1.25, 0.0]], atol=1e-6)
    np.testing.assert_allclose(bent(bar, 0), bar.vertices, atol=1e-6)


def test_the_bind_pose_is_the_identity(tmp_path: Path) -> None:
    bar = load(bar_glb(), tmp_path)
    np.testing.assert_allclose(bar.pose_from_local(*bar.rest_local), bar.bind_pose(), atol=1e-6)


def test_texture_seams_close_and_parts_that_move_apart_do_not(tmp_path: Path) -> None:
    glb = bar_glb()
    primitive = glb.json["meshes"][0]["primitives"][0]
    attributes = dict(primitive["attributes"])
    first = load(bar_glb(), tmp_path)
    # A second primitive with the same vertices, of which the lower six carry the same weights as before.
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (10, 1))
    weights[4:6, :2] = 0.5
    attributes["WEIGHTS_0"] = glb.accessor(weights)
    glb.json["meshes"][0]["primitives"].append(primitive | {"attributes": attributes})
    both = load(glb, tmp_path)
    assert len(first.vertices) == 10
    assert len(both.vertices) == 14
    assert len(both.faces) == 16
    assert both.faces[8:].max() == 13  # the upper part of the second primitive has vertices of its own


def test_a_file_in_centimetres_below_a_scaled_node(tmp_path: Path) -> None:
    glb = bar_glb(scale=100.0)
    glb.json["nodes"].append({"name": "armature", "scale": [0.01, 0.01, 0.01], "rotation": turn_z(90), "children": [0]})
    glb.json["scenes"][0]["nodes"] = [3, 2]
    bar = load(glb, tmp_path)
    assert bar.joint_names == ("root", "tip")
    # The joints rest in the bind pose, so they say where the mesh lies: turned, and in metres.
    np.testing.assert_allclose(bar.vertices[-1], [-2.0, 0.25, 0.0], atol=1e-5)
    np.testing.assert_allclose(bar.root_transform[:3, :3], [[0, -0.01, 0], [0.01, 0, 0], [0, 0, 0.01]], atol=1e-9)
    np.testing.assert_allclose(bent(bar, 2)[-1], [-1.25, -1.0, 0.0], atol=1e-5)


def test_nodes_that_rest_in_another_pose_leave_the_bind_pose_alone(tmp_path: Path) -> None:
    plain, glb = load(bar_glb(), tmp_path), bar_glb()
    glb.json["nodes"][1]["rotation"] = turn_z(30)
    moved = load(glb, tmp_path)
    np.testing.assert_allclose(moved.vertices, plain.vertices, atol=1e-6)
    np.testing.assert_allclose(bent(moved, 2), bent(plain, 2), atol=1e-6)


def test_a_node_between_two_joints_becomes_a_joint_without_weight(tmp_path: Path) -> None:
    glb = bar_glb()
    glb.json["nodes"][0]["children"] = [3]
    glb.json["nodes"].append({"name": "helper", "translation": [0.0, 1.0, 0.0], "children": [1]})
    del glb.json["nodes"][1]["translation"]
    bar = load(glb, tmp_path)
    assert bar.joint_names == ("root", "helper", "tip")
    assert bar.joint_parents.tolist() == [-1, 0, 1]
    assert not (bar.joint_indices == 1)[bar.joint_weights > 0].any()
    np.testing.assert_allclose(bent(bar, 2), bent(load(bar_glb(), tmp_path), 2), atol=1e-6)


def test_an_animated_node_above_the_joints_becomes_a_joint(tmp_path: Path) -> None:
    glb = bar_glb()
    glb.json["nodes"].append({"name": "armature", "children": [0]})
    glb.json["scenes"][0]["nodes"] = [3, 2]
    glb.clip("walk", (3, "translation", [0.0, 1.0], [[0, 0, 0], [0, 0, 3]], "LINEAR"))
    bar = load(glb, tmp_path)
    assert bar.joint_names == ("armature", "root", "tip")
    np.testing.assert_allclose(bent(bar, -1, "walk"), bar.vertices + [0, 0, 3], atol=1e-6)


def test_steps_hold_and_cubic_splines_curve(tmp_path: Path) -> None:
    glb = bar_glb()
    still = [[0.0, 0.0, 0.0]]
    # Hermite with no slope at the ends: 3 s^2 - 2 s^3.
    glb.clip("curve", (0, "translation", [0, 1], [still, still, still, still, [[4, 0, 0]], still], "CUBICSPLINE"))
    glb.clip("steps", (0, "translation", [0.0, 0.25, 0.5, 1.0], [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], "STEP"))
    bar = load(glb, tmp_path)
    curve, steps = bar.clip("curve"), bar.clip("steps")
    assert curve.rate == pytest.approx(60.0)
    s = np.linspace(0.0, 1.0, 61)
    np.testing.assert_allclose(curve.translation[:, 0, 0], 4.0 * (3.0 * s**2 - 2.0 * s**3), atol=1e-6)
    assert steps.rate == 4.0  # the shortest time between keys
    assert steps.translation[:, 0, 0].tolist() == [0.0, 1.0, 2.0, 2.0, 3.0]


def test_the_rate_is_that_of_the_keys_and_times_may_start_late(tmp_path: Path) -> None:
    glb = bar_glb()
    times = np.delete(np.arange(5, 50), [7, 8, 30]) / 24.0  # an exporter dropped some keys
    glb.clip("late", (0, "translation", times, np.stack([times, times, times], axis=1), "LINEAR"))
    clip = load(glb, tmp_path).clip("late")
    assert (clip.frame_count, clip.rate) == (45, pytest.approx(24.0))
    np.testing.assert_allclose(clip.translation[:, 0, 1], np.arange(5, 50) / 24.0, atol=1e-6)


def test_the_best_four_of_more_influences_stay(tmp_path: Path) -> None:
    glb = bar_glb()
    glb.json["nodes"][1]["children"] = [3, 4, 5]
    glb.json["nodes"] += [{"name": name} for name in ("a", "b", "c")]
    skin = glb.json["skins"][0]
    skin["joints"] += [3, 4, 5]
    inverse = np.tile(np.eye(4), (5, 1, 1))
    inverse[1:, 1, 3] = -1.0
    skin["inverseBindMatrices"] = glb.accessor(inverse.swapaxes(1, 2))
    attributes = glb.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["JOINTS_0"] = glb.accessor(np.tile([0, 1, 2, 3], (10, 1)), "uint16")
    attributes["WEIGHTS_0"] = glb.accessor(np.tile([0.3, 0.05, 0.2, 0.2], (10, 1)))
    attributes["JOINTS_1"] = glb.accessor(np.tile([4, 0, 0, 0], (10, 1)), "uint8")
    attributes["WEIGHTS_1"] = glb.accessor(np.tile([64, 0, 0, 0], (10, 1)), "uint8", normalized=True)  # 0.251
    bar = load(glb, tmp_path)
    kept = np.array([0.3, 64 / 255, 0.2, 0.2])
    assert [bar.joint_names[j] for j in bar.joint_indices[0]] == ["root", "c", "a", "b"]
    np.testing.assert_allclose(bar.joint_weights[0], kept / kept.sum(), atol=1e-6)


def test_data_in_the_json_and_beside_it(tmp_path: Path) -> None:
    import base64
    import json

    glb = bar_glb()
    glb.bytes()  # fills in the buffer's length
    (tmp_path / "a b.bin").write_bytes(glb.data)
    for uri in ("a%20b.bin", "data:application/octet-stream;base64," + base64.b64encode(glb.data).decode()):
        glb.json["buffers"][0]["uri"] = uri
        (tmp_path / "bar.gltf").write_text(json.dumps(glb.json))
        assert len(load_character(tmp_path / "bar.gltf").vertices) == 10


def morph(glb: Glb, weights: object, rows: int = 10) -> None:
    """Give the bar two morph targets, one that moves its top by 1 m in x and another that moves nothing."""
    moves = np.zeros((rows, 3))
    moves[8:, 0] = 1.0
    target = glb.accessor(moves)
    glb.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": target}, {"NORMAL": target}]
    glb.json["meshes"][0]["weights"] = weights


def test_default_weights_of_morph_targets_shape_the_bind_pose(tmp_path: Path) -> None:
    plain, glb = load(bar_glb(), tmp_path), bar_glb()
    expected = plain.vertices.copy()
    morph(glb, [0.25, 1.0])
    expected[8:, 0] += 0.25
    np.testing.assert_allclose(load(glb, tmp_path).vertices, expected, atol=1e-6)
    glb.json["nodes"][2]["weights"] = [-0.5, 0]  # of the node, instead of the mesh's
    expected[8:, 0] -= 0.75
    np.testing.assert_allclose(load(glb, tmp_path).vertices, expected, atol=1e-6)
    np.testing.assert_allclose(bent(load(glb, tmp_path), 2)[-1], [-1.0, 0.75, 0.0], atol=1e-6)
    glb.json["nodes"][2]["weights"] = [0, 0]
    np.testing.assert_array_equal(load(glb, tmp_path).vertices, plain.vertices)


def test_animated_weights_of_morph_targets_are_left_out(tmp_path: Path) -> None:
    plain, glb = load(bar_glb(), tmp_path), bar_glb()
    morph(glb, [0.0, 0.0])
    glb.clip("smile", (2, "weights", [0.0, 1.0], [0.0, 0.0, 1.0, 0.0], "LINEAR"))
    shown = load(glb, tmp_path)
    assert list(shown.clips) == ["bend"]
    np.testing.assert_array_equal(shown.vertices, plain.vertices)


@pytest.mark.parametrize("base", [False, True])
def test_sparse_numbers_are_put_in_their_places(tmp_path: Path, base: bool) -> None:
    plain, glb = load(bar_glb(), tmp_path), bar_glb()
    morph(glb, [1.0, 0.0])
    entry = glb.json["accessors"][glb.json["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]]
    indices, values = (glb.json["accessors"][k] for k in (glb.accessor([3, 9], "uint16"), glb.accessor(np.eye(3)[:2])))
    entry["sparse"] = {
        "count": 2,
        "indices": {name: indices[name] for name in ("bufferView", "componentType")},
        "values": {"bufferView": values["bufferView"]},
    }
    if not base:
        del entry["bufferView"]  # all others are 0
    expected = plain.vertices.copy()
    expected[8, 0] += base
    expected[3, 0] += 1.0
    expected[9, 1] += 1.0  # instead of 1 in x
    np.testing.assert_allclose(load(glb, tmp_path).vertices, expected, atol=1e-6)


def node(glb: Glb, **entries: object) -> None:
    glb.json["nodes"][2] |= entries


def attribute(name: str, make: Callable[[Glb], int]) -> Callable[[Glb], None]:
    def change(glb: Glb) -> None:
        glb.json["meshes"][0]["primitives"][0]["attributes"][name] = make(glb)

    return change


def numbers(change: Callable[[np.ndarray], None], start: np.ndarray, dtype: str = "float32") -> Callable[[Glb], int]:
    values = start.copy()
    change(values)
    return lambda glb: glb.accessor(values, dtype)


def put(row: int, value: object) -> Callable[[np.ndarray], None]:
    return lambda values: values.__setitem__(row, value)


POSITIONS = np.stack([np.tile([-0.25, 0.25], 5), np.repeat(np.linspace(0, 2, 5), 2), np.zeros(10)], axis=1)
WEIGHTS = np.tile([1.0, 0.0, 0.0, 0.0], (10, 1))
JOINTS = np.zeros((10, 4))

REFUSED: dict[str, tuple[Callable[[Glb], object], str]] = {
    "no skin": (lambda g: g.json["nodes"][2].pop("skin"), "nodes: no skin"),
    "no weights": (
        lambda g: [g.json["meshes"][0]["primitives"][0]["attributes"].pop(n) for n in ("JOINTS_0", "WEIGHTS_0")],
        "mesh bar, primitive 0: a skin without weights",
    ),
    "only joints": (lambda g: g.json["meshes"][0]["primitives"][0]["attributes"].pop("WEIGHTS_0"),
                    "primitive 0, JOINTS_0 and WEIGHTS_0: a skin without WEIGHTS_0"),
    "zero weights": (attribute("WEIGHTS_0", numbers(put(7, 0.0), WEIGHTS)), "vertex 7: a skin without weights"),
    "negative weight": (attribute("WEIGHTS_0", numbers(put(3, -0.5), WEIGHTS)), "vertex 3: bad weights"),
    "NaN weight": (attribute("WEIGHTS_0", numbers(put(3, np.nan), WEIGHTS)), "vertex 3: bad weights"),
    "joint": (attribute("JOINTS_0", numbers(put(5, 2), JOINTS, "uint8")), "vertex 5: a joint that does not exist"),
    "NaN position": (attribute("POSITION", numbers(put(4, np.nan), POSITIONS)), "primitive 0, vertex 4: positions"),
    "infinite": (attribute("POSITION", numbers(put(4, np.inf), POSITIONS)), "primitive 0, vertex 4: positions"),
    "centimetres": (attribute("POSITION", numbers(lambda v: v.__imul__(85), POSITIONS)), "looks like centimetres"),
    "face": (lambda g: g.json["meshes"][0]["primitives"][0].update(indices=g.accessor([0, 1, 2, 0, 1, 10], "uint16")),
             "primitive 0, face 1: a face with a vertex that does not exist"),
    "strip": (lambda g: g.json["meshes"][0]["primitives"][0].update(mode=5), "primitive 0: not a list of triangles"),
    "accessor": (lambda g: g.json["accessors"][0].update(count=10**6), "POSITION, accessor 0: numbers outside"),
    "no accessor": (lambda g: g.json["skins"][0].update(inverseBindMatrices=99), "skin 0, inverseBindMatrices"),
    "sparse": (lambda g: g.json["accessors"][0].update(sparse={}), "accessor 0: sparse"),
    "sparse index": (
        lambda g: g.json["accessors"][0].update(sparse={
            "count": 1, "indices": {"bufferView": g.json["accessors"][g.accessor([10], "uint8")]["bufferView"],
                                    "componentType": 5121}, "values": {"bufferView": 0}}),
        "accessor 0: sparse numbers at an index that does not exist (received 10)",
    ),
    "sparse and endless": (
        lambda g: (g.json["accessors"][0].update(sparse={}, count=10**12), g.json["accessors"][0].pop("bufferView")),
        "accessor 0: sparse numbers that are too many or none",
    ),
    "weights": (lambda g: morph(g, [1.0]), "primitive 0, targets: bad weights (received [1.0], expected 2 numbers"),
    "NaN weights": (lambda g: morph(g, [1.0, float("nan")]), "primitive 0, targets: bad weights"),
    "gigantic weights": (lambda g: morph(g, [1, 10**400]), "primitive 0, targets: bad weights"),
    "words as weights": (lambda g: morph(g, ["1"]), "meshes[0].weights[0]: not glTF"),
    "short target": (lambda g: morph(g, [1, 0], 9), "primitive 0, target 0, POSITION: not three finite numbers"),
    "extension": (lambda g: g.json.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco"),
    "version": (lambda g: g.json["asset"].update(version="1.0"), "asset.version"),
    "kind": (lambda g: g.json["nodes"][1].update(children="tip"), "nodes[1].children: not glTF"),
    "deep kind": (lambda g: g.json["animations"][0]["channels"][0]["target"].update(node=1.5),
                  "animations[0].channels[0].target.node: not glTF"),
    "no triangles": (lambda g: g.json["meshes"][0].update(primitives=[]), "mesh bar: a mesh without triangles"),
    "cycle": (lambda g: g.json["nodes"][1].update(children=[0]), "their own ancestors"),
    "two parents": (lambda g: g.json["nodes"][2].update(children=[1]), "node 1: a node with two parents"),
    "child": (lambda g: g.json["nodes"][1].update(children=[7]), "node 1: a child that does not exist"),
    "quaternion": (lambda g: g.json["nodes"][1].update(rotation=[0, 0, 0, 0]), "node tip: a rotation that is no unit"),
    "flat bind": (
        lambda g: g.json["skins"][0].update(inverseBindMatrices=g.accessor(np.diag([0.0, 0, 0, 1])[None].repeat(2, 0))),
        "inverseBindMatrices, joint 0: a matrix that places no joint",
    ),
    "same joint": (lambda g: g.json["skins"][0].update(joints=[0, 0]),
                   "skin 0: joints that are missing or listed twice"),
    "interpolation": (lambda g: g.json["animations"][0]["samplers"][0].update(interpolation="WOBBLY"),
                      "clip bend, channel 0 (rotation of tip): an unknown interpolation"),
    "times": (lambda g: g.json["animations"][0]["samplers"][0].update(input=g.accessor([0.0, 0.5, 0.5])),
              "clip bend, channel 0 (rotation of tip): times that do not grow"),
    "clip values": (lambda g: g.clip("broken", (0, "translation", [0, 1], [[0, 0, 0], [0, np.nan, 0]], "LINEAR")),
                    "clip broken, channel 0 (translation of root), key 1: values that are not finite"),
    "value count": (lambda g: g.clip("broken", (0, "translation", [0, 1, 2], [[0, 0, 0], [0, 1, 0]], "LINEAR")),
                    "not a value for each time"),
    "no turn": (lambda g: g.clip("broken", (0, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 0]], "LINEAR")),
                "clip broken, channel 0 (rotation of root): a rotation that is no unit quaternion"),
    "endless": (lambda g: g.clip("long", (0, "translation", [0, 0.01, 1e8], np.zeros((3, 3)), "LINEAR")),
                "clip long: a clip too long to sample"),
    "same name": (lambda g: g.clip("bend", (0, "translation", [0, 1], np.zeros((2, 3)), "LINEAR")),
                  "animation 1: two clips of one name"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case: str, tmp_path: Path) -> None:
    change, message = REFUSED[case]
    glb = bar_glb()
    change(glb)
    assert "bar.glb" in refuses(re.escape(message), load, glb, tmp_path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.9, 0.999])
def test_a_truncated_file_is_refused(share: float, tmp_path: Path) -> None:
    data = bar_glb().bytes()
    path = tmp_path / "cut.glb"
    path.write_bytes(data[: int(len(data) * share)])
    refuses(r"cut\.glb: .*(truncated|not a binary glTF)", load_character, path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    refuses(r"absent\.glb: cannot be read", load_character, tmp_path / "absent.glb")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255), length=st.integers(1, 4))
def test_a_damaged_file_loads_or_is_refused(tmp_path: Path, place: float, value: int, length: int) -> None:
    data = bytearray(bar_glb().bytes())
    start = int(place * len(data))
    data[start : start + length] = bytes([value]) * length
    path = tmp_path / "damaged.glb"
    path.write_bytes(data)
    try:
        character = load_character(path)
    except InputError:
        return
    assert np.isfinite(character.vertices).all()


def test_the_woman_of_two_files() -> None:
    cmu = load_character(data_path("characters/mh_female_cmu_rokoko.glb"))
    assert (cmu.vertices.shape, cmu.faces.shape, cmu.joint_count) == ((13380, 3), (26756, 3), 31)
    edges = np.sort(np.stack([cmu.faces, np.roll(cmu.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).all()  # closed: no seam is left open
    assert np.ptp(cmu.vertices[:, 1]) == pytest.approx(1.59, abs=0.01)
    seconds = {name: round(clip.duration, 1) for name, clip in cmu.clips.items()}
    assert seconds == {"jump_turn_cmu_01_01": 22.9, "jumping_jacks_cmu": 4.1, "dance_rokoko": 10.1}
    assert cmu.clip("jump_turn_cmu_01_01").rate == pytest.approx(60.0, abs=0.001)


def test_the_mannequin_of_44_clips() -> None:
    man = load_character(data_path("characters/quaternius_mannequin_44clips.glb"))
    assert (len(man.faces), man.joint_count, len(man.clips)) == (13721, 53, 44)
    assert man.clip("Walk_Loop").rate == pytest.approx(24.0)
    assert man.clip("T-Pose").frame_count == 2
