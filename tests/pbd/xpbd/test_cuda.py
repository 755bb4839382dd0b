"""The default solver on a GPU, beside the CPU."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pbd.crossings import crossings
from pbd.engine import cuda_is_here
from tests.data import ROOT
from tests.pbd.meshes import grid

FOLDED = """
import sys
import numpy as np
from pbd import Colliders, Fabric, Solver, SolverOptions, Sphere, State, ensure_initialized
from tests.pbd.meshes import cloth, free_model, grid
ensure_initialized(sys.argv[1])
flat, faces = grid(10, 12, 0.03)
flat = flat[:, [0, 2, 1]] - [0.15, 0.0, 0.18]
model = free_model(cloth(flat, faces), Fabric())
folded = flat * [1.0, 0.0, 1.0]
right = flat[:, 0] > 0.015
folded[right] = folded[right] * [-1.0, 1.0, 1.0] + [0.03, 0.02, 0.0]  # half of it lies on the other half
state, solver = State.at_rest(model, folded), Solver(model, SolverOptions(substep=1 / 240, self_collision=True))
for frame in range(8):
    solver.step(state, Colliders([Sphere((-0.08, -0.155, 0.0), 0.15)]), 1 / 60)
np.save(sys.argv[2], state.world())
"""

CROSSED = """
import sys
import numpy as np
from pbd import Colliders, ensure_initialized
from tests.pbd.meshes import thrown_sheet
ensure_initialized(sys.argv[1])
solver, state = thrown_sheet()
frames = []
done_again = 0
collisions = solver._collisions
advance = collisions._advance_by_impacts
def counted(*arguments):
    global done_again
    done_again += 1
    return advance(*arguments)
collisions._advance_by_impacts = counted
for frame in range(12):
    solver.step(state, Colliders(), 1 / 60)
    frames.append(state.world())
print("frames done again:", done_again)
assert done_again > 0, "no frame of this scene needs to be done again: it proves nothing"
np.save(sys.argv[2], np.stack(frames))
"""


def played(script: str, arch: str, folder: Path) -> np.ndarray:
    """What a script saves, run in a process of its own."""
    path = folder / f"{arch}.npy"
    subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", script, arch, str(path)],
        cwd=ROOT,
        env=dict(os.environ),
        check=True,
    )
    return np.load(path, allow_pickle=False)


@pytest.fixture(autouse=True)
def gpu() -> None:
    """Skip where there is none."""
    if not cuda_is_here():
        pytest.skip("no NVIDIA GPU here: nothing was tried on CUDA")


@pytest.mark.gpu
def test_the_gpu_agrees_with_the_cpu(tmp_path: Path) -> None:
    """A sheet that lies folded on a ball and on itself.

    A substep's rounding, 2e-7 m, grows in the folds; 1 mm is far below what a substep more or less changes.
    """
    cpu, cuda = (played(FOLDED, arch, tmp_path) for arch in ("cpu", "cuda"))
    assert np.abs(cpu - cuda).max() < 1e-3


@pytest.mark.gpu
def test_cloth_stays_free_of_crossings_on_the_gpu(tmp_path: Path) -> None:
    """A sheet whose parts are thrown at one another: frames are corrected and done again, as on the CPU."""
    frames = played(CROSSED, "cuda", tmp_path)
    assert [len(crossings(frame, grid(24, 24, 0.02)[1])) for frame in frames] == [0] * len(frames)
