"""Batches of cameras whose focal length is not known: pooled, estimated again, and resumed."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from batch_runs import Killed, assert_same_result, killed_after, run_sift
from multi_view import K, K_text

from dgc_pose.batch.result import read_batch
from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.errors import InputError

COUNT = 4
PAIRS = COUNT * (COUNT - 1) // 2
FOCAL = float(K[0, 0] + K[1, 1]) / 2
LAST = f"view{COUNT - 1}.png"


@pytest.fixture(scope="module", autouse=True)
def _two_rounds() -> Iterator[None]:
    """The pairs fit again around the pooled camera, as where its principal point is far off."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dgc_pose.batch.folder_cameras.centre_moved", lambda before, after: True)
        yield


@pytest.fixture(scope="module")
def whole(views: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted batch."""
    out = tmp_path_factory.mktemp("whole") / "out"
    run_sift(views, out, K="auto")
    return out


def _assert_same(out: Path, whole: Path) -> None:
    assert_same_result(out, whole)
    assert (out / "cameras.csv").read_text() == (whole / "cameras.csv").read_text()
    assert {path.name for path in out.iterdir()} == {path.name for path in whole.iterdir()}


def test_a_folder_has_one_camera(whole: Path) -> None:
    batch = read_batch(whole)
    (camera,) = batch.summary["cameras"]
    assert (camera["images"], camera["pairs"]) == (COUNT, PAIRS)
    assert camera["focal_px"] == pytest.approx(FOCAL, rel=0.01)
    assert 0.002 < camera["focal_std"] < 0.025 and camera["focal_source"] == "matches"
    for name, final in batch.plan.final_cameras.items():
        assert final.focal == camera["focal_px"] and final.focal_std == camera["focal_std"]
        assert batch.plan.cameras[name].focal == pytest.approx(1.1 * 240)
    for row in batch.rows:
        assert row.pose is not None and row.pose.camera1 is not None
        assert row.pose.camera1.focal == row.pose.K2[0, 0] == camera["focal_px"]
        assert row.pose.focal_std1 == row.pose.focal_std2 == camera["focal_std"]
    assert {path.name for path in whole.iterdir()} >= {"cameras.csv", "summary.json"}


def test_each_image_has_a_camera(views: Path, tmp_path: Path) -> None:
    cameras = run_sift(views, tmp_path / "out", K="auto:two").summary["cameras"]
    assert [camera["first_image"] for camera in cameras] == [f"view{i}.png" for i in range(COUNT)]
    assert all(camera["images"] == 1 and camera["pairs"] < COUNT for camera in cameras)


def test_the_cameras_serve_as_K(views: Path, whole: Path, tmp_path: Path) -> None:
    cameras = read_batch(whole).plan.final_cameras
    again = read_calibration(str(whole / "cameras.csv"))
    for name, camera in cameras.items():
        np.testing.assert_array_equal(again.by_name[name].K, camera.K)
        assert again.by_name[name].focal_std == camera.focal_std
    batch = run_sift(views, tmp_path / "out", K=str(whole / "cameras.csv"))
    assert batch.summary["cameras"][0]["focal_px"] == pytest.approx(FOCAL, rel=0.01)


def test_known_cameras_are_not_pooled(views: Path, tmp_path: Path) -> None:
    batch = run_sift(views, tmp_path / "out", K=K_text())
    assert batch.summary["cameras"] == [] and not batch.plan.uncertain
    assert not (tmp_path / "out" / "cameras.csv").exists()
    assert {row.pose.focal_std1 for row in batch.rows if row.pose} == {0.0}


def test_killed_and_resumed_gives_the_same(views: Path, whole: Path, tmp_path: Path) -> None:
    """While the pairs are matched, while they are fitted again, and while they are estimated."""
    out = tmp_path / "out"
    for after in (2, PAIRS - 2 + 1, PAIRS + 2):
        with pytest.raises(Killed):
            run_sift(views, out, K="auto", start_workers=killed_after(after), resume=out.exists())
        with pytest.raises(InputError, match="not finished"):
            read_batch(out)
    run_sift(views, out, K="auto", resume=True)
    _assert_same(out, whole)
    again = run_sift(views, out, K="auto", resume=True, start_workers=killed_after(0))
    assert again.plan.pooled is not None


@pytest.mark.parametrize("killed", [False, True])
def test_a_photograph_that_changes_changes_the_camera(
    views: Path, whole: Path, tmp_path: Path, *, killed: bool
) -> None:
    """Its pairs are matched again, and the focal lengths of all pairs are pooled again."""
    photos, out = tmp_path / "photos", tmp_path / "out"
    shutil.copytree(views, photos)
    content = (photos / LAST).read_bytes()
    flipped = cv2.imread(str(photos / "view0.png"))[::-1]
    cv2.imwrite(str(photos / LAST), flipped)
    if killed:
        with pytest.raises(Killed):
            run_sift(photos, out, K="auto", start_workers=killed_after(2 * PAIRS + 2))
    else:
        run_sift(photos, out, K="auto")
    (photos / LAST).write_bytes(content)
    os.utime(photos / LAST, (10**9, 10**9))
    batch = run_sift(photos, out, K="auto", resume=True)
    assert batch.summary["matched_now"] == COUNT - 1
    _assert_same(out, whole)
