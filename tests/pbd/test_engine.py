"""One Taichi for the process; conflicting wishes are refused."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from pbd import ensure_initialized
from pbd.engine import ti
from pbd.geometry import Vec3
from pbd.taichi_internals import Launch
from tests.processes import python
from tests.refusals import refuses

PREFIX, NAME = {"taichi": ("TI", "Taichi"), "quadrants": ("QD", "Quadrants")}[ti.__name__]


def test_the_same_wish_again_does_nothing() -> None:
    ensure_initialized()
    ensure_initialized("cpu")


@pytest.mark.parametrize(
    ("wish", "words"),
    [({"arch": "cuda"}, "already runs"), ({"threads": 10_000}, "already runs"), ({"arch": "gpu"}, "arch")]
    + [({"threads": count}, "threads") for count in (0, -1)],
)
def test_another_wish_and_a_bad_one_are_refused(wish: dict, words: str) -> None:
    refuses(words, ensure_initialized, **wish)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [("GUBE_THREADS", value, value) for value in ("two", "-1", "1.5")]
    + [
        pytest.param(
            "GUBE_ENGINE", "warp", "taichi or quadrants",
            marks=pytest.mark.skipif(PREFIX == "QD", reason="another name asks for Taichi, which need not be there"),
        )
    ],
)  # fmt: skip
def test_a_bad_setting_in_the_environment_is_refused(name: str, value: str, words: str) -> None:
    script = (
        "from pbd import InputError, ensure_initialized\ntry: ensure_initialized()\nexcept InputError as e: print(e)"
    )
    text = python(script, **{name: value})
    assert name in text and words in text


# A program that uses Taichi itself: `fits` and `other` are settings that gube can and cannot use.
OWN_PROGRAM = """
import numpy as np
from pbd import InputError, ensure_initialized
from pbd.engine import ti
from pbd.geometry import surface_normals
from pbd.taichi_internals import Launch

launch = Launch(surface_normals)
def use():
    out = np.zeros((3, 3), np.float32)
    try: launch(np.diag(np.arange(1, 4, dtype=np.float32)), np.array([[0, 1, 2]], np.int32), out)
    except InputError as error: return str(error)
    return out.tobytes().hex()
def start(**settings): ti.init(**{"arch": ti.cpu, "log_level": ti.ERROR, "offline_cache": False} | settings)
fits = {"fast_math": False, "cfg_optimization": False}
others = [
    {"fast_math": True}, {"cfg_optimization": True}, {"default_fp": ti.f64}, {"default_ip": ti.i64}
]
def field():
    mine = ti.field(ti.f32, shape=4)
    mine.fill(3.0)
    return mine
"""


def own_program(script: str) -> list[str]:
    """What such a program prints, without Taichi's own words."""
    return [line for line in python(OWN_PROGRAM + script).splitlines() if not line.startswith(f"[{NAME}]")]


def test_a_program_that_runs_taichi_itself_is_joined() -> None:
    """And goes on with its own arrays; gube's results are those that it has alone, also after a further start."""
    script = """
start(**fits)
mine = field()
print(use(), mine[2])
for wish in ({"arch": "cuda"}, {"threads": 10_000}):
    try: ensure_initialized(**wish)
    except InputError as error: print(error)
start(**fits)
mine = field()
print(use(), mine[2])
ti.reset()
print(use())
"""
    first, arch, threads, second, alone = own_program(script)
    assert first == second == f"{alone} 3.0"
    assert "already runs" in arch and "cuda" in arch and "already runs" in threads and "10000" in threads


@pytest.mark.parametrize("earlier", ["", "use()\n"], ids=["before", "after"])
def test_a_program_that_runs_taichi_with_other_settings_is_refused(earlier: str) -> None:
    script = (
        earlier + "for other in others:\n    start(**fits | other)\n    mine = field()\n    print(use(), mine[2])\n"
    )
    lines = own_program(script)
    names = ("'fast_math': True", "'cfg_optimization': True", "'default_fp': 'f64'", "'default_ip': 'i64'")
    assert len(lines) == len(names)
    for line, name in zip(lines, names, strict=True):
        assert f"init: Taichi {'was started anew' if earlier else 'already runs'} with settings" in line
        assert name in line and "gube.ensure_initialized()" in line and line.endswith(" 3.0")


