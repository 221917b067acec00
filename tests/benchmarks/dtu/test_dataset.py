from itertools import combinations

import cv2
import numpy as np
import pytest
from dtu_layout import (
    SIZE,
    WRITERS,
    Scan,
    grey_scan,
    rendered_scan,
    write_mvsnet,
    write_mvsnet_training,
    write_raw,
)

from dgc_pose.benchmarks.dtu.calibration import DtuView, relative_pose
from dgc_pose.benchmarks.dtu.dataset import open_dataset
from dgc_pose.errors import InputError

LAYOUTS = list(WRITERS)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("extension", ["png", "jpg"])
def test_each_layout_is_found_by_looking(tmp_path, layout, extension):
    scan = grey_scan([0, 10, 20])
    for number in (118, 4):
        WRITERS[layout](tmp_path, scan, number=number, extension=extension)
    dataset = open_dataset(tmp_path)
    assert (dataset.layout, dataset.root, dataset.left_out) == (layout, tmp_path, ())
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


@pytest.mark.parametrize("layout", LAYOUTS)
def test_views_are_those_of_their_images(tmp_path, layout):
    """A surface point has one colour, whichever image it is looked up in."""
    scan = rendered_scan()
    WRITERS[layout](tmp_path, scan, extension="png")
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


def full_size_scan(degrees) -> Scan:
    """Cameras for images of 1600x1200, each image with one soft spot at its middle's point."""
    K = np.array([[2892.33, 0, 823.205], [0, 2883.18, 619.071], [0, 0, 1]])
    views = {n: DtuView(K, v.R, v.t + [n, 2.0, 0]) for n, v in grey_scan(degrees).views.items()}
    y, x = np.mgrid[:1200, :1600].astype(float)
    images = {}
    for number, view in views.items():
        u, v, w = view.K @ view.t  # the world's origin
        spot = 255 * np.exp(-((x - u / w) ** 2 + (y - v / w) ** 2) / (2 * 12**2))
        images[number] = np.repeat(spot.round().astype(np.uint8)[..., None], 3, axis=2)
    return Scan(views, images, {})


def centroid(image: np.ndarray) -> np.ndarray:
    weights = image[..., 0].astype(float)
    y, x = np.mgrid[: weights.shape[0], : weights.shape[1]]
    return np.array([(weights * x).sum(), (weights * y).sum()]) / weights.sum()


def test_half_size_crops_come_with_their_own_camera(tmp_path):
    scan = full_size_scan([-9, 5])
    crops = {}
    for number, image in scan.images.items():
        half = cv2.resize(image, (800, 600), interpolation=cv2.INTER_AREA)
        crops[number] = half[44 : 44 + 512, 80 : 80 + 640]
    write_mvsnet_training(tmp_path, Scan(scan.views, crops, {}), suffix="_train")
    (scene,) = open_dataset(tmp_path).scenes
    assert scene.size == (640, 512)
    for number, view in scene.views.items():
        assert scene.images[number].parent.name == "scan65_train"
        u, v, w = view.K @ view.t
        assert np.allclose((u / w, v / w), centroid(crops[number]), atol=0.02)
        assert np.allclose(view.R, scan.views[number].R, atol=1e-12)
        # What MVSNet's own Cameras/train say at a quarter of this size, but for half a pixel.
        assert np.allclose(view.K[:2, 2] / 4, [82.900625, 66.383875], atol=0.07)
        assert np.allclose(view.K[[0, 1], [0, 1]] / 4, [361.54125, 360.3975], atol=1e-9)


def test_full_size_images_are_taken_where_both_are_there(tmp_path):
    write_mvsnet_training(tmp_path, grey_scan([0, 10]), suffix="_train")
    with pytest.raises(InputError, match="expected 640 x 512 pixels, found 160 x 120"):
        open_dataset(tmp_path)
    write_mvsnet_training(tmp_path, grey_scan([0, 10]))
    (scene,) = open_dataset(tmp_path).scenes
    assert (scene.images[1].parent.name, scene.size) == ("scan65", SIZE)


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


IMAGE_2 = {
    "raw": "Rectified/scan65/rect_002_3_r5000.png",
    "mvsnet": "scan65/images/00000001.png",
}
CALIBRATION_4 = {
    "raw": "Calibration/cal18/pos_004.txt",
    "mvsnet": "scan65/cams/00000003_cam.txt",
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_views_that_are_not_there_are_left_out_and_named(tmp_path, layout):
    scan = grey_scan([0, 10, 20, 30, 40])
    WRITERS[layout](tmp_path, scan, extension="png")
    (tmp_path / IMAGE_2[layout]).unlink()
    (tmp_path / CALIBRATION_4[layout]).unlink()
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


def test_what_is_no_known_layout_is_an_error_that_says_what_would_be(tmp_path):
    with pytest.raises(InputError, match="none of the layouts .*cal18.*_cam.txt"):
        open_dataset(tmp_path)
    with pytest.raises(InputError, match="nowhere: no such folder"):
        open_dataset(tmp_path / "nowhere")
    (tmp_path / "Calibration/cal18").mkdir(parents=True)
    with pytest.raises(InputError, match="no scene, expected .*Rectified/scan1"):
        open_dataset(tmp_path)
    write_raw(tmp_path, grey_scan([0, 10]))
    with pytest.raises(InputError, match="expected mvsnet: Cameras/00000000_cam.txt"):
        open_dataset(tmp_path, layout="mvsnet")


def test_of_several_layouts_one_must_be_named(tmp_path):
    write_raw(tmp_path, grey_scan([0, 10]))
    write_mvsnet(tmp_path, grey_scan([0, 10, 20]))
    with pytest.raises(InputError, match="layouts raw and mvsnet"):
        open_dataset(tmp_path)
    assert len(open_dataset(tmp_path, layout="raw").scenes[0].views) == 2
    assert len(open_dataset(tmp_path, layout="mvsnet").scenes[0].views) == 3


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_calibration_of_another_image_size_is_refused(tmp_path, layout):
    scan = grey_scan([0, 10])
    small = dict.fromkeys(scan.views, np.zeros((60, 80, 3), np.uint8))
    WRITERS[layout](tmp_path, Scan(scan.views, small, {}), extension="png")
    with pytest.raises(InputError, match=r"\.png has its principal point .* the image has 80x60"):
        open_dataset(tmp_path)
