import numpy as np
import pytest
from dtu_layout import SIZE, write_scan

from dgc_pose.benchmarks.dtu.dataset import open_dataset
from dgc_pose.errors import InputError

CLEANED = "Cleaned/scan{scan}/clean_{view:03d}_max.png"


def test_scenes_are_found_by_looking_and_views_without_a_file_are_left_out(tmp_path):
    for number in (118, 4):
        names = (
            f"Rectified/scan{{scan}}/rect_{{view:03d}}_3_r5000.{'jpg' if number == 4 else 'png'}"
        )
        write_scan(tmp_path, [0, 10, 20, 30, 40], number, names=names)
    write_scan(tmp_path, [0], 7)  # too few
    (tmp_path / "Rectified/scan118/rect_002_3_r5000.png").unlink()
    (tmp_path / "Calibration/cal18/pos_004.txt").unlink()
    root, scenes = open_dataset(tmp_path)
    assert root == tmp_path and [scene.number for scene in scenes] == [4, 118]
    for scene, left in zip(scenes, ([1, 2, 3, 5], [1, 3, 5]), strict=True):
        assert sorted(scene.views) == sorted(scene.images) == left
        assert all(f"_{n:03d}_" in path.name and path.is_file() for n, path in scene.images.items())
        assert scene.size == SIZE
        assert scene.missing == (49 if scene.number == 4 else 64) - len(left)
    assert [scene.number for scene in open_dataset(tmp_path, 118)[1]] == [118]


def test_other_layouts_and_lights(tmp_path):
    """The sample set has everything one folder further down."""
    root = tmp_path / "MVS Data"
    write_scan(root, [0, 10], 1, names=CLEANED)
    write_scan(root, [0, 10], 2, names=CLEANED)
    write_scan(root, [0, 10], 2, names="Rectified/scan{scan}/rect_{view:03d}_max.png")
    found, scenes = open_dataset(tmp_path, light="max")
    assert found == root
    assert [str(scene.images[2].relative_to(root)) for scene in scenes] == [
        "Cleaned/scan1/clean_002_max.png",
        "Rectified/scan2/rect_002_max.png",
    ]


def test_what_is_no_copy_of_dtu_is_an_error_that_says_what_would_be(tmp_path):
    for root in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(InputError, match="a scan with two views.*cal18.*Rectified"):
            open_dataset(root)
    write_scan(tmp_path, [0], 7)
    with pytest.raises(InputError, match="scan7 with two views, of light 5"):
        open_dataset(tmp_path, 7, "5")


def test_a_calibration_of_another_image_size_is_refused(tmp_path):
    write_scan(tmp_path, np.array([0, 10]), size=(80, 60))
    with pytest.raises(InputError, match=r"\.png has its principal point .* the image has 80x60"):
        open_dataset(tmp_path)
