import numpy as np
import pytest
from dtu_layout import SIZE, write_scan
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.dtu.dataset import (
    DtuView,
    open_dataset,
    read_projection,
    relative_pose,
)
from dgc_pose.errors import InputError

# The first position of DTU's calibration, as published.
POS_001 = """2607.429996 -3.844898 1498.178098 -533936.661373
-192.076910 2862.552532 681.798177 23434.686572
-0.241605 -0.030951 0.969881 22.540121
"""
K = np.array([[2892.0, 0.5, 823.0], [0.0, 2883.0, 619.0], [0.0, 0.0, 1.0]])
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


def random_view(seed):
    rng = np.random.default_rng(seed)
    return DtuView(K, Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3) * 500)


def test_the_published_first_position(tmp_path):
    path = tmp_path / "pos_001.txt"
    path.write_text(POS_001)
    view = read_projection(path)
    assert np.allclose(view.K, [[2892.33, 0, 823.205], [0, 2883.18, 619.071], [0, 0, 1]], atol=6e-3)
    assert np.linalg.det(view.R) == pytest.approx(1, abs=1e-9)
    centre = -view.R.T @ view.t
    assert np.allclose(centre, [190.8, -1.16, 24.26], atol=0.05)


@pytest.mark.parametrize("scale", [1.0, -1.0, 1e-3, -250.0])
@pytest.mark.parametrize("seed", range(4))
def test_any_scale_of_a_projection_matrix_gives_its_camera(tmp_path, seed, scale):
    view = random_view(seed)
    np.savetxt(tmp_path / "P", scale * view.K @ np.column_stack([view.R, view.t]))
    found = read_projection(tmp_path / "P")
    assert np.allclose(found.K, view.K, atol=1e-8)
    assert np.allclose(found.R, view.R, atol=1e-11)
    assert np.allclose(found.t, view.t, atol=1e-8)


def test_relative_pose_moves_points_from_one_camera_to_the_other():
    view1, view2 = random_view(1), random_view(2)
    R, t = relative_pose(view1, view2)
    world = np.random.default_rng(0).normal(size=(10, 3)) * 300
    for point in world:
        in1 = view1.R @ point + view1.t
        in2 = view2.R @ point + view2.t
        assert np.allclose(R @ in1 + t, in2, atol=1e-9)


@pytest.mark.parametrize(
    "content, message",
    [
        ("1 2 3 4\n5 6 7 8\n", "8 into shape"),
        ("P = 1 2\n" * 3, "not convert string"),
        ("1 0 0 0\n0 1 0 0\n0 0 inf 1\n", "finite numbers and an inverse"),
        ("1 0 0 0\n0 1 0 0\n1 1 0 1\n", "finite numbers and an inverse"),
    ],
)
def test_a_bad_file_is_an_error_with_its_path(tmp_path, content, message):
    path = tmp_path / "calibration.txt"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read_projection(path)
    assert str(caught.value).startswith(f"{path} is not a calibration")
