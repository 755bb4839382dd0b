"""The default solver on a GPU, beside the CPU."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pbd.engine import cuda_is_here
from tests.data import ROOT

SCRIPT = """
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


@pytest.mark.gpu
def test_the_gpu_agrees_with_the_cpu(tmp_path: Path) -> None:
    """A sheet that lies folded on a ball and on itself.

    A substep's rounding, 2e-7 m, grows in the folds; 1 mm is far below what a substep more or less changes.
    """
    if not cuda_is_here():
        pytest.skip("no NVIDIA GPU here: nothing was tried on CUDA")
    found = {}
    for arch in ("cpu", "cuda"):
        path = tmp_path / f"{arch}.npy"
        subprocess.run([sys.executable, "-c", SCRIPT, arch, str(path)], cwd=ROOT, env=dict(os.environ), check=True)
        found[arch] = np.load(path, allow_pickle=False)
    assert np.abs(found["cpu"] - found["cuda"]).max() < 1e-3
