"""Batches of cameras whose focal length is not known: pooled, and estimated again."""

import math

import pytest
from batch_runs import run_sift
from worlds import K

from dgc_pose.batch.result import read_batch

COUNT = 4
FOCAL = float(K[0, 0] + K[1, 1]) / 2


@pytest.fixture(scope="module")
def whole(views, tmp_path_factory):
    return run_sift(views, tmp_path_factory.mktemp("whole") / "out", K="auto").folder


def test_a_folder_has_one_camera(whole):
    batch = read_batch(whole)
    (camera,) = batch.summary["cameras"]
    assert (camera["images"], camera["pairs"]) == (COUNT, COUNT * (COUNT - 1) // 2)
    assert camera["focal_px"] == pytest.approx(FOCAL, rel=0.01)
    assert 0.002 < camera["focal_std"] < 0.025 and camera["focal_source"] == "matches"
    for name, final in batch.plan.final_cameras.items():
        assert final.focal == camera["focal_px"] and final.focal_std == camera["focal_std"]
        before = batch.plan.cameras[name]
        assert before.focal_source in ("size", "lines")
        assert final.focal_std < before.focal_std
        assert abs(math.log(before.focal / FOCAL)) < 3 * before.focal_std
    for row in batch.rows:
        for of_pose in (row.pose.camera1, row.pose.camera2):
            assert (of_pose.focal, of_pose.focal_std) == (camera["focal_px"], camera["focal_std"])


def test_each_image_has_a_camera(views, tmp_path):
    cameras = run_sift(views, tmp_path / "out", K="auto:two").summary["cameras"]
    assert [camera["first_image"] for camera in cameras] == [f"view{i}.png" for i in range(COUNT)]
    assert all(camera["images"] == 1 and camera["pairs"] < COUNT for camera in cameras)


def test_known_cameras_are_not_pooled(views, tmp_path):
    batch = run_sift(views, tmp_path / "out")
    assert batch.summary["cameras"] == [] and not batch.plan.uncertain
    assert not (tmp_path / "out" / "cameras.csv").exists()
    assert {(row.pose.camera1.focal, row.pose.focal_std1) for row in batch.rows} == {(FOCAL, 0.0)}
