"""Figures of a pair and of a group, against loops over single pixels."""

import json
import math

import numpy as np
import pytest

from dgc_pose.benchmarks.map_scores import (
    PCK_THRESHOLDS,
    Comparison,
    LevelMap,
    maps_table,
    pooled,
    reliability_lines,
    report_data,
    score_map,
)


def comparison(seed: int = 0, *, masked: bool = True, blind: bool = False) -> Comparison:
    """A pair whose errors spread over the PCK thresholds, on small grids."""
    rng = np.random.default_rng(seed)
    levels = []
    for cells in (2, 4, 6, 8, 12):
        truth = rng.uniform(0, 240, (cells, cells, 2))
        valid = rng.random((cells, cells)) < (0.0 if blind else 0.7)
        levels.append(LevelMap(truth + rng.normal(0, 4, truth.shape), truth, valid))
    mask = rng.random((12, 12)) if masked else None
    return Comparison(tuple(levels), mask)


def offsets(pair: Comparison) -> list[tuple[int, int, float, float]]:
    level = pair.levels[-1]
    return [
        (y, x, *(level.points[y, x] - level.truth[y, x]).tolist())
        for y, x in np.argwhere(level.valid).tolist()
    ]


def test_a_pairs_errors_are_those_of_its_valid_pixels() -> None:
    pair = comparison()
    found = score_map("net", "I", "wall", pair)
    distances = [math.hypot(dx, dy) for _, _, dx, dy in offsets(pair)]
    assert found.valid == len(distances) > 50
    assert found.means["aepe"] == pytest.approx(sum(distances) / len(distances))
    assert found.means["aepe240"] == found.means["aepe"]
    assert found.within.tolist() == [sum(d <= limit for d in distances) for limit in (1, 3, 5)]
    assert found.near.tolist() == [sum(d <= limit for d in distances) for limit in PCK_THRESHOLDS]


def test_the_mask_is_scored_against_both_meanings() -> None:
    pair = comparison()
    found = score_map("net", "", "wall", pair)
    near = {(y, x): math.hypot(dx, dy) for y, x, dx, dy in offsets(pair)}
    assert pair.matchability is not None
    said = {(y, x) for y, x in np.ndindex(12, 12) if pair.matchability[y, x] > 0.5}
    visible = set(near)
    good = {place for place, distance in near.items() if distance < 4}
    assert found.means["jaccard"] == pytest.approx(len(said & visible) / len(said | visible))
    assert found.means["jaccard_found"] == pytest.approx(len(said & good) / len(said | good))
    assert found.means["jaccard"] != found.means["jaccard_found"]
    # A match is right within 3 px, and wrong where there is nothing.
    assert found.reliability is not None and found.reliability.counts.sum() == 144
    assert found.reliability.correct.sum() == sum(v <= 3 for v in near.values()) > 0


def test_a_group_has_means_over_pairs_and_curves_over_pixels() -> None:
    pairs = [comparison(0), comparison(1)]
    own = [score_map("net", "I", str(index), pair) for index, pair in enumerate(pairs)]
    found = pooled(own, "I")
    assert (found.method, found.group, found.pairs) == ("net", "I", 2)
    assert found.means["aepe"] == pytest.approx((own[0].means["aepe"] + own[1].means["aepe"]) / 2)
    for cells in (15, 30, 60, 120, 240):
        both = [scores.means[f"aepe{cells}"] for scores in own]
        assert found.means[f"aepe{cells}"] == pytest.approx(np.nanmean(both))
    distances = [math.hypot(dx, dy) for pair in pairs for _, _, dx, dy in offsets(pair)]
    expected = [np.mean([d <= limit for d in distances]) for limit in PCK_THRESHOLDS]
    np.testing.assert_allclose(found.pck, expected)
    assert found.data["pck3"] == pytest.approx(np.mean([d <= 3 for d in distances]))
    assert found.means["jaccard"] == pytest.approx(
        (own[0].means["jaccard"] + own[1].means["jaccard"]) / 2
    )
    together = found.reliability
    assert together is not None and together.counts.sum() == 2 * 144


def test_a_pair_with_nothing_to_find_has_no_error() -> None:
    blind = score_map("net", "I", "blind", comparison(2, blind=True))
    assert blind.valid == 0 and math.isnan(blind.means["aepe"])
    seen = score_map("net", "I", "seen", comparison(3))
    both = pooled([blind, seen])
    assert both.pairs == 2
    assert both.means["aepe"] == seen.means["aepe"]
    np.testing.assert_array_equal(both.pck, pooled([seen]).pck)
    assert np.isnan(pooled([blind]).pck).all()


def test_the_report_has_every_figure_of_each_group_and_method() -> None:
    scores = {
        method: [
            score_map(method, group, "", comparison(seed, masked=method == "a"))
            for seed, group in enumerate(("I", "I", "II"))
        ]
        for method in "ab"
    }
    found = pooled(scores["a"], "I")
    header, *lines = (line.split() for line in maps_table(scores).splitlines())
    assert header[:5] == ["group", "method", "pairs", "AEPE", "AEPE@15"]
    assert [line[:3] for line in lines] == [
        [group, m, n] for group, n in (("I", "2"), ("II", "1"), ("all", "3")) for m in "ab"
    ]
    assert lines[0][3] == f"{found.means['aepe']:.2f}" == lines[0][8]
    assert lines[0][10] == f"{100 * found.data['pck3']:.1f}"
    assert lines[0][12:] == [f"{found.means[n]:.3f}" for n in ("jaccard", "jaccard_found")]
    assert lines[1][12:] == ["-", "-"]
    data = json.loads(json.dumps(report_data(scores), allow_nan=False))
    a, b = data["methods"]
    assert a["method"] == "a" and [group["group"] for group in a["groups"]] == ["I", "II"]
    assert a["groups"][0]["aepe15"] == found.means["aepe15"] and a["all"]["pairs"] == 3
    assert len(data["pck_thresholds_px"]) == len(a["all"]["pck"]) == 200
    assert sum(a["reliability"]["counts"]) == 3 * 144
    assert b["reliability"] is None and b["all"]["jaccard"] is None
    (line,) = reliability_lines(scores)
    assert line.startswith("a: percent within 3 px by tenths of matchability: ")
    error = 100 * a["reliability"]["expected_calibration_error"]
    assert line.endswith(f"; expected calibration error {error:.1f} %")
