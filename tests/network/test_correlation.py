"""Correlations, consensus and peaks of NumPy's arrays and torch's tensors, against loops."""

import math
from typing import Any

import numpy as np
import pytest
import torch

from dgc_pose.network.config import FLOOR, REACH, WEIGHT
from dgc_pose.network.correlation import (
    consensus,
    match_evidence,
    match_scores,
    peaks,
    pooled_evidence,
)
from dgc_pose.network.net import l2_normalise, local_correlation
from dgc_pose.runtime import onnx_engine

# To an array of the library, with torch's batch, and back.
LIBRARIES = {
    "numpy": (lambda values: values, lambda values: values),
    "torch": (lambda values: torch.from_numpy(values)[None], lambda values: values[0].numpy()),
}


@pytest.fixture(params=LIBRARIES)
def library(request):
    return LIBRARIES[request.param]


def _noise(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


def test_unit_length_over_channels_and_local_correlation(library):
    to, back = library
    warped, target = _noise(3, 5, 6, 7), _noise(4, 5, 6, 7)
    module: Any = onnx_engine if isinstance(to(warped), np.ndarray) else None
    unit = module.l2_normalised if module else l2_normalise
    lengths = np.sqrt((warped.astype(float) ** 2).sum(0) + 1e-6)
    np.testing.assert_allclose(back(unit(to(warped))), warped / lengths, rtol=1e-5)
    correlate = module.local_correlation if module else local_correlation
    values = back(correlate(to(warped), to(target), 2))
    assert values.shape == (25, 6, 7)
    for y, x in np.ndindex(6, 7):
        for channel, (dy, dx) in enumerate(np.ndindex(5, 5)):
            v, u = y + dy - 2, x + dx - 2
            expected = warped[:, v, u] @ target[:, y, x] if 0 <= v < 6 and 0 <= u < 7 else 0.0
            assert values[channel, y, x] == pytest.approx(expected, abs=1e-5)


def test_evidence_is_the_weighted_sum_of_the_levels(library):
    """Of a finer level: the best inside the source's cell, on the mean inside the target's."""
    to, back = library
    scales = np.array([2.0, 5.0, 0.5], np.float32)
    source = [_noise(7 + k, 3, 2 * 2**k, 4 * 2**k) for k in range(3)]
    target = [_noise(17 + k, 3, 2 * 2**k, 3 * 2**k) for k in range(3)]
    sources, targets = list(map(to, source)), list(map(to, target))
    factors = scales if isinstance(sources[0], np.ndarray) else torch.from_numpy(scales)
    values = back(match_evidence(sources, targets, factors))
    assert values.shape == (8, 6)
    for xs, ys, yt, xt in np.ndindex(4, 2, 2, 3):
        expected = 0.0
        for k, scale in enumerate(scales):
            f = 2**k
            inside = source[k][:, f * ys : f * ys + f, f * xs : f * xs + f].reshape(3, -1)
            seen = target[k][:, f * yt : f * yt + f, f * xt : f * xt + f].reshape(3, -1)
            expected += scale * (seen.T @ inside).max(1).mean()
        assert values[xs * 2 + ys, yt * 3 + xt] == pytest.approx(expected, abs=1e-4)


def test_evidence_is_pooled_over_pairs_of_scales(library):
    to, back = library
    first, second = ([[_noise(seed + k, 3, 4, 5)] for k in range(2)] for seed in (0, 5))
    source, target = (
        [[to(level) for level in levels] for levels in both] for both in (first, second)
    )
    scale = to(np.array([3.0], np.float32))[..., :1].reshape(1)
    values = back(pooled_evidence(source, target, scale))
    for xs, ys, yt, xt in np.ndindex(5, 4, 4, 5):
        products = [
            first[k][0][:, ys, xs] @ second[j][0][:, yt, xt] for k, j in ((0, 0), (1, 0), (0, 1))
        ]
        assert values[xs * 4 + ys, yt * 5 + xt] == pytest.approx(3 * max(products), abs=1e-4)


def test_scores_are_the_product_of_both_softmaxes(library):
    to, back = library
    raw = 3 * _noise(6, 12, 10).astype(float)
    expected = 2 * raw - np.log(np.exp(raw).sum(0)) - np.log(np.exp(raw).sum(1))[:, None]
    np.testing.assert_allclose(back(match_scores(to(raw))), expected, atol=1e-9)


def _belief(scores: np.ndarray, passes: int) -> np.ndarray:
    """Belief propagation cell by cell, of scores[xs, ys, yt, xt]."""
    width, height, rows, columns = scores.shape
    belief = scores - np.log(np.exp(scores).sum((0, 1)))
    for _ in range(passes):
        messages = np.full((width + 2, height + 2, rows, columns), math.log(FLOOR))
        for xs, ys, yt, xt in np.ndindex(scores.shape):
            total = 0.0
            for x, y in np.ndindex(width, height):
                density = math.exp(-((y - ys) ** 2 + (x - xs) ** 2) / (2 * REACH**2))
                total += density / (2 * math.pi * REACH**2) * math.exp(belief[x, y, yt, xt])
            messages[xs + 1, ys + 1, yt, xt] = math.log(total + FLOOR)
        updated = scores.copy()
        for xs, ys, yt, xt in np.ndindex(scores.shape):
            for dy, dx in np.ndindex(3, 3):
                v, u = yt + dy - 1, xt + dx - 1
                if (dy, dx) != (1, 1) and 0 <= v < rows and 0 <= u < columns:
                    updated[xs, ys, yt, xt] += WEIGHT * messages[xs + dx, ys + dy, v, u]
        belief = updated - np.log(np.exp(updated).sum((0, 1)))
    return belief


@pytest.mark.parametrize("passes", [0, 1, 3])
def test_consensus_is_belief_propagation(library, passes):
    to, back = library
    scores = 4 * _noise(3, 12, 10)
    values = back(consensus(to(scores), passes, (3, 4), (2, 5)))
    expected = _belief(scores.reshape(4, 3, 2, 5).astype(float), passes)
    np.testing.assert_allclose(values.reshape(4, 3, 2, 5), expected, atol=1e-4)


def test_a_far_second_peak_does_not_move_the_place(library):
    to, back = library
    correlation = np.zeros((50, 4))
    correlation[3 * 5 + 4, 1] = 1.0
    correlation[9 * 5 + 1, 1] = 0.98
    points, probability = map(back, peaks(match_scores(to(40.0 * correlation)), (5, 10)))
    np.testing.assert_allclose(points[:, 1], (3, 4), atol=1e-3)
    assert 0.5 < probability[1] < 0.9  # two peaks, the higher one the clearer
