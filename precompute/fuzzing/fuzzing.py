"""Readers fed with broken files: each must answer with a value or with an ``InputError``, soon and in little memory."""

from __future__ import annotations

import random
import resource
import shutil
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from queue import Empty
from types import FrameType
from typing import Any

import numpy as np

from pbd import InputError
from pbd.storage import replacing

__all__ = ["Escape", "FuzzResult", "fuzz"]

CASE_SECONDS = 5.0  # that a reader may take
MEMORY = 2**30  # that a process may take more than it had when it began [bytes]
ROUND = 400  # cases from one report of a process to the next
TRACED = 10  # every so many cases say which lines they reach
CORPUS = 400  # mutated files of an ending that are kept to go on from
SPARE = 60.0  # after which a process that says nothing is given up, beyond a case's own time [s]
PACKAGES = ("assets", "pbd", "wrinkles", "runtime", "precompute")


@dataclass(frozen=True)
class Escape:
    """A file that a reader did not answer as it should.

    Attributes:
        path: where the file was kept.
        problem: what happened, with the place in the code.
    """

    path: Path
    problem: str


@dataclass
class FuzzResult:
    """What came of all cases.

    Attributes:
        cases: that were read, by the ending of the file.
        refused: those that every reader of their kind refused.
        lines: of the project that were reached, file and number.
        escapes: one of each kind.
    """

    cases: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    lines: set[tuple[str, int]] = field(default_factory=set)
    escapes: dict[str, Escape] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.cases.total()} cases, {len(self.escapes)} escapes, {len(self.lines)} lines"


class _TooLongError(BaseException):
    """A reader that takes too long; no ``except Exception`` of a library catches it."""


def fuzz(
    files: Sequence[Path],
    output: Path,
    *,
    seconds: float,
    workers: int = 1,
    seed: int = 0,
    report: Callable[[str], None] | None = None,
) -> FuzzResult:
    """Read mutated files for a time.

    Args:
        files: good ones, of the endings in :data:`precompute.fuzzing.readers.READERS`.
        output: folder for the files that got through, one of each kind.
        seconds: by the clock, from when its readers are loaded.
        workers: processes.
        seed: of all choices; with one process the same cases come again.
        report: called with lines of progress.

    Raises:
        InputError: a file that nothing reads.
    """
    _check_files(files)
    tell = report or (lambda line: None)
    output.mkdir(parents=True, exist_ok=True)
    result, end, queue = FuzzResult(), time.monotonic() + seconds, get_context("spawn").Queue()
    start = partial(_start, files, output, seed, end, queue)
    running = {number: start(number) for number in range(workers)}
    heard, told, fresh = dict.fromkeys(running, time.monotonic()), time.monotonic(), workers
    while running:
        for number, kind, content in _told(queue):
            heard[number] = time.monotonic()
            _take(result, output, kind, content)
        for number, process in list(running.items()):
            silent = time.monotonic() - heard[number] > CASE_SECONDS + SPARE
            if process.is_alive() and not silent:
                continue
            if silent:
                process.kill()
            process.join()
            del running[number]
            if process.exitcode != 0:
                words = "does not come back" if silent else f"ends the process (exit {process.exitcode})"
                _take_last(result, output, number, words)
                if time.monotonic() < end:
                    running[fresh] = start(fresh)
                    heard[fresh] = time.monotonic()
                    fresh += 1
            shutil.rmtree(output / f"worker_{number}", ignore_errors=True)
        if time.monotonic() - told > 5.0:
            told = time.monotonic()
            tell(f"fuzzing: {result}, {max(0.0, end - told):.0f} s left")
    for _, kind, content in _told(queue):
        _take(result, output, kind, content)
    return result


def _start(files: Sequence[Path], output: Path, seed: int, end: float, queue: Any, number: int) -> Any:
    """A process that works until a time of the clock."""
    arguments = list(files), output / f"worker_{number}", seed + number, end - time.monotonic(), queue, number
    process = get_context("spawn").Process(target=_work, args=arguments, daemon=True)
    process.start()
    return process


def _told(queue: Any) -> list[tuple[int, str, Any]]:
    """What processes have said; waits a second for the first word."""
    found = []
    with suppress(Empty):
        found.append(queue.get(timeout=1.0))
        while True:
            found.append(queue.get_nowait())
    return found


def _check_files(files: Sequence[Path]) -> None:
    """Refuse files that nothing reads."""
    from precompute.fuzzing.readers import READERS

    for path in files:
        if path.suffix.lower() not in READERS or not path.is_file():
            raise InputError("nothing reads this", file=path, expected="a file that ends in " + ", ".join(READERS))


def _take_last(result: FuzzResult, output: Path, number: int, words: str) -> None:
    """Add the case at which a process has ended."""
    for case in sorted((output / f"worker_{number}").glob("case.*")):
        _take(result, output, "escape", (case, f"{case.suffix}: {words}"))


def _take(result: FuzzResult, output: Path, kind: str, content: Any) -> None:
    """Add what a process says."""
    if kind == "round":
        cases, refused, lines = content
        result.cases.update(cases)
        result.refused += refused
        result.lines |= lines
        return
    case, problem = content
    if problem not in result.escapes and case.is_file():
        kept = output / f"escape_{len(result.escapes) + 1}{case.suffix}"
        with replacing(kept) as temporary:
            shutil.copyfile(case, temporary)
        result.escapes[problem] = Escape(kept, problem)


