"""Whether a USD file can be read at all, found out in a process of its own.

USD's library checks what it reads, but not everything: some damaged files end the process, and some make it ask for all
memory. Here each such file is refused with a message.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

from assets.io.file_cache import file_state
from pbd.errors import InputError

__all__ = ["require_sound"]

_SECONDS, _SECONDS_A_MEGABYTE = 60.0, 0.5  # that reading may take
_BYTES, _TIMES_SIZE = 4 * 2**30, 30  # that it may use, for itself and by the size of the file
_SCRIPT = """
import sys
from pathlib import Path
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]), int(sys.argv[2])))
except ImportError:  # Windows has none
    pass
from assets.io.usd_character import read_all
read_all(Path(sys.argv[1]))
"""


def require_sound(path: Path) -> None:
    """Read a file in another process first; a file that did not change is tried once.

    Raises:
        InputError: reading it ends that process, takes too long or too much memory.
    """
    problem = _problem(path.absolute(), file_state(path))
    if problem is not None:
        raise InputError(f"no USD, truncated or damaged: {problem}", file=path, expected="a USD file")


@lru_cache(maxsize=64)
def _problem(path: Path, state: tuple[int, int] | None) -> str | None:
    size = 0 if state is None else state[0]
    command = [sys.executable, "-c", _SCRIPT, str(path), str(_BYTES + _TIMES_SIZE * size)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    seconds = _SECONDS + _SECONDS_A_MEGABYTE * size / 2**20
    try:
        result = subprocess.run(command, env=environment, capture_output=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        return f"reading it takes more than {seconds:.0f} s"
    if result.returncode == 0:
        return None
    last = result.stderr.decode(errors="replace").strip().splitlines()[-1:]
    return last[0][:200] if last and result.returncode > 0 else "reading it ends the process"
