"""The coloured schedule on a GPU, beside the CPU."""

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
from pbd import ensure_initialized
ensure_initialized(sys.argv[1])
from tests.pbd.xpbd.test_batch_solver import OPTIONS, sheets, together
np.savez(sys.argv[2], *(state.position for state in together(sheets(), OPTIONS, 8)))
"""


@pytest.mark.gpu
def test_the_gpu_agrees_with_the_cpu(tmp_path: Path) -> None:
    """A substep's rounding, 2e-7 m, grows in the folds; 1 mm is far below what a substep more or less changes."""
    if not cuda_is_here():
        pytest.skip("no NVIDIA GPU here: nothing was tried on CUDA")
    found = {}
    for arch in ("cpu", "cuda"):
        path = tmp_path / f"{arch}.npz"
        subprocess.run([sys.executable, "-c", SCRIPT, arch, str(path)], cwd=ROOT, env=dict(os.environ), check=True)
        found[arch] = list(np.load(path, allow_pickle=False).values())
    for here, there in zip(found["cpu"], found["cuda"], strict=True):
        assert np.abs(here - there).max() < 1e-3
