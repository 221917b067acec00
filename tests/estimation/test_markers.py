"""The side of markers by their corners in several images, beside the true one."""

import re

import numpy as np
import pytest
from marker_scene import draw_markers, pixels_of, square, texture
from scipy.spatial.transform import Rotation

from dgc_pose import InputError
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.scale import MarkerSide, marker_side
from dgc_pose.images.markers import find_markers

SIZE = (640, 480)
K = np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
CAMERA = Camera(K, SIZE)


def views(count: int) -> list[np.ndarray]:
    """cam_from_world of cameras on a line that face (0, 0, 2)."""
    poses = []
    for x in np.linspace(-0.4, 0.4, count):
        R = Rotation.from_euler("yz", [-np.arctan2(-x, 2), 0.2 * x]).as_matrix()
        poses.append(np.column_stack([R, -R @ (x, 0.1 * x, 0)]))
    return poses


def measured(
    markers: dict[str, np.ndarray], poses: list[np.ndarray], error_px: float = 0.1, seed: int = 0
) -> MarkerSide:
    rng, seen = np.random.default_rng(seed), []
    for pose in poses:
        exact = {name: pixels_of(K, pose, corners) for name, corners in markers.items()}
        seen.append({name: at + rng.normal(0, error_px, (4, 2)) for name, at in exact.items()})
    return marker_side(seen, [CAMERA] * len(poses), poses)


def test_drawn_markers_60_pixels_wide_in_three_pictures() -> None:
    """Within 1 %, and as the deviation states."""
    off = []
    for seed in range(4):
        side = 2 * 60 / 900
        corners = square(side, (0.1, -0.1, 2), np.random.default_rng(seed).normal(0, 0.3, 3))
        seen = []
        for number, pose in enumerate(views(3)):
            image = texture(SIZE, 10 * seed + number)
            marker = {"APRILTAG_36h11:7": corners}
            seen.append(find_markers(draw_markers(image, K, pose, marker, number)))
        found = marker_side(seen, [CAMERA] * 3, views(3))
        assert found.images == {"APRILTAG_36h11:7": 3} and 0.001 < found.std < 0.01
        off.append(found.side / side - 1)
    assert np.abs(off).max() < 0.005


def test_the_side_of_each_seed_is_within_its_deviation() -> None:
    corners, off = square(0.15, (0.1, 0.1, 2), (0.4, 0.2, 0)), []
    for seed in range(40):
        found = measured({"a:1": corners}, views(2), 0.5, seed)
        off.append((found.side / 0.15 - 1) / found.std)
    assert 0.3 < np.std(off) < 1.3 and abs(np.mean(off)) < 0.3


def test_several_markers_are_measured_together() -> None:
    markers = {f"a:{n}": square(0.15, (0.2 * n, 0, 2), (0.1 * n, 0, 0)) for n in range(-1, 2)}
    one, three = measured({"a:0": markers["a:0"]}, views(4)), measured(markers, views(4))
    assert abs(three.side / 0.15 - 1) < 0.005 and three.std < one.std
    assert three.images == dict.fromkeys(markers, 4)


def test_markers_of_two_sizes_are_refused() -> None:
    markers = {"a:3": square(0.2, (0.2, 0, 2)), "a:7": square(0.1, (-0.2, 0, 2))}
    with pytest.raises(
        InputError, match=r"of one size, and a:3 is 2(\.\d+)? times as large as a:7$"
    ):
        measured(markers, views(3))


def test_what_is_no_square_is_left_out() -> None:
    """A false find has other corners in each image; a bad image is left out of three others."""
    right = {"a:1": square(0.15, (0.1, 0, 2))}
    poses, rng = views(4), np.random.default_rng(0)
    seen = [{"a:1": pixels_of(K, pose, right["a:1"])} for pose in poses]
    seen[2]["a:1"] = seen[2]["a:1"] + (25, 10)
    for of_image in seen:
        of_image["a:2"] = rng.uniform(100, 400, 2) + pixels_of(K, poses[0], right["a:1"])
    found = marker_side(seen, [CAMERA] * 4, poses)
    assert found.images == {"a:1": 3} and found.side == pytest.approx(0.15, rel=1e-4)
    kite = square(0.15, (0.1, 0, 2)) * (1, 2, 1)
    for markers, more in (({"a:1": kite}, " that is a square under the poses"), ({}, "")):
        message = f"marker needs a marker in two of the 4 images{more}"
        with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
            measured(markers, poses)
    with pytest.raises(InputError, match="a square under the poses"):
        measured(right, [poses[0]] * 2)  # from one place