def _work(files: list[Path], folder: Path, seed: int, seconds: float, queue: Any, number: int) -> None:
    """A process: mutates, reads, and says what came of it."""
    from precompute.fuzzing.mutations import mutated
    from precompute.fuzzing.readers import READERS

    folder.mkdir(parents=True, exist_ok=True)
    chance = random.Random(seed)
    corpus: dict[str, list[bytes]] = {}
    for path in files:
        corpus.setdefault(path.suffix.lower(), []).append(path.read_bytes())
        shutil.copy(path, folder)  # one file may name another
    good = {ending: len(kept) for ending, kept in corpus.items()}
    seen: set[tuple[str, int]] = set()
    new: set[tuple[str, int]] = set()
    for ending, readers in READERS.items():  # libraries are loaded before memory is limited
        for data in corpus.get(ending, []):
            case = folder / f"case{ending}"
            case.write_bytes(data)
            for reader in readers:
                _answer(reader, case)
            with _lines(seen, new):  # a mutation leads somewhere new where no good file does
                for reader in readers:
                    _answer(reader, case)
            case.unlink()
    end = time.monotonic() + seconds  # a slow machine takes many to load them
    # Only memory that a process takes from here on counts: Taichi alone reserves more.
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    signal.signal(signal.SIGALRM, _too_long)
    cases, refused, count = Counter[str](), 0, 0
    endings = sorted(corpus)
    while time.monotonic() < end:
        ending = chance.choice(endings)
        data = mutated(chance.choice(corpus[ending]), ending, chance)
        case = folder / f"case{ending}"
        case.write_bytes(data)
        count += 1
        answers = []
        with _lines(seen, new) if count % TRACED == 0 else _nothing() as reached:
            for reader in READERS[ending]:
                answers.append(_answer(reader, case))
        for problem in answers:
            if problem not in ("", "refused"):
                queue.put((number, "escape", (_kept(case, count), f"{ending}: {problem}")))
        if reached and reached():  # what leads somewhere new is gone on from
            if len(corpus[ending]) >= CORPUS:
                corpus[ending].pop(chance.randrange(good[ending], len(corpus[ending])))
            corpus[ending].append(data)
        cases[ending] += 1
        refused += all(answer == "refused" for answer in answers)
        case.unlink()
        if count % ROUND == 0:
            queue.put((number, "round", (cases, refused, new)))
            cases, refused, new = Counter[str](), 0, set()
    queue.put((number, "round", (cases, refused, new)))
    queue.close()
    queue.join_thread()


def _kept(case: Path, count: int) -> Path:
    """A copy of a case, until the first process has it."""
    copy = case.with_name(f"kept_{count}{case.suffix}")
    shutil.copyfile(case, copy)
    return copy


def _answer(reader: Callable[[Path], Any], case: Path) -> str:
    """What a reader does with a file: "" for a value, "refused" for an InputError, else what is wrong."""
    signal.setitimer(signal.ITIMER_REAL, CASE_SECONDS)
    try:
        found = reader(case)
        return "a value that is no number" if _has_nan(found) else ""
    except InputError:
        return "refused"
    except _TooLongError:
        return f"takes over {CASE_SECONDS:g} s"
    except BaseException as error:  # noqa: BLE001 - this is what is looked for
        own = [part for part in traceback.extract_tb(error.__traceback__) if _own(part.filename)]
        place = f"{Path(own[-1].filename).name}:{own[-1].name}" if own else "?"
        return f"{type(error).__name__} in {place}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _too_long(number: int, frame: FrameType | None) -> None:
    raise _TooLongError


def _own(filename: str) -> bool:
    return any(f"/{package}/" in filename for package in PACKAGES) and "site-packages" not in filename


def _has_nan(value: Any, depth: int = 0) -> bool:
    """Whether a number in a value is none; looks into data classes, mappings and sequences."""
    if depth > 6:
        return False
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fc" and bool(np.isnan(value).any())
    if isinstance(value, float):
        return value != value
    if is_dataclass(value) and not isinstance(value, type):
        values = {entry.name: getattr(value, entry.name) for entry in fields(value)}
        texture = values.get("texture")
        if isinstance(texture, np.ndarray):  # faces without texture coordinates have NaN at all of their corners
            values["texture"] = texture[~np.isnan(texture).reshape(len(texture), -1).all(axis=1)]
        return any(_has_nan(one, depth + 1) for one in values.values())
    if isinstance(value, dict):
        return any(_has_nan(one, depth + 1) for one in value.values())
    return isinstance(value, (list, tuple)) and any(_has_nan(one, depth + 1) for one in value[:100])


@contextmanager
def _lines(seen: set[tuple[str, int]], new: set[tuple[str, int]]) -> Iterator[Callable[[], bool]]:
    """Note the lines of the project that are reached; the value says whether any was never reached before."""
    before = len(seen)

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        name = frame.f_code.co_filename
        if not _own(name):
            return None
        if event == "line":
            line = (name[name.rindex("/", 0, name.rindex("/")) + 1 :], frame.f_lineno)
            if line not in seen:
                seen.add(line)
                new.add(line)
        return trace

    sys.settrace(trace)
    try:
        yield lambda: len(seen) > before
    finally:
        sys.settrace(None)


@contextmanager
def _nothing() -> Iterator[None]:
    yield None
