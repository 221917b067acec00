"""Correlations against loops written out here."""

import itertools
import math

import numpy as np
import torch

from dgc_pose.network.correlation import (
    cell_correlation,
    global_correlation,
    l2_normalise,
    local_correlation,
    match_evidence,
    match_scores,
    peaks,
)


def _features(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_l2_norm_over_channels() -> None:
    features = _features(0, 2, 5, 3, 4)
    found = l2_normalise(features)
    for b in range(2):
        for y in range(3):
            for x in range(4):
                vector = features[b, :, y, x].numpy()
                length = math.sqrt(float((vector**2).sum()) + 1e-6)
                np.testing.assert_allclose(found[b, :, y, x].numpy(), vector / length)


def test_local_correlation_is_around_each_cell() -> None:
    warped, target = _features(3, 1, 5, 6, 7), _features(4, 1, 5, 6, 7)
    radius = 2
    found = local_correlation(warped, target, radius)
    assert found.shape == (1, 25, 6, 7)
    for y in range(6):
        for x in range(7):
            for dy in range(-radius, radius + 1):
                for dx in range(-radius, radius + 1):
                    inside = 0 <= y + dy < 6 and 0 <= x + dx < 7
                    expected = (
                        float(warped[0, :, y + dy, x + dx] @ target[0, :, y, x]) if inside else 0.0
                    )
                    channel = (dy + radius) * 5 + dx + radius
                    assert math.isclose(float(found[0, channel, y, x]), expected, abs_tol=1e-12)


def test_evidence_is_the_weighted_sum_of_the_levels() -> None:
    """Of a finer level: the best inside the source's cell, on the mean inside the target's."""
    scales = (2.0, 5.0, 0.5)
    source = [_features(7 + k, 2, 3, 2 * 2**k, 3 * 2**k) for k in range(3)]
    target = [_features(17 + k, 2, 3, 2 * 2**k, 3 * 2**k) for k in range(3)]
    pairs = enumerate(zip(source, target, strict=True))
    correlations = [cell_correlation(*pair, side=2**k) for k, pair in pairs]
    torch.testing.assert_close(correlations[0], global_correlation(source[0], target[0]))
    found = match_evidence(correlations, torch.tensor(scales, dtype=torch.float64))
    assert found.shape == (2, 6, 2, 3)
    for b, xs, ys, xt, yt in itertools.product(range(2), range(3), range(2), range(3), range(2)):
        expected = 0.0
        for k, scale in enumerate(scales):
            f = 2**k
            inside = source[k][b, :, f * ys : f * ys + f, f * xs : f * xs + f].flatten(1)
            bests = [
                float((target[k][b, :, f * yt + y, f * xt + x] @ inside).max())
                for y in range(f)
                for x in range(f)
            ]
            expected += scale * sum(bests) / len(bests)
        assert math.isclose(float(found[b, xs * 2 + ys, yt, xt]), expected, abs_tol=1e-9)


def test_peaks_are_where_the_features_came_from() -> None:
    """A target that is the source rotated by 90 degrees: every cell finds its true point."""
    source = l2_normalise(_features(5, 1, 64, 15, 15))
    target = torch.rot90(source, 1, (2, 3))
    scores = match_scores(60.0 * global_correlation(source, target))
    points, probability = peaks(scores)
    rows, columns = torch.meshgrid(torch.arange(15), torch.arange(15), indexing="ij")
    truth_x, truth_y = torch.rot90(columns, 1), torch.rot90(rows, 1)
    torch.testing.assert_close(points[0, 0], truth_x.double(), atol=1e-3, rtol=0)
    torch.testing.assert_close(points[0, 1], truth_y.double(), atol=1e-3, rtol=0)
    assert probability.min() > 0.999


def test_a_far_second_peak_does_not_move_the_place() -> None:
    correlation = torch.zeros(1, 225, 15, 15, dtype=torch.float64)
    correlation[0, 3 * 15 + 4, 7, 7] = 1.0
    correlation[0, 12 * 15 + 10, 7, 7] = 0.98
    points, probability = peaks(match_scores(40.0 * correlation))
    expected = torch.tensor([3.0, 4.0], dtype=torch.float64)
    torch.testing.assert_close(points[0, :, 7, 7], expected, atol=1e-3, rtol=0)
    assert 0.5 < probability[0, 7, 7] < 0.9  # two peaks, the higher one the clearer


def test_scores_are_the_product_of_both_softmaxes() -> None:
    correlation = _features(6, 1, 12, 3, 4)
    scores = match_scores(3.0 * correlation).view(12, 12)
    raw = 3.0 * correlation.view(12, 12).numpy()
    for source in range(12):
        for target in range(12):
            over_source = np.exp(raw[:, target]).sum()
            over_target = np.exp(raw[source]).sum()
            expected = 2 * raw[source, target] - math.log(over_source) - math.log(over_target)
            assert math.isclose(float(scores[source, target]), expected, abs_tol=1e-9)
