"""Commands of gube, run one after the other in processes of their own while Blender goes on."""

from __future__ import annotations

import os
import subprocess
import threading
from pathlib import Path


def commands(gube: str, scene: Path, clip: str, rate: float) -> list[list[str]]:
    """What makes a point cache of a scene: learn the database, then play a clip and bake it.

    Args:
        gube: the command, or its path.
        scene: the scene file; all results are written beside it.
        clip: name of the clip that is baked, the whole of it.
        rate: frames a second of the point cache.
    """
    database, cache = str(scene.parent / "garment.h5"), str(scene.parent / "result.pc2")
    learn = [gube, "precompute", str(scene), "-o", database]
    return [learn, [gube, "bake", database, "-o", cache, "--clip", clip, "--rate", f"{rate:g}"]]


class Job:
    """Runs commands in a thread.

    Attributes:
        line: what the running command said last.
        error: why it failed; None while it runs and where it did not.
    """

    def __init__(self, lines: list[list[str]]) -> None:
        self.line, self.error = "", None
        self._process: subprocess.Popen[str] | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._run, args=(lines,), daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether a command still runs."""
        return self._thread.is_alive()

    def wait(self) -> None:
        """Wait until all commands have ended."""
        self._thread.join()

    def stop(self) -> None:
        """End the running command; what it simulated is kept, and the next run goes on from there."""
        self._stopped = True
        if self._process is not None:
            self._process.terminate()

    def _run(self, lines: list[list[str]]) -> None:
        # Blender's Python sets variables that lead another Python astray.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        for words in lines:
            if self._stopped:
                break
            try:
                self._process = subprocess.Popen(
                    words,
                    env=environment,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    encoding="utf-8",
                    errors="replace",
                )
            except OSError as error:
                self.error = (
                    f"{words[0]} cannot be run: {error.strerror}. Name the command in the extension's preferences"
                )
                return
            assert self._process.stdout is not None
            for line in self._process.stdout:
                if line.strip():
                    self.line = line.strip()
            status = self._process.wait()
            if status != 0:
                self.error = "stopped" if self._stopped else f"gube {words[1]} failed: {self.line}"
                return
