"""A network's maps beside the truth: figures against loops over single pixels."""

import math

import numpy as np
import pytest
import torch
from map_nets import MapNet, half_sure, shifted

from dgc_pose.benchmarks.map_comparison import compare
from dgc_pose.training.map_pairs import MapPairs
from dgc_pose.training.validation import validate


@pytest.fixture
def pairs() -> MapPairs:
    """Two pairs whose true maps are shifts with a small bend; a disk of pixels is not visible."""
    generator = torch.Generator().manual_seed(2)
    image1, image2 = torch.rand(2, 2, 3, 240, 240, generator=generator)
    bend = 0.05 * (shifted(0, 0) - 120)
    truth = torch.stack([shifted(1, -2), shifted(0, 3) + bend])
    inside = ((truth >= 0) & (truth <= 239)).all(-1)
    hidden = (shifted(-100, -90).norm(dim=-1) < 40)[None]
    return MapPairs(image1, image2, truth, inside & ~hidden)


@pytest.fixture
def net() -> MapNet:
    return MapNet(shifted(0, 0), half_sure())


def loop(pairs: MapPairs, index: int) -> list[tuple[int, int, float]]:
    """Row, column and distance of the valid pixels of a pair, for the net with the identity map."""
    rows = []
    for y, x in pairs.valid[index].nonzero().tolist():
        u, v = pairs.map[index, y, x].tolist()
        rows.append((y, x, math.hypot(u - x, v - y)))
    return rows


def test_a_comparison_holds_the_map_in_pixels(pairs: MapPairs, net: MapNet) -> None:
    first, second = compare(net, pairs)
    assert [level.points.shape for level in first.levels] == [
        (cells, cells, 2) for cells in (15, 30, 60, 120, 240)
    ]
    np.testing.assert_allclose(second.finest.points, shifted(0, 0), atol=1e-4)
    np.testing.assert_allclose(
        first.levels[0].points[2, 3], [3 * 16 + 7.5, 2 * 16 + 7.5], atol=1e-4
    )
    np.testing.assert_allclose(first.levels[0].truth[2, 3], [3 * 16 + 8.5, 2 * 16 + 5.5], atol=1e-4)
    assert first.matchability is not None
    np.testing.assert_allclose(first.matchability, half_sure(), atol=1e-6)


def test_figures_are_those_of_a_loop(pairs: MapPairs, net: MapNet) -> None:
    figures = validate(net, [pairs])
    rows = [loop(pairs, 0), loop(pairs, 1)]
    means = [sum(d for *_, d in own) / len(own) for own in rows]
    assert figures["aepe"] == figures["aepe240"] == pytest.approx(sum(means) / 2, rel=1e-5)
    distances = sorted(d for own in rows for *_, d in own)
    assert figures["epe_median"] == pytest.approx(distances[len(distances) // 2], rel=1e-4)
    near = sum(d <= 3 for d in distances) / len(distances)
    assert figures["pck3"] == pytest.approx(near, abs=1e-4)  # some lie at 3 px but for rounding
    sure = [d for own in rows for _, x, d in own if x < 120]
    sure_share = sum(d <= 3 for d in sure) / (2 * 240 * 120)
    assert figures["sure3"] == pytest.approx(sure_share, abs=1e-4)
    overlaps = [
        sum(x < 120 for _, x, _ in own) / (240 * 120 + sum(x >= 120 for _, x, _ in own))
        for own in rows
    ]
    assert figures["jaccard"] == pytest.approx(sum(overlaps) / 2)
    # The shift of the first pair is the same at every level.
    assert compare(net, pairs)[0].levels[0].aepe == pytest.approx(math.sqrt(5), rel=1e-4)
    keys = [f"aepe{cells}" for cells in (15, 30, 60, 120, 240)]
    assert list(figures) == ["aepe", "epe_median", "pck3", "sure3", "jaccard", *keys]
