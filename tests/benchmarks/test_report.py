from __future__ import annotations

import csv
import io
import json
import math

import pytest

from dgc_pose.benchmarks.pairs import MethodSummary, PairResult
from dgc_pose.benchmarks.report import ResultsTable, heading, summary_data, summary_table
from dgc_pose.estimation import EstimationOptions

KEYS = [
    "method",
    "pairs",
    "failures",
    "median_rotation_deg",
    "median_translation_deg",
    "median_translation_folded_deg",
    "auc5",
    "auc10",
    "auc20",
    "seconds_per_pair",
]
GOOD = MethodSummary("dgcm-lite", 64, 2, 1.25, 3.5, 3.25, 61.0, 75.5, 83.25, 0.4)
LOST = MethodSummary("sift", 64, 40, math.inf, math.inf, math.inf, 10.0, 12.0, 14.0, 1.5)


def test_the_summary_is_valid_json_with_the_keys():
    data = json.loads(json.dumps(summary_data([GOOD, LOST]), allow_nan=False))
    assert list(data) == ["methods"]
    assert [list(method) for method in data["methods"]] == [KEYS, KEYS]
    assert data["methods"][0]["median_rotation_deg"] == 1.25
    assert data["methods"][1]["median_rotation_deg"] is None
    assert data["methods"][1]["failures"] == 40


def test_the_table_tells_infinite_medians_and_the_share_of_failures():
    header, good, lost = summary_table([GOOD, LOST]).splitlines()
    assert len(header) == len(good) == len(lost)
    assert good.split() == "dgcm-lite 64 2 (3.1 %) 1.25 3.50 3.25 61.0 75.5 83.2 0.40".split()
    assert lost.split() == "sift 64 40 (62.5 %) inf inf inf 10.0 12.0 14.0 1.50".split()


def test_the_heading_names_the_estimator():
    text = heading(EstimationOptions(estimator="opencv", runs=3, iterations=200, threshold_px=1.5))
    assert "opencv, 3 runs of 200 iterations, threshold 1.5 px" in text


def result(**changes):
    values = {
        "method": "sift",
        "image1": "a, b.png",
        "image2": "c.png",
        "true_rotation_deg": 12.5,
        "status": "ok",
        "success": True,
        "num_matches": 100,
        "num_inliers": 80,
        "inlier_ratio": 0.8,
        "rotation_error_deg": 0.5,
        "translation_error_deg": 177.0,
        "translation_folded_deg": 3.0,
        "match_seconds": 0.25,
        "estimate_seconds": 0.125,
    }
    return PairResult(**(values | changes))


def test_each_row_is_out_as_soon_as_it_is_added(tmp_path):
    path = tmp_path / "results.csv"
    with path.open("w", newline="") as stream:
        table = ResultsTable(stream)
        for count in range(1, 4):
            table.add(result(num_matches=count))
            rows = list(csv.DictReader(io.StringIO(path.read_text())))
            assert [row["num_matches"] for row in rows] == [str(n) for n in range(1, count + 1)]


def test_a_row_holds_every_field():
    stream = io.StringIO()
    ResultsTable(stream).add(result(success=False, rotation_error_deg=math.inf))
    (row,) = csv.DictReader(io.StringIO(stream.getvalue()))
    assert row["image1"] == "a, b.png"
    assert row["success"] == "False"
    assert float(row["rotation_error_deg"]) == math.inf
    assert float(row["translation_error_deg"]) == pytest.approx(177)
