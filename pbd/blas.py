"""Which of its kernels OpenBLAS runs."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["choose_kernels"]

NAME = "OPENBLAS_CORETYPE"
NEEDED = {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}


def choose_kernels(processor: Path = Path("/proc/cpuinfo")) -> None:
    """Let OpenBLAS use AVX-512 on processors of AMD that have it, unless the environment says what it is to use.

    NumPy's and SciPy's wheels have OpenBLAS with five sets of kernels (numpy/numpy#27147), and the choice for AMD's
    Zen 4 and 5 among them falls on Haswell's, which are half as fast there as those of Skylake-X. OpenBLAS reads the
    variable when NumPy is loaded; later this does nothing.

    Args:
        processor: Linux's description of the processors; nothing is chosen where there is none.
    """
    try:
        told = processor.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return
    if "AuthenticAMD" in told and set(told.split()) >= NEEDED:
        os.environ.setdefault(NAME, "SkylakeX")
