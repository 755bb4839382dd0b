"""Tests. Several processes run them side by side, so that each leaves linear algebra on one thread."""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # NumPy reads them once, when it is loaded
    os.environ.setdefault(_name, "1")
