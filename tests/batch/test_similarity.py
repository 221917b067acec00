"""Scores of images from coarse features."""

from __future__ import annotations

import numpy as np

from dgc_pose.batch.pair_choice import similarities


def _cells(rng: np.random.Generator, count: int) -> np.ndarray:
    cells = rng.standard_normal((count, 32))
    return cells / np.linalg.norm(cells, axis=1, keepdims=True)


def _score(one: np.ndarray, other: np.ndarray) -> float:
    """Cell by cell."""
    best = [max(float(a @ b) for b in other) for a in one]
    best += [max(float(a @ b) for a in one) for b in other]
    return sum(best) / len(best)


def test_scores_are_those_of_a_plain_loop() -> None:
    """Also of images of different shapes."""
    rng = np.random.default_rng(0)
    features = [_cells(rng, count) for count in (20, 20, 12, 30)]
    scores = similarities(features)
    np.testing.assert_array_equal(scores, scores.T)
    for i, j in ((0, 1), (0, 2), (3, 2)):
        assert abs(scores[i, j] - _score(features[i], features[j])) < 1e-6


def test_more_shared_cells_score_more() -> None:
    rng = np.random.default_rng(1)
    scene = _cells(rng, 60)
    features = [scene[:30], scene[10:40], scene[25:55]]
    scores = similarities(features)
    assert scores[0, 1] > scores[0, 2]
