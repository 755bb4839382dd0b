"""Tests. Several processes run them side by side, so that each leaves linear algebra on one thread."""

import os

# NumPy reads them once, when it is loaded. The last two give the same bits on every processor (docs/engine-guide.md):
# free runs of cloth are chaotic, and a figure of one run that holds on one processor need not hold on another.
for _name, _value in {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
}.items():
    os.environ.setdefault(_name, _value)
