from itertools import combinations

import cv2
import numpy as np
import pytest
from dtu_layout import (
    SIZE,
    Scan,
    grey_scan,
    rendered_scan,
    write_raw,
)

from dgc_pose.benchmarks.dtu.calibration import relative_pose
from dgc_pose.benchmarks.dtu.dataset import open_dataset
from dgc_pose.errors import InputError


@pytest.mark.parametrize("extension", ["png", "jpg"])
def test_scenes_are_found_by_looking(tmp_path, extension):
    scan = grey_scan([0, 10, 20])
    for number in (118, 4):
        write_raw(tmp_path, scan, number=number, extension=extension)
    dataset = open_dataset(tmp_path)
    assert (dataset.root, dataset.left_out) == (tmp_path, ())
    assert [(scene.name, scene.number) for scene in dataset.scenes] == [
        ("scan4", 4),
        ("scan118", 118),
    ]
    for scene, views in zip(dataset.scenes, (49, 64), strict=True):
        assert sorted(scene.views) == sorted(scene.images) == [1, 2, 3]
        assert all(path.is_file() for path in scene.images.values())
        assert {path.suffix for path in scene.images.values()} == {f".{extension}"}
        assert len(set(scene.images.values())) == 3
        assert scene.size == SIZE
        assert scene.missing == views - 3


def test_views_are_those_of_their_images(tmp_path):
    """A surface point has one colour, whichever image it is looked up in."""
    scan = rendered_scan()
    write_raw(tmp_path, scan, extension="png")
    (scene,) = open_dataset(tmp_path).scenes
    images = {n: cv2.imread(str(path)).astype(float) for n, path in scene.images.items()}
    for one, two in combinations(scene.views, 2):
        R, t = relative_pose(scene.views[one], scene.views[two])
        y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(scene.views[one].K).T
        points = rays * scan.depths[one][..., None] @ R.T + t
        projected = points @ scene.views[two].K.T
        place = (projected[..., :2] / projected[..., 2:]).astype(np.float32)
        seen = (place > 0).all(-1) & (place < np.array(SIZE) - 1).all(-1)
        there = cv2.remap(images[two], place[..., 0], place[..., 1], cv2.INTER_LINEAR)
        difference = np.abs(there - images[one]).mean(-1)[seen]
        moved = np.abs(images[two] - images[one]).mean(-1)[seen]
        assert np.median(difference) < 0.4 * np.median(moved)


def test_the_sample_set_has_everything_one_folder_further_down(tmp_path):
    write_raw(tmp_path / "MVS Data", grey_scan([0, 10]))
    dataset = open_dataset(tmp_path)
    assert (dataset.root, len(dataset.scenes[0].views)) == (tmp_path / "MVS Data", 2)


@pytest.mark.parametrize("light", ["5", "max"])
def test_another_light_is_another_image(tmp_path, light):
    write_raw(tmp_path, grey_scan([0, 10]), light=light)
    assert len(open_dataset(tmp_path, light=light).scenes) == 1
    with pytest.raises(InputError, match=r"scan65 has 0 views .*light 3"):
        open_dataset(tmp_path)


def test_cleaned_images_serve_where_there_are_no_rectified_ones(tmp_path):
    write_raw(tmp_path, grey_scan([0, 10]), number=1, kind="Cleaned", light="max")
    write_raw(tmp_path, grey_scan([0, 10]), number=2, kind="Cleaned", light="max")
    write_raw(tmp_path, grey_scan([0, 10]), number=2, light="max")
    names = [scene.images[2] for scene in open_dataset(tmp_path, light="max").scenes]
    assert names == [
        tmp_path / "Cleaned/scan1/clean_002_max.png",
        tmp_path / "Rectified/scan2/rect_002_max.png",
    ]


def test_views_that_are_not_there_are_left_out_and_named(tmp_path):
    scan = grey_scan([0, 10, 20, 30, 40])
    write_raw(tmp_path, scan, extension="png")
    (tmp_path / "Rectified/scan65/rect_002_3_r5000.png").unlink()
    (tmp_path / "Calibration/cal18/pos_004.txt").unlink()
    (scene,) = open_dataset(tmp_path).scenes
    assert sorted(scene.views) == sorted(scene.images) == [1, 3, 5]
    assert scene.missing == 46


def test_scenes_of_fewer_than_two_views_are_left_out_but_not_when_asked_for(tmp_path):
    write_raw(tmp_path, grey_scan([0, 10]), number=7)
    write_raw(tmp_path, grey_scan([0]), number=8)
    dataset = open_dataset(tmp_path)
    assert [scene.number for scene in dataset.scenes] == [7]
    assert dataset.left_out == (8,)
    with pytest.raises(InputError, match="scan8 has 1 views .*two are needed"):
        open_dataset(tmp_path, scenes=[7, 8])
    assert len(open_dataset(tmp_path, scenes=[7, 7]).scenes) == 1


def test_what_is_no_copy_of_dtu_is_an_error_that_says_what_would_be(tmp_path):
    with pytest.raises(InputError, match="no scene of DTU.*cal18.*Rectified"):
        open_dataset(tmp_path)
    with pytest.raises(InputError, match="nowhere: no such folder"):
        open_dataset(tmp_path / "nowhere")


def test_a_calibration_of_another_image_size_is_refused(tmp_path):
    scan = grey_scan([0, 10])
    small = dict.fromkeys(scan.views, np.zeros((60, 80, 3), np.uint8))
    write_raw(tmp_path, Scan(scan.views, small, {}), extension="png")
    with pytest.raises(InputError, match=r"\.png has its principal point .* the image has 80x60"):
        open_dataset(tmp_path)