def _compiled(folder: Path, threads: str = "1") -> tuple[list[str], str]:
    """Kernels that are kept in a folder after a process has used one, and its result."""
    script = (
        "import numpy as np\nfrom pbd import ensure_initialized\nfrom pbd.geometry import surface_normals\n"
        "ensure_initialized()\nout = np.zeros((3, 3), np.float32)\n"
        "surface_normals(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32), out)\nprint(out.tolist())\n"
    )
    result = python(script, GUBE_THREADS=threads, **{f"{PREFIX}_OFFLINE_CACHE_FILE_PATH": str(folder)})
    return sorted(path.name for path in folder.rglob(f"*.{PREFIX[0].lower()}?c")), result


def test_one_thread_and_two_share_compiled_kernels(tmp_path: Path) -> None:
    """Compiling is most of a first frame, and a worker process has one thread."""
    one, two = (_compiled(tmp_path, threads) for threads in ("1", "2"))
    assert one == two and one[0]


@pytest.mark.skipif(PREFIX == "QD", reason="keeps kernels whatever lock there is")
def test_a_lock_that_was_left_does_not_keep_kernels_from_being_kept(tmp_path: Path) -> None:
    lock = tmp_path / f"{PREFIX.lower()}cache.lock"
    lock.touch()
    assert not _compiled(tmp_path)[0] and lock.exists()  # someone may be at work
    os.utime(lock, (0.0, 0.0))
    assert _compiled(tmp_path)[0] and not lock.exists()


@ti.kernel
def _move(
    points: ti.types.ndarray(dtype=ti.math.vec3, ndim=1),
    table: ti.types.ndarray(dtype=ti.f32, ndim=2),
    share: ti.f32,
    way: ti.math.vec3,
    times: ti.i32,
):
    ti.loop_config(serialize=True)
    for i in range(points.shape[0]):
        points[i] += share * times * way + table[i, table.shape[1] - 1]


def _arguments(count: int, columns: int = 2, seed: int = 0) -> tuple:
    random = np.random.default_rng(seed)
    points, table = random.random((count, 3)).astype(np.float32), random.random((count, columns)).astype(np.float32)
    return points, table, random.random(), tuple(random.random(3)), int(random.integers(2, 9))


def _compare(launch: Launch, arguments: tuple) -> None:
    """A launch and an ordinary call write the same bits."""
    expected = arguments[0].copy()
    _move(expected, *arguments[1:])
    launch(*arguments)
    assert np.array_equal(arguments[0], expected)


def _launch() -> Launch:
    """One that has been called before, on arrays that are gone, and that is not an ordinary call any more."""
    ensure_initialized()
    launch = Launch(_move)
    launch(*_arguments(5))
    assert launch._program is not None and not launch._ordinary
    return launch


def test_a_launch_does_what_a_call_does() -> None:
    launch, arguments = _launch(), _arguments(7, seed=1)
    _compare(launch, arguments)
    for seed in range(2, 5):  # the same arrays, other numbers and vectors
        _compare(launch, (*arguments[:2], *_arguments(7, seed=seed)[2:]))
    _compare(launch, (*arguments[:2], np.float64(0.3), np.array([1.0, 2.0, 3.0]), np.int64(2)))


def test_another_array_is_never_taken_for_the_last_one() -> None:
    launch, first, second = _launch(), _arguments(7, seed=1), _arguments(7, seed=2)
    for arguments in (first, second, first, (second[0], *first[1:]), (first[0], *second[1:])):
        _compare(launch, arguments)
    for count in (3, 9, 0, 4):
        _compare(launch, _arguments(count, seed=count))
    assert launch._program is not None


def test_an_array_written_in_place_is_read_anew() -> None:
    launch, arguments = _launch(), _arguments(7)
    _compare(launch, arguments)
    arguments[1][:] = 5.0
    _compare(launch, arguments)
    arguments[1].shape = (14, 1)
    _compare(launch, arguments)
    with pytest.raises(ValueError, match="resize"):
        arguments[0].resize((99, 3))


