"""One skirt in three fabrics."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from precompute.method_comparison.fabric_pictures import FABRICS, PICTURE, draw_fabrics, fabric_runs


def test_the_fabrics_hang_by_lengths_that_differ() -> None:
    lengths = [fabric.gravity_length for fabric in FABRICS.values()]
    assert len(lengths) == 3 and all(b > 1.3 * a for a, b in pairwise(lengths))


@pytest.mark.proof
def test_all_fabrics_wear_one_cut_and_motion_and_are_drawn(tmp_path: Path) -> None:
    runs = fabric_runs(subdivisions=1, seconds=0.1)
    assert [run.name for run in runs] == list(FABRICS)
    assert all(run.levels is runs[0].levels and np.array_equal(run.poses, runs[0].poses) for run in runs)
    image = draw_fabrics(runs[:2], tmp_path, moments=(0.1,), workers=1)
    assert image.dtype == np.uint8 and image.shape[1] > 2 * PICTURE[0] and image.shape[0] > PICTURE[1]
    left, right = image[:, : image.shape[1] // 2].astype(int), image[:, image.shape[1] // 2 :].astype(int)
    assert left.std() > 5.0 and right.std() > 5.0
