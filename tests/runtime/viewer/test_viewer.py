"""The viewer's loop with real clients of its server, but without a browser: it waits for none of them."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pygltflib
import pytest
import viser
import zstandard
from websockets.sync.client import ClientConnection, connect

from assets.io.scene import load_scene
from assets.io.view_settings import ViewSettings
from runtime.viewer import opened_view
from runtime.viewer.colors import CLOTH_COLORS
from runtime.viewer.garments import FabricFactors
from runtime.viewer.opened_view import Opened, open_source
from runtime.viewer.saving import clip_frames
from runtime.viewer.sources import DatabaseSource
from runtime.viewer.viewer import Viewer
from tests.refusals import refuses
from tests.runtime.viewer.views import FLAG, outfit_source, skirt_source
from wrinkles.database_file import write_database

PATIENCE_S = 60.0


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[Viewer]:
    made = Viewer(Opened(skirt_source()), tmp_path / "saved", port=0)
    yield made
    made.close()


def run(viewer: Viewer, *actions: Callable[[], Any]) -> list[Any]:
    """Run the loop until actions beside it, each on a thread of its own, have ended; their results."""
    stop, results = threading.Event(), [None] * len(actions)

    def act(index: int) -> None:
        results[index] = actions[index]()

    threads = [threading.Thread(target=act, args=(index,)) for index in range(len(actions))]

    def end() -> None:
        for thread in threads:
            thread.join()
        stop.set()

    threads_end = threading.Thread(target=end)
    for thread in (*threads, threads_end):
        thread.start()
    viewer.run(stop)
    threads_end.join()
    return results


def check_box(viewer: Viewer, label: str, value: bool) -> None:
    """Set a box of the window as a browser does."""
    boxes = viewer._controls._gui._gui_input_handle_from_uuid.values()
    box = next(box for box in boxes if box.label == label)
    box.value = value
    for act in box._impl.update_cb:
        asyncio.run(act(SimpleNamespace(client_id=0)))


def until(happened: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.01)


def more_frames(viewer: Viewer, count: int) -> None:
    """Wait until the loop has made so many more frames."""
    wanted = viewer.frame_count + count
    until(lambda: viewer.frame_count >= wanted)


def connected(port: int) -> ClientConnection:
    """A connection to a viewer, as its own page opens it."""
    protocol: Any = f"viser-v{viser.__version__}"
    origin: Any = f"http://127.0.0.1:{port}"
    return connect(
        f"ws://127.0.0.1:{port}",
        origin=origin,
        subprotocols=[protocol],
        max_size=None,
        compression=None,
        close_timeout=0.5,  # one that has stalled would have to read all that waits for it first
    )


def pictures_in(message: bytes) -> bool:
    """Whether a message from the server moves a garment."""
    packed = int.from_bytes(message[8:16], "little")
    content = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(message[16 : 16 + packed]))
    return any(
        part.get("type") == "SceneNodeUpdateMessage"
        and "vertices" in part["updates"]
        and not part["name"].endswith("/body")
        for part in content["messages"]
    )


def receive(port: int, count: int) -> int:
    """Connect and receive so many pictures of the garment."""
    received = 0
    with connected(port) as client:
        while received < count:
            received += pictures_in(bytes(client.recv(timeout=PATIENCE_S)))
    return received


def test_pictures_reach_two_clients_while_others_stall_and_leave(viewer: Viewer) -> None:
    port, finished = viewer.port, threading.Event()

    def stall() -> None:
        with connected(port):
            finished.wait(PATIENCE_S)

    def leave() -> int:
        receive(port, 2)
        return viewer.frame_count

    def watch_both() -> int:
        try:
            more_frames(viewer, 5)
            return receive(port, 12)
        finally:
            finished.set()

    one, two, _, left_at = run(viewer, watch_both, lambda: receive(port, 12), stall, leave)
    assert one == two == 12
    assert left_at < viewer.frame_count  # the loop went on without the one that left
    assert viewer.playback.tick_count > 0


def test_what_waits_for_a_stalled_client_does_not_grow(viewer: Viewer) -> None:
    """A newer state of the same thing takes the place of an older one that was not sent yet."""
    kept = viewer._server._websock_server._broadcast_buffer.message_from_id

    def stall() -> tuple[int, int]:
        with connected(viewer.port):
            more_frames(viewer, 25)
            early = len(kept)
            more_frames(viewer, 60)
            return early, len(kept)

    ((early, late),) = run(viewer, stall)
    assert late <= early + 5


def test_a_late_client_gets_the_whole_picture(viewer: Viewer) -> None:
    run(viewer, lambda: more_frames(viewer, 10))
    viewer.playback.playing = False
    assert run(viewer, lambda: receive(viewer.port, 1)) == [1]


def obey(viewer: Viewer, act: Callable[[], Any]) -> None:
    """Put a command into the queue, as a control does, and let the loop carry it out and make two more frames."""
    done = threading.Event()

    def act_and_tell() -> None:
        try:
            act()
        finally:
            done.set()

    viewer._controls.commands.put(act_and_tell)
    run(viewer, lambda: (done.wait(PATIENCE_S), more_frames(viewer, 2)))


def test_commands_change_time_look_wind_and_fabric(viewer: Viewer) -> None:
    obey(viewer, viewer.toggle)
    assert not viewer.playback.playing
    stood = viewer.playback.tick_count
    obey(viewer, lambda: viewer.step(2))
    assert viewer.playback.tick_count == stood + 2
    obey(viewer, lambda: viewer.scrub(0.0))
    assert viewer.playback.tick_count == 0
    obey(viewer, lambda: viewer.show(meshes=("coarse", "smooth", "ours"), overlaid=True, coloring="strain"))
    obey(viewer, lambda: viewer.show(overlaid=False, wireframe=True, body=False, coloring="bending"))
    assert viewer.look.coloring == "bending" and viewer.look.wireframe
    obey(viewer, lambda: viewer.set_wind(2.0, 90.0, 0.3))
    assert viewer.playback.wind.velocity == pytest.approx((2.0, 0.0, 0.0)) and viewer.playback.wind.turbulence == 0.3
    obey(viewer, lambda: viewer.set_factors(FabricFactors(bending=3.0)))
    run(viewer, lambda: until(lambda: viewer.factors.bending == 3.0))
    assert viewer.playback.player.simulation.model.fabric.bend_warp == pytest.approx(
        3.0 * viewer._source.database.fabric.bend_warp
    )


def test_garments_of_an_outfit_are_taken_off_and_put_on(tmp_path: Path) -> None:
    viewer = Viewer(Opened(outfit_source(), ViewSettings(garments=("skirt",))), tmp_path, port=0)
    try:
        run(viewer, lambda: more_frames(viewer, 10))
        assert viewer._garment.worn == ("skirt",)
        obey(viewer, lambda: viewer.wear(("trousers", "skirt")))
        assert viewer._garment.worn == ("trousers", "skirt") and viewer.playback.tick_count > 0
        nodes = viewer._stage._nodes
        assert [nodes[f"ours/{number}"].color for number in (0, 1)] == list(CLOTH_COLORS[:2])
        assert nodes["ours/0"].visible and not nodes["ours/garment"].visible
        assert all(name in viewer._controls._legend.content for name in ("trousers", "skirt"))
        obey(viewer, lambda: viewer.scrub(0.0))
        assert viewer.playback.tick_count == 0
        obey(viewer, lambda: viewer.wear(()))  # the last garment stays on, and the window says why
        assert viewer._garment.worn == ("trousers", "skirt")
        assert "at least one of trousers, skirt" in viewer._controls._status.content
        obey(viewer, lambda: viewer.wear(("trousers",)))
        obey(viewer, lambda: viewer.save_scene(np.ones(3), np.zeros(3), 0.5))
        assert 'garments = ["trousers"]' in (tmp_path / "view_1.toml").read_text()
        check_box(viewer, "skirt", True)
        run(viewer, lambda: until(lambda: viewer._garment.worn == ("trousers", "skirt")))
        check_box(viewer, "smooth", True)
        run(viewer, lambda: until(lambda: "smooth" in viewer.look.meshes))
        assert viewer._garment.worn == ("trousers", "skirt")
    finally:
        viewer.close()


def test_what_moves_is_in_the_vertices_alone(viewer: Viewer) -> None:
    """A browser that takes places and vertices over at different times still shows the body in the middle."""
    nodes = viewer._stage._nodes
    begun = viewer._stage.place.copy()
    run(viewer, lambda: more_frames(viewer, 90))
    assert np.linalg.norm(viewer._stage.place - begun) > 0.05
    assert nodes["ours"].position == pytest.approx(np.zeros(3), abs=1e-9)
    assert nodes["ours/body"].vertices.mean(axis=0, dtype=float)[[0, 2]] == pytest.approx(np.zeros(2), abs=1e-4)
    garment, player = nodes["ours/garment"].vertices, viewer.playback.player
    seen = garment.mean(axis=0, dtype=float) + viewer._stage.place
    assert seen == pytest.approx((player.vertices + player.origin).mean(axis=0, dtype=float), abs=0.1)


def test_a_drag_holds_the_vertex_under_the_mouse(viewer: Viewer) -> None:
    """A drag as viser tells it: points in the window, not in the world."""
    playback, stage = viewer.playback, viewer._stage
    state = playback.player.simulation.state
    vertex = playback.nearest_free_vertex(state.world().mean(axis=0) + [0.0, -0.4, 0.3])
    seen = state.world()[vertex] - stage.place
    obey(viewer, lambda: viewer._drag("start", "ours", seen + [0.001, 0.0, 0.0]))
    assert playback.dragged is not None and playback.dragged[0] == vertex
    pulled = seen + [0.001, 0.05, 0.1]
    obey(viewer, lambda: viewer._drag("update", "ours", pulled))
    expected = seen + stage.place + [0.0, 0.05, 0.1]
    assert playback.player.simulation.state.world()[vertex] == pytest.approx(expected, abs=0.02)
    obey(viewer, lambda: viewer._drag("end", "ours", pulled))
    assert playback.dragged is None


def test_bad_commands_are_told_and_the_loop_goes_on(viewer: Viewer) -> None:
    obey(viewer, lambda: viewer.scrub(float("inf")))
    assert "bad time" in viewer._controls._status.content
    run(viewer, lambda: more_frames(viewer, 2))


def test_cloth_that_goes_out_of_bounds_starts_again(viewer: Viewer) -> None:
    viewer.playback.step(4)
    viewer.playback.playing = True
    viewer.playback.player.simulation.state.velocity[:] = np.nan
    run(viewer, lambda: more_frames(viewer, 3))
    assert "starts again" in viewer._controls._status.content
    assert viewer.playback.playing and np.isfinite(viewer.playback.player.vertices).all()


def test_another_choice_starts_again_with_its_own_meshes(viewer: Viewer) -> None:
    obey(viewer, lambda: viewer.show(meshes=("coarse", "ours"), coloring="novelty"))
    garment = viewer._garment
    obey(viewer, lambda: viewer.choose(wrinkles=True))
    assert viewer._garment is not garment
    assert viewer.look.meshes == ("coarse", "ours") and viewer.look.coloring == "novelty"
    assert viewer.playback.player is viewer._garment.player


def test_a_saved_view_opens_as_it_was(tmp_path: Path) -> None:
    """The scene file of a view has the same time, look, wind, fabric and camera."""
    database = tmp_path / "skirt.h5"
    write_database(database, skirt_source().database)
    viewer = Viewer(open_source(database), tmp_path / "saved", port=0)
    try:
        obey(viewer, lambda: viewer.step(6))
        obey(viewer, lambda: viewer.show(meshes=("coarse", "ours"), coloring="strain", wireframe=True, follow=False))
        obey(viewer, lambda: viewer.set_wind(3.0, 180.0, 0.25))
        viewer.factors = FabricFactors(bending=2.0)
        eye = np.array([1.0, 1.2, 3.0])
        obey(viewer, lambda: viewer.save_scene(eye, np.array([0.0, 0.9, 0.0]), 0.5))
        at, place = viewer.playback.time, viewer._stage.place
    finally:
        viewer.close()
    saved = tmp_path / "saved" / "view_1.toml"
    opened = open_source(saved)
    assert isinstance(opened.source, DatabaseSource) and opened.source.path == database
    again = Viewer(opened, tmp_path / "saved", port=0)
    try:
        assert again.playback.time == pytest.approx(at, abs=1e-3) and not again.playback.playing
        assert again.look == viewer.look and again.factors == viewer.factors
        assert again.playback.wind.velocity == pytest.approx((0.0, 0.0, -3.0), abs=1e-6)
        camera = again._server.initial_camera
        assert np.array(camera.position) + again._stage.place == pytest.approx(eye + place, abs=1e-3)
        assert camera.fov == pytest.approx(0.5, abs=1e-4)
    finally:
        again.close()


def test_a_clip_holds_what_was_played_and_time_stands_where_it_stood(viewer: Viewer, tmp_path: Path) -> None:
    viewer.playback.step(12)
    before = viewer.playback.tick_count, viewer.playback.player.vertices.copy()
    viewer.save_clip()
    assert viewer.playback.tick_count == before[0]
    assert viewer.playback.player.vertices == pytest.approx(before[1], abs=1e-4)
    clip = tmp_path / "saved" / "clip_1.glb"
    until(clip.exists)
    document: Any = pygltflib.GLTF2().load(str(clip))
    assert document.meshes[0].primitives[0].attributes.TEXCOORD_0 is not None


def test_a_clip_begins_with_the_motion_itself(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    playback = viewer.playback
    playback.step(8)
    all_frames, all_poses, _ = clip_frames(viewer._garment, playback)  # before the motion itself begins
    monkeypatch.setattr("runtime.viewer.saving.clip_begin", lambda motion: 4 * playback.tick)
    frames, poses, _ = clip_frames(viewer._garment, playback)
    assert len(all_frames) > 2 and all_poses is not None and poses is not None
    assert np.array_equal(frames, all_frames[2:]) and np.array_equal(poses, all_poses[2:])


def test_a_picture_is_written_over_the_background_and_names_are_never_taken_twice(
    viewer: Viewer, tmp_path: Path
) -> None:
    drawn = np.zeros((40, 60, 4), np.uint8)
    drawn[10:20, 10:20] = (200, 10, 10, 255)
    camera = SimpleNamespace(image_height=40, image_width=60)
    client = SimpleNamespace(camera=camera, get_render=lambda *_, **__: drawn)
    viewer.save_picture(client)
    viewer.save_picture(client)
    assert sorted(path.name for path in (tmp_path / "saved").iterdir()) == ["picture_1.png", "picture_2.png"]

    def gone(*_: Any, **__: Any) -> None:
        raise RuntimeError("the client disconnected")

    viewer.save_picture(SimpleNamespace(camera=camera, get_render=gone))
    assert "the client disconnected" in viewer._controls._status.content


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (ViewSettings(motion="dance"), "view.motion"),
        (ViewSettings(fabric="tin"), "view.fabric"),
        (ViewSettings(meshes=("ours", "theirs")), "view.meshes"),
        (ViewSettings(garments=("skirt",)), "view.garments"),
    ],
)
def test_a_view_of_what_is_not_there_is_refused(tmp_path: Path, view: ViewSettings, message: str) -> None:
    refuses(message, Viewer, Opened(skirt_source(), view), tmp_path, port=0)


def test_without_a_file_the_demo_is_opened_else_what_comes_with_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert open_source(None).source.path == opened_view.BUILTIN_DATABASE
    write_database(tmp_path / opened_view.DEMO_DATABASE, skirt_source().database)
    assert open_source(None).source.path == opened_view.DEMO_DATABASE


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("walk.fbx", "", "expected a database"),
        ("gone.h5", None, "gone.h5"),
        ("gone.toml", None, "cannot be read"),
        ("empty.h5", "", "empty.h5"),
        ("bad.toml", FLAG + '\n[view]\ncolours = "strain"\n', "view.colours"),
        ("bad.toml", FLAG + '\n[view]\ncolors = "taste"\n', "view.colors"),
        ("bad.toml", FLAG + '\n[view]\ndatabase = "none.h5"\n', "view.database"),
    ],
)
def test_what_cannot_be_viewed_is_refused(tmp_path: Path, name: str, content: str | None, message: str) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    refuses(message, open_source, tmp_path / name)


def test_a_scene_has_no_truth(tmp_path: Path) -> None:
    (tmp_path / "flag.toml").write_text(FLAG)
    assert load_scene(tmp_path / "flag.toml").view is None
    refuses("--truth", open_source, tmp_path / "flag.toml", lambda *_: {})
