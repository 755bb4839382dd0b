"""The one module that sets Taichi up.

Every kernel of the project is written against the ``ti`` that this module exports. With ``GUBE_ENGINE=quadrants`` in
the environment it is the maintained fork Quadrants (``pip install gube[quadrants]``). Importing the module is cheap:
Taichi itself is loaded, but no runtime is created before :func:`ensure_initialized`. Code that depends on the insides
of Taichi is in :mod:`pbd.taichi_internals`.
"""

from __future__ import annotations

import io
import os
import threading
import time
import warnings
from contextlib import redirect_stdout, suppress
from pathlib import Path
from typing import Any

from pbd.errors import InputError

ENGINES = {"taichi": "TI", "quadrants": "QD"}  # and what their settings in the environment begin with
_engine = os.environ.get("GUBE_ENGINE", "taichi")
_prefix = ENGINES.get(_engine, "TI")
os.environ.setdefault(f"{_prefix}_ENABLE_TORCH", "0")  # torch, if installed, would add seconds to the import
os.environ.setdefault(f"ENABLE_{_engine.upper()}_HEADER_PRINT", "0")
os.environ.setdefault(f"{_prefix}_ENABLE_PYBUF", "0")  # in a notebook Taichi would announce that it is in one
# Taichi would ask its makers' server for a newer version, in a thread that ends at any time; see _threads.
os.environ.setdefault(f"{_prefix}_SKIP_VERSION_CHECK", "ON")

if _engine == "quadrants":
    import quadrants as ti  # pyright: ignore[reportMissingImports]

    # A call of a kernel with a named tuple is looked up anew each time; those that are called often do not look up.
    warnings.filterwarnings("ignore", message=".*Template mapper caching disabled")
else:
    import taichi as ti

__all__ = ["cuda_is_here", "ensure_initialized", "running_program", "ti"]

COMPILED_FOR = 64  # threads
LOCKED_AT_MOST = 60.0  # far longer than a process reads or writes the compiled kernels [s]

# With other settings kernels round otherwise, or the first frame takes minutes.
NEEDED = {
    "default_fp": ti.f32,
    "default_ip": ti.i32,
    "fast_math": False,  # the same function in two kernels must round alike; costs a tenth of a frame
    # The analysis of control flow takes nine tenths of the time of compiling, and more than in proportion to a kernel's
    # size. It gains nothing where indices are variables of one number: i = f[0], not f[0].
    "cfg_optimization": False,
}

_lock = threading.Lock()
_settings: dict[str, object] = {}
_program: Any = None  # that these are the settings of


def ensure_initialized(arch: str | None = None, *, threads: int | None = None) -> None:
    """Start Taichi once for this process; later calls with the same wishes do nothing.

    ``ti.init`` kills every array of an earlier ``ti.init`` with a bare error, so a call that asks for other settings
    than those that run is refused. A program that calls ``ti.init`` itself, before or later, is joined if its settings
    do (:data:`NEEDED`); else this call and all that need Taichi are refused.

    Args:
        arch: "cpu" or "cuda"; None takes the one that runs, or "cpu".
        threads: CPU threads; None takes the number that runs, or ``GUBE_THREADS``, or all cores.

    Raises:
        InputError: unknown arch, a thread count below one, or a conflict with the running set-up.
    """
    global _settings, _program
    if arch not in (None, "cpu", "cuda"):
        raise InputError("unknown arch", key="arch", received=arch, expected="'cpu' or 'cuda'")
    if threads is not None and threads < 1:
        raise InputError("bad thread count", key="threads", received=threads, expected="at least 1")
    with _lock:
        running = running_program()
        if running is not None:
            if running is not _program:
                _settings, _program = _settings_of(running, anew=_program is not None), running
            if arch in (None, _settings["arch"]) and threads in (None, _settings["threads"]):
                return
            raise InputError(
                "Taichi already runs with other settings in this process",
                received={"arch": arch, "threads": threads},
                expected=f"{_settings}, or a fresh process",
            )
        if _engine not in ENGINES:
            raise InputError("unknown engine", key="GUBE_ENGINE", received=_engine, expected=" or ".join(ENGINES))
        wish = os.environ.get("GUBE_THREADS", "0")
        if not wish.isdecimal():
            raise InputError(
                "bad thread count", key="GUBE_THREADS", received=wish, expected="a whole number, at least 0"
            )
        arch, count = arch or "cpu", threads or int(wish) or _cores()
        _remove_left_lock()
        others = _threads()
        with redirect_stdout(io.StringIO()):  # Taichi prints the arch at every log level
            ti.init(
                arch=ti.cpu if arch == "cpu" else ti.cuda,
                cpu_max_num_threads=count,
                offline_cache=True,
                log_level=ti.ERROR,
                make_thread_local=False,  # nothing is summed over threads; to look for it takes a fifth of compiling
                **NEEDED,
            )
        _program = running_program()
        # Taichi compiles a kernel for a number of threads and keeps it for that number alone. Its threads are started
        # by now, and a kernel for more runs on those that there are: processes of one thread and of several share.
        _program.config().cpu_max_num_threads = max(count, COMPILED_FOR)
        _spread(sorted(_threads() - others), count)
        _settings = {"arch": arch, "threads": count}


