"""Scores of images from coarse features, and the images that `auto` chooses."""

from __future__ import annotations

import numpy as np

from dgc_pose.batch.similarity import similarities


def _cells(rng: np.random.Generator, count: int) -> np.ndarray:
    cells = rng.standard_normal((count, 32)).astype(np.float32)
    return cells / np.linalg.norm(cells, axis=1, keepdims=True)


def _mutual_score(one: np.ndarray, other: np.ndarray) -> float:
    """Cell by cell."""
    cosines = one @ other.T
    total = 0.0
    for j in range(cosines.shape[1]):
        i = int(cosines[:, j].argmax())
        if int(cosines[i].argmax()) == j:
            total += max(0.0, float(cosines[i, j]))
    return total / cosines.shape[1]


def test_scores_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(0)
    features = [_cells(rng, 20) for _ in range(70)]
    scores = similarities(features)
    assert scores.shape == (70, 70)
    np.testing.assert_array_equal(scores, scores.T)
    for i, j in ((0, 1), (3, 69), (68, 2)):
        assert abs(scores[i, j] - _mutual_score(features[i], features[j])) < 1e-5


def test_more_shared_cells_score_more_and_missing_images_least() -> None:
    rng = np.random.default_rng(1)
    scene = _cells(rng, 60)
    features = [scene[:30], scene[10:40], scene[25:55], None]
    scores = similarities(features)
    assert scores[0, 1] > scores[0, 2] > scores[0, 3] == -1
