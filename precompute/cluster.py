"""The machines of a Dask cluster as workers (`--scheduler`)."""

from __future__ import annotations

import hashlib
import pickle
import queue
import re
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

import assets
import pbd
import precompute
import runtime
import wrinkles
from pbd.errors import InputError
from pbd.fingerprint import source_fingerprint
from precompute.workers import GLANCE, Workers, limit_threads, timed

__all__ = ["ClusterWorkers", "cache_here", "local_cluster", "workers_of"]

Result = TypeVar("Result")
Job = Callable[[], Any]
Known = dict[int, tuple[Any, Any]]  # by an argument's identity: itself, so that it lives on, and how it travels

LARGE = 1 << 16  # arguments from this size on travel apart from their job, once for all jobs that have them [bytes]
KEPT = 32  # arguments that stay on the cluster for jobs to come
PATIENCE = 60.0  # how long a cluster may be without workers [s]

_lock = threading.Lock()  # one job at a time in a process: Taichi is not made for two threads that launch kernels
_caches: dict[Path, Path] = {}  # folder of the client: the same one where this process sees it, else one of its own


class ClusterWorkers(Workers):
    """Processes of a Dask cluster, which need no files of this machine.

    All that a job needs travels with it: arguments that several jobs share are sent once, by the hash of their content.
    A job whose process ends is run again by another. Results do not depend on the cluster.

    Args:
        address: of the scheduler, such as ``tcp://10.0.0.1:8786``.
        cache: folder of simulated runs; workers that see it use it too.

    Raises:
        InputError: nobody answers at the address, no worker is there, or one has several threads.
    """

    def __init__(self, address: str, cache: Path | None = None) -> None:
        from distributed import Client

        expected = "the address of a running Dask scheduler, such as tcp://10.0.0.1:8786"
        if not re.fullmatch(r"(tcp|tls)://.+:\d+", address):
            raise InputError("this is no address", key="--scheduler", received=address, expected=expected)
        try:
            self._client = Client(address, timeout=5.0, set_as_default=False)
        except OSError as error:
            raise InputError("no scheduler answers", key="--scheduler", received=address, expected=expected) from error
        super().__init__(max(2, self._counted(address)))
        self._address, self._cache, self._token = address, cache, f".seen-by-{uuid.uuid4().hex}"
        self._sent: dict[str, Any] = {}  # futures of arguments by the hash of their content, last used last
        if cache is not None:
            cache.mkdir(parents=True, exist_ok=True)
            (cache / self._token).touch()

    def _counted(self, address: str) -> int:
        """Number of worker processes."""
        with suppress(TimeoutError):
            self._client.wait_for_workers(1, timeout=10.0)
        threads: Any = self._client.nthreads()
        if not threads or max(threads.values()) > 1:
            received = f"{len(threads)} workers at {address} with {max(threads.values(), default=0)} threads"
            self._client.close()
            expected = "at least one, and each with one thread (dask worker --nthreads 1)"
            raise InputError("these workers cannot be used", key="--scheduler", received=received, expected=expected)
        return len(threads)

    @property
    def sees_files(self) -> bool:
        """Whether all workers see the client's cache, and so probably the files beside it."""
        if self._cache is None:
            return False
        found: Any = self._client.run(Path.exists, self._cache / self._token)
        return all(found.values())

    def run(
        self,
        jobs: Sequence[Callable[[], Result]],
        *,
        done: Callable[[int, Result], None] | None = None,
        meanwhile: Callable[[], None] | None = None,
    ) -> list[Result]:
        """Call every job on the cluster; arguments as for :func:`precompute.workers.run_jobs`."""
        results: dict[int, Result] = {}

        def keep(number: int, result: Result) -> None:
            results[number] = result
            if done is not None:
                done(len(results), result)

        self.run_in_steps(jobs, keep, meanwhile)
        return [results[number] for number in range(len(jobs))]

    def run_in_steps(
        self,
        jobs: Sequence[Job],
        after: Callable[[int, Any], Job | None],
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        """Call jobs that each may be followed by another, on the process that ran it if that one is free.

        Args:
            jobs: functions that another process finds by name, or ``functools.partial`` of them.
            after: called with the number of the job and its result; gives the job that follows, or None.
            meanwhile: called every few seconds.

        Raises:
            Exception: the first that a job raises; all others are given up.
            concurrent.futures.BrokenExecutor: the scheduler is gone, or there was no worker for a minute.
        """
        running: dict[Any, tuple[int, Known]] = {}
        ended: queue.SimpleQueue[Any] = queue.SimpleQueue()

        def submit(number: int, job: Job, known: Known, where: str | None = None) -> None:
            future = self._submit(job, known, where)
            running[future] = number, known
            future.add_done_callback(ended.put)

        seen = told = time.monotonic()
        try:
            shared: Known = {}
            for number, job in enumerate(jobs):
                submit(number, job, shared)
            while running:
                try:
                    future = ended.get(timeout=GLANCE)
                except queue.Empty:
                    seen = self._watched(seen)
                else:
                    seen = time.monotonic()
                    number, known = running.pop(future)
                    result, where = self._result(future)
                    if (following := after(number, result)) is not None:
                        submit(number, following, dict(known), where)
                if meanwhile is not None and time.monotonic() - told > GLANCE:
                    meanwhile()
                    told = time.monotonic()
        finally:
            self._client.cancel(list(running))

    def _submit(self, job: Job, known: Known, where: str | None = None) -> Any:
        """A job's future. ``known`` are the arguments of other jobs; ``where`` ran the one that it follows."""
        function, arguments, named = (job.func, job.args, job.keywords) if isinstance(job, partial) else (job, (), {})
        for one in arguments:
            if id(one) not in known:
                known[id(one)] = one, self._packed(one)
        packed = [known[id(one)][1] for one in arguments]
        return self._client.submit(
            _call, pickle.dumps((function, named)), packed, _version(), (self._cache, self._token),
            key=f"{getattr(function, '__name__', 'job').strip('_')}-{uuid.uuid4().hex}",
            workers=where, allow_other_workers=where is not None, pure=False,
            priority=0 if where is None else 1,  # jobs that have begun go on first, while the process knows them
        )  # fmt: skip

    def _packed(self, argument: Any) -> Any:
        """Bytes, or where these are many the future of bytes that were sent before, for this job or another."""
        content = pickle.dumps(argument)
        if len(content) < LARGE:
            return content
        digest = hashlib.sha256(content).hexdigest()
        # As a task, and not scattered: data lost with a worker are then made again. Under a key of its
        # own each time: data that come again under a key that is being released may be lost.
        future = self._sent.pop(digest, None) or self._client.submit(bytes, content, key=f"{digest}-{uuid.uuid4().hex}")
        self._sent[digest] = future
        while len(self._sent) > KEPT:
            self._sent.pop(next(iter(self._sent)))
        return future

    def _result(self, future: Any) -> tuple[Any, str]:
        """What a job gave, and where."""
        from distributed import CancelledError, KilledWorker

        if future.status == "error":
            error = future.exception()
            if isinstance(error, KilledWorker):
                raise BrokenExecutor(f"several workers ended while they ran one job: {error}") from error
            raise error
        try:
            result, process, spent, where = future.result()
        except (CancelledError, OSError) as error:
            raise BrokenExecutor(f"the scheduler at {self._address} is gone") from error
        self._spent[f"{where} {process}"] = max(spent, self._spent.get(f"{where} {process}", 0.0))
        return result, where

    def _watched(self, seen: float) -> float:
        """When a worker was last seen."""
        self._check_scheduler()
        if self._client.nthreads():
            return time.monotonic()
        if time.monotonic() - seen > PATIENCE:
            raise BrokenExecutor(f"the cluster at {self._address} has had no worker for {PATIENCE:.0f} s")
        return seen

    def _check_scheduler(self) -> None:
        if self._client.status != "running":
            raise BrokenExecutor(f"the scheduler at {self._address} is gone")

    def __exit__(self, *error: Any) -> None:
        if self._cache is not None:
            (self._cache / self._token).unlink(missing_ok=True)
        self._client.close()


@lru_cache(maxsize=1)
def _version() -> str:
    """Hash of all code that results depend on."""
    return source_fingerprint(pbd, assets, wrinkles, runtime, precompute)


def _call(
    packed: bytes, arguments: Sequence[bytes], version: str, cache: tuple[Path | None, str]
) -> tuple[Any, int, float, str]:
    """Run a job in a process of the cluster: its result, and where it ran as the client counts processes."""
    from distributed import get_worker

    worker = get_worker()
    if version != _version():
        expected = "the code of the process that sends the work"
        raise InputError("a worker has other code", key="--scheduler", received=worker.address, expected=expected)
    with _lock, threadpool_limits(1, user_api="blas"):
        limit_threads()
        folder, token = cache
        if folder is not None and folder not in _caches:
            own = Path(worker.local_directory) / "gube-cache"  # of this worker alone, and ends with it
            _caches[folder] = folder if (folder / token).exists() else own
        function, named = pickle.loads(packed)  # noqa: S301 - from the scheduler's other side, not from a file
        job = partial(function, *(pickle.loads(one) for one in arguments), **named)  # noqa: S301
        return *timed(job), worker.address


def cache_here(cache: Path) -> Path:
    """The folder that stands for the client's cache in this process: another one only on a machine that lacks it."""
    return _caches.get(cache, cache)


def local_cluster(count: int) -> Any:
    """A scheduler with workers on this machine, which no other machine reaches: a ``distributed.LocalCluster``."""
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=count, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0", silence_logs=50,
    )  # fmt: skip


@contextmanager
def workers_of(scheduler: str | None, count: int, cache: Path | None = None) -> Iterator[Workers]:
    """Workers on this machine, or on a cluster.

    Args:
        scheduler: address of a Dask scheduler; ``local`` starts one with its workers on this machine, which end with
            the block; None takes processes of this machine without one.
        count: processes on this machine.
        cache: folder of simulated runs.

    Raises:
        InputError: Dask is not installed, or as for :class:`ClusterWorkers`.
    """
    if scheduler is None:
        with Workers(count) as workers:
            yield workers
        return
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        expected = "pip install 'gube[cluster]'"
        raise InputError("Dask is not installed", key="--scheduler", received=scheduler, expected=expected) from error
    if scheduler != "local":
        with ClusterWorkers(scheduler, cache) as workers:
            yield workers
        return
    with local_cluster(count) as cluster, ClusterWorkers(cluster.scheduler_address, cache) as workers:
        yield workers
