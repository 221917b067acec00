from __future__ import annotations

import base64
import json

import cv2
import dtu_layout
import dtu_report
import numpy as np
import pytest

from dgc_pose.benchmarks.dtu.dtu_pairs import PAPER_SIZE
from dgc_pose.benchmarks.dtu.report_page import page_data
from dgc_pose.benchmarks.summary import by_method


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return dtu_report.finished_run(tmp_path_factory.mktemp("run"))


def data_of(run, protocol="native"):
    keys = {row.key[1:] for row in run.rows}
    return page_data(run.out, run.pairs(protocol), by_method(run.rows), keys)


def test_each_image_is_there_once_and_is_the_right_one(run) -> None:
    data = data_of(run)
    assert len(data["images"]) == len(dtu_report.DEGREES)
    for entry, pair in zip(run.entries, data["pairs"], strict=True):
        for side in (1, 2):
            name, image = getattr(entry.pair, f"name{side}"), data["images"][pair[f"image{side}"]]
            assert (image["width"], image["height"]) == dtu_layout.SIZE
            kind, content = image["source"].split(",")
            assert kind == "data:image/jpeg;base64"
            shown = cv2.imdecode(np.frombuffer(base64.b64decode(content), np.uint8), 1)
            stored = cv2.imread(str(entry.pair.root / name))
            assert np.abs(shown.astype(float) - stored).mean() < 12


@pytest.mark.parametrize("protocol, size", [("native", dtu_layout.SIZE), ("paper", PAPER_SIZE)])
def test_true_matches_lie_on_the_lines_in_the_protocols_pixels(run, protocol, size) -> None:
    scale = np.array(size) / dtu_layout.SIZE
    data = data_of(run, protocol)
    for entry, pair in zip(run.entries, data["pairs"], strict=True):
        F = np.array(pair["F"]).reshape(3, 3)
        assert np.linalg.norm(F) == pytest.approx(1, abs=1e-6)
        sample = run.samples[("net", entry.scene, entry.view1, entry.view2)]
        one, two = (
            np.column_stack([(points + 0.5) * scale - 0.5, np.ones(len(points))])
            for points in (sample.points1, sample.points2)
        )
        lines = one @ F.T
        distances = np.abs((two * lines).sum(1)) / np.hypot(lines[:, 0], lines[:, 1])
        assert distances[sample.inliers].max() < 0.05  # places are rounded to a hundredth
        assert distances[~sample.inliers].max() > 5


def test_results_are_the_rows_and_null_stands_for_infinite(run) -> None:
    data = json.loads(json.dumps(data_of(run), allow_nan=False))
    assert data["methods"] == [*dtu_report.METHODS]
    for method, results in zip(data["methods"], data["results"], strict=True):
        own = [row for row in run.rows if row.method == method]
        for row, result in zip(own, results, strict=True):
            assert result["seconds"] == row.estimate_seconds
            assert result["R"] == (row.rotation_error_deg if row.success else None)
            assert result["all"] == (None if method == "points" else row.epipolar_all_px)
            sample = run.samples[row.key]
            flat = np.reshape(result["sample"], (-1, 5))
            assert np.abs(flat[:, :2] / 10 - sample.points1).max() <= 0.0501
            assert np.abs(flat[:, 2:4] / 10 - sample.points2).max() <= 0.0501
            assert flat[:, 4].tolist() == sample.inliers.tolist()
