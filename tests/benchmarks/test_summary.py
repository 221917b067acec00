import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from evaluation_pairs import METHODS, evaluation, posed_pairs

from dgc_pose.benchmarks.scores import CameraScore, PairScore
from dgc_pose.benchmarks.summary import (
    MethodSummary,
    by_method,
    camera_table,
    summarise,
    summary_data,
    summary_table,
)
from dgc_pose.errors import InputError

GOOD = MethodSummary("dgcm-lite0", 64, 2, 1.25, 3.5, 3.25, 61.0, 75.5, 83.25, 0.4)
LOST = MethodSummary("sift", 64, 40, math.inf, math.inf, math.inf, 10.0, 12.0, 14.0, 1.5)


def test_the_summary_is_a_table_and_valid_json_whatever_is_infinite():
    header, good, lost = summary_table([GOOD, LOST]).splitlines()
    assert len(header) == len(good) == len(lost)
    assert good.split() == "dgcm-lite0 64 2 (3.1 %) 1.25 3.50 3.25 61.0 75.5 83.2 0.40".split()
    assert lost.split() == "sift 64 40 (62.5 %) inf inf inf 10.0 12.0 14.0 1.50".split()
    (first, second) = json.loads(json.dumps(summary_data([GOOD, LOST]), allow_nan=False))["methods"]
    assert (first["median_rotation_deg"], second["median_rotation_deg"]) == (1.25, None)
    assert (
        list(first)
        == (
            "method pairs failures median_rotation_deg median_translation_deg "
            "median_translation_folded_deg auc5 auc10 auc20 seconds_per_pair"
        ).split()
    )


def score(rotation, translation, method="m"):
    success = math.isfinite(rotation)
    folded = min(translation, 180 - translation) if success else math.inf
    return PairScore(
        method=method,
        image1="a",
        image2="b",
        true_rotation_deg=10.0,
        status="ok" if success else "too_few_matches",
        success=success,
        num_matches=10,
        num_inliers=8,
        inlier_ratio=0.8,
        rotation_error_deg=rotation,
        translation_error_deg=translation,
        translation_folded_deg=folded,
        match_seconds=0.5,
        estimate_seconds=0.25 if success else 0.05,
    )


def test_the_summary_of_known_errors():
    results = [score(1, 2), score(3, 178), score(4, 1), score(math.inf, math.inf)]
    summary = summarise(results)
    assert (summary.method, summary.pairs, summary.failures) == ("m", 4, 1)
    assert summary.median_rotation_deg == 3.5
    assert summary.median_translation_deg == 90.0  # between 2 and 178
    assert summary.median_translation_folded_deg == 2.0
    assert summary.seconds_per_pair == pytest.approx((3 * 0.75 + 0.55) / 4)
    # Pair errors 2, 3, 4 and infinite: the recall is 0 at 0, then 1/4, 2/4, 3/4, and stays.
    area = 2 * 0.25 / 2 + (0.25 + 0.5) / 2 + (0.5 + 0.75) / 2
    for auc, threshold in ((summary.auc5, 5), (summary.auc10, 10), (summary.auc20, 20)):
        assert auc == pytest.approx(100 * (area + (threshold - 4) * 0.75) / threshold)


@pytest.mark.parametrize("results", [[], [score(1, 2, "a"), score(1, 2, "b")]])
def test_a_summary_is_of_one_method(results):
    with pytest.raises(InputError):
        summarise(results)


def test_the_summary_is_that_of_the_records(tmp_path) -> None:
    rows = evaluation(posed_pairs(tmp_path, 3)).run()
    results = [score for scores in rows for score in scores]
    results[0] = replace(
        results[0],
        success=False,
        rotation_error_deg=np.inf,
        translation_error_deg=np.inf,
        translation_folded_deg=np.inf,
    )
    net, everywhere, some = (summarise(own) for own in by_method(results).values())
    assert [s.method for s in (net, everywhere, some)] == [m.name for m in METHODS]
    own = results[::3]
    assert (net.pairs, net.failures) == (3, 1)
    assert net.median_rotation_deg == sorted(r.rotation_error_deg for r in own)[1]
    assert net.median_epipolar_px == sorted(r.epipolar_all_px for r in own)[1]
    assert net.median_epipolar_confident_px == sorted(r.epipolar_confident_px for r in own)[1]
    assert np.isnan(some.median_epipolar_px)
    pose = [one.estimate_seconds for one in results[1::3]]
    assert everywhere.pose_seconds_per_pair == pytest.approx(sum(pose) / 3)
    head, *lines = summary_table([net, everywhere, some]).splitlines()
    assert head.split()[-7:] == ["D_e", "all", "D_e", "conf", "matches", "pose", "s"]
    assert lines[0].split()[-4] == f"{net.median_epipolar_px:.2f}"
    assert lines[2].split()[-4:-1] == ["-", "0.00", f"{some.matches_per_pair:.0f}"]


def camera_score(rotation, focal, std, probability, *, doubts=False):
    success = math.isfinite(rotation)
    return CameraScore(
        **asdict(score(rotation, rotation)),
        rotation_90_deg=1.0 if success else math.nan,
        translation_90_deg=3.0 if success else math.nan,
        probability=probability,
        focal1_error=math.log(focal) if success else math.nan,
        focal2_error=math.log(focal) if success else math.nan,
        focal1_std=std if success else math.nan,
        focal2_std=std if success else math.nan,
        focal_ratio=math.nan,
        focal_ratio_std=math.nan,
        doubts_camera=doubts,
    )


def test_the_figures_of_known_records():
    summary = summarise(
        [
            camera_score(0.5, 1.01, 0.01, 0.9),
            camera_score(2.0, 0.98, 0.005, 0.9),  # four deviations off
            camera_score(4.0, 1.2, 0.3, 0.9, doubts=True),
            camera_score(12.0, 0.5, 0.3, 0.9),  # wrong, and over two deviations off
            camera_score(math.inf, math.nan, math.nan, 0.2),
        ]
    )
    assert (summary.pairs, summary.failures, summary.claimed, summary.wrong) == (5, 1, 4, 1)
    assert summary.doubted == 1 and summary.told_percent == 40
    # Of three right poses one is within 1 degree in R and two within 3 degrees in t.
    assert summary.rotation_within_percent == pytest.approx(100 / 3)
    assert summary.translation_within_percent == pytest.approx(200 / 3)
    # Focal lengths 1, 2, 20 and 50 % off, each of two cameras.
    assert summary.median_focal_error_percent == pytest.approx(11)
    assert summary.focal_within_percent == 50
    assert (summary.sure_percent, summary.sure_focal_within_percent) == (50, 50)
    assert summary.sure_median_focal_error_percent == pytest.approx(1.5)
    # 4 x 0.9 expected to be right where 3 are; one of 0.2 where none is.
    assert summary.probability_error_percent == pytest.approx(100 * (0.6 + 0.2) / 5)


def test_no_pose_has_no_figures_and_no_word_of_them():
    summary = summarise([camera_score(math.inf, math.nan, math.nan, 0.0)])
    assert (summary.claimed, summary.wrong, summary.told_percent) == (0, 0, 100)
    assert math.isnan(summary.median_focal_error_percent)
    line = camera_table([summary]).splitlines()[-1]
    assert line.split() == "m 0 0 0 100.0 - - - - - - - -".split()