def test_arrays_of_other_columns_order_or_type_are_taken() -> None:
    launch = _launch()
    _compare(launch, _arguments(7, columns=5))
    _compare(launch, (_arguments(7)[0].astype(np.float64), *_arguments(7)[1:]))
    _compare(launch, (_arguments(7)[0], np.asfortranarray(_arguments(7, columns=4)[1]), 0.5, (1.0, 2.0, 3.0), 2))
    _compare(launch, _arguments(7))


@pytest.mark.parametrize(
    "place, value",
    [
        (0, np.zeros((7, 2), np.float32)),
        (1, np.zeros(7, np.float32)),
        (1, None),
        (2, "1"),
        (3, (1.0, 2.0)),
        (4, 1.5),
    ],
)
def test_a_launch_refuses_what_a_call_refuses(place: int, value: object) -> None:
    launch, arguments = _launch(), _arguments(7)
    launch(*arguments)
    before = arguments[0].copy()
    bad = list(arguments)
    bad[place] = value
    with pytest.raises((TypeError, ValueError, getattr(ti, f"{NAME}RuntimeTypeError"))):
        launch(*bad)
    assert np.array_equal(arguments[0], before)
    _compare(launch, arguments)


def test_without_the_insides_it_knows_a_launch_is_a_call() -> None:
    ensure_initialized()
    launch = Launch(lambda *arguments: _move(*arguments))  # has no Taichi kernel in it
    for seed in range(3):
        _compare(launch, _arguments(7, seed=seed))
    assert launch._ordinary


def test_taichi_arrays_are_taken() -> None:
    launch, arguments = _launch(), _arguments(7)
    points = ti.ndarray(dtype=ti.math.vec3, shape=7)
    points.from_numpy(arguments[0])
    for _ in range(2):
        launch(points, *arguments[1:])
        _move(*arguments)
        assert np.array_equal(points.to_numpy(), arguments[0])
    _compare(launch, arguments)


def test_a_launch_can_be_sent_to_another_process() -> None:
    other = pickle.loads(pickle.dumps(_launch()))  # noqa: S301
    _compare(other, _arguments(7))


def test_the_place_of_an_error_in_a_kernel_is_named() -> None:
    @ti.kernel
    def wrong(points: Vec3):
        points[0] = missing  # pyright: ignore[reportUndefinedVariable] # noqa: F821

    ensure_initialized()
    with pytest.raises(getattr(ti, f"{NAME}CompilationError"), match=r"test_engine\.py.*line \d+, in wrong"):
        wrong(np.zeros((1, 3), np.float32))


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no system that places threads")
@pytest.mark.parametrize("threads", [1, 2])
def test_threads_that_share_a_loop_have_a_core_each(threads: int) -> None:
    script = (
        "import os\nfrom pbd import ensure_initialized\n"
        "from pbd.engine import _threads\nearlier = _threads()\nensure_initialized()\n"
        "print(*sorted(str(sorted(os.sched_getaffinity(t))) for t in _threads() - earlier), sep=';')\n"
        "print(sorted(os.sched_getaffinity(0)))\n"
    )
    placed, own = python(script, GUBE_THREADS=str(threads)).split("\n")[:2]
    cores = sorted(os.sched_getaffinity(0))
    assert own == str(cores)  # the caller's thread goes where it likes
    expected = {str([core]) for core in cores[:2]} if 1 < threads <= len(cores) else {str(cores)}
    assert set(placed.split(";")) == expected


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no system that places threads")
def test_threads_are_counted_by_the_cores_that_the_process_may_use() -> None:
    """Two threads on one core wait for one another very long."""
    script = (
        "import os\nos.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])\n"
        "from pbd import engine\nengine.ensure_initialized()\nprint(engine._settings['threads'])\n"
    )
    assert python(script, GUBE_THREADS=None).strip() == "1"


def test_no_thread_asks_for_a_newer_version() -> None:
    """Taichi's own would, over the network; and it would end while the threads of the engine are listed."""
    script = (
        "import threading\nstarted, start = [], threading.Thread.start\n"
        "threading.Thread.start = lambda self: (started.append(self), start(self))[1]\n"
        "from pbd import ensure_initialized\nensure_initialized()\nprint(started)\n"
    )
    assert python(script, **{f"{PREFIX}_SKIP_VERSION_CHECK": None}).strip() == "[]"