def running_program() -> Any:
    """The program of Taichi that runs in this process, whoever started it; None where none does."""
    runtime = ti.lang.impl.get_runtime()
    return runtime._prog if _engine == "quadrants" else runtime.prog


def _settings_of(program: Any, anew: bool) -> dict[str, object]:
    """Settings of a program of Taichi that was started by ``ti.init`` elsewhere.

    Args:
        program: the running one.
        anew: whether another one ran before, and ended by this.

    Raises:
        InputError: settings with which kernels would round otherwise, or take minutes to compile.
    """
    config = program.config()
    archs = {arch: name for name, arch in (("cpu", ti.cpu), ("cuda", ti.cuda))}
    other = {name: getattr(config, name) for name, value in NEEDED.items() if getattr(config, name) != value}
    other = {name: value if isinstance(value, bool) else value.to_string() for name, value in other.items()}
    if config.arch not in archs:
        other["arch"] = config.arch.name
    if other:
        raise InputError(
            f"Taichi {'was started anew' if anew else 'already runs'} with settings that gube cannot use",
            key=f"{ti.__name__}.init",
            received=other,
            expected="gube.ensure_initialized() instead, or fast_math=False, cfg_optimization=False, "
            "numbers of 32 bits, and a CPU or CUDA",
        )
    return {"arch": archs[config.arch], "threads": config.cpu_max_num_threads}


def _cores() -> int:
    """Cores that this process may use: threads that share a core wait for one another very long."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _threads() -> set[int]:
    """Numbers of this process's threads; none where the system does not list them.

    A list that is read while a thread ends may lack another one (``next_tid`` in fs/proc/base.c of Linux): it counts
    when it comes twice.
    """
    before: set[int] | None = None
    with suppress(OSError):
        while (found := {int(name) for name in os.listdir("/proc/self/task")}) != before:
            before = found
        return found
    return set()


def _spread(started: list[int], count: int) -> None:
    """Give the threads that Taichi has started a core each, in turns, if there are cores for them.

    They sleep between two launches, and Linux tends to wake all of them on one core, where they stay for a frame: two
    were as fast as one. Those that share a loop have been started one after the other.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    if 1 < count <= len(cores):
        for number, thread in enumerate(started):
            with suppress(OSError):  # it has ended
                os.sched_setaffinity(thread, {cores[number % count]})


def _remove_left_lock() -> None:
    """Remove the lock of a process that was killed while it read or wrote the compiled kernels.

    Taichi waits some seconds for it at every start, and then neither reads nor keeps any kernel, without a word.
    """
    path = os.environ.get(f"{_prefix}_OFFLINE_CACHE_FILE_PATH") or ti.lang.impl.default_cfg().offline_cache_file_path
    lock = Path(path) / f"{_prefix.lower()}cache.lock"
    with suppress(OSError):  # there is none, or it is another user's
        if time.time() - lock.stat().st_mtime > LOCKED_AT_MOST:
            lock.unlink()


def cuda_is_here() -> bool:
    """Whether there is an NVIDIA GPU with its driver."""
    return bool(getattr(ti.lang.impl, f"_{_prefix.lower()}_core").with_cuda())
