from __future__ import annotations

import numpy as np
import pytest

from wrinkles.novelty import NoveltyScore


@pytest.fixture
def novelty() -> NoveltyScore:
    rng = np.random.default_rng(0)
    return NoveltyScore(
        rng.standard_normal((6, 3)).astype(np.float32),
        rng.standard_normal(3).astype(np.float32),
        rng.standard_normal(3).astype(np.float32),
        0.7,
        fade_from=20.0,
    )


def test_the_score_is_a_layer_of_rectified_units_and_a_sum(novelty: NoveltyScore) -> None:
    hidden = np.random.default_rng(1).standard_normal((4, 5, 6)).astype(np.float32)
    score = novelty.score(hidden)
    assert score.shape == (4, 5) and score.dtype == np.float32 and score.std() > 0.1
    for frame in range(4):
        for place in range(5):
            units = [max(0.0, hidden[frame, place] @ novelty.weights_1[:, u] + novelty.bias_1[u]) for u in range(3)]
            assert score[frame, place] == pytest.approx(0.7 + np.dot(units, novelty.weights_2), abs=1e-5)


def test_wrinkles_fade_from_an_error_to_twice_as_much(novelty: NoveltyScore) -> None:
    errors = np.array([0.1, 10.0, 20.0, 20.0 * 2.0**0.25, 20.0 * 2.0**0.5, 40.0, 1e6])
    amplitude = novelty.amplitude(np.log(errors).astype(np.float32))
    np.testing.assert_allclose(amplitude, [1.0, 1.0, 1.0, 0.75, 0.5, 0.0, 0.0], atol=1e-5)
    assert amplitude.dtype == np.float32
