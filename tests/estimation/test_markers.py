"""The side of markers by their corners in several images, beside the true one."""

import re

import numpy as np
import pytest
from marker_scene import draw_markers, pixels_of, square, texture
from scipy.spatial.transform import Rotation

from dgc_pose import InputError
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.marker_side import MarkerSide, marker_side
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


def pictures(
    markers: dict[str, np.ndarray], poses: list[np.ndarray], error_px: float = 0.1, seed: int = 0
) -> list[dict[str, np.ndarray]]:
    rng, seen = np.random.default_rng(seed), []
    for pose in poses:
        exact = {name: pixels_of(K, pose, corners) for name, corners in markers.items()}
        seen.append({name: at + rng.normal(0, error_px, (4, 2)) for name, at in exact.items()})
    return seen


def measured(
    markers: dict[str, np.ndarray], poses: list[np.ndarray], error_px: float = 0.1, seed: int = 0
) -> MarkerSide:
    seen = pictures(markers, poses, error_px, seed)
    return marker_side(seen, [CAMERA] * len(poses), poses)


def wall(poses: list[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """The points of the wall z = 2 in each picture: normalised, with their depths."""
    points = np.column_stack([np.random.default_rng(0).uniform(-1, 1, (400, 2)), np.full(400, 2.0)])
    local = [points @ pose[:, :3].T + pose[:, 3] for pose in poses]
    return [(at[:, :2] / at[:, 2:], at[:, 2]) for at in local]


def test_drawn_markers_60_pixels_wide_tell_their_side() -> None:
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
    for markers in seen:
        markers["a:2"] = rng.uniform(100, 400, 2) + pixels_of(K, poses[0], right["a:1"])
    found = marker_side(seen, [CAMERA] * 4, poses)
    assert found.images == {"a:1": 3} and found.side == pytest.approx(0.15, rel=1e-4)
    kite = square(0.15, (0.1, 0, 2)) * (1, 2, 1)
    none = ": a:1 is a square under the poses of 0 of its 4 images"
    for markers, more in (({"a:1": kite}, none), ({}, "")):
        message = f"marker needs a marker in two of the 4 images{more}"
        with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
            measured(markers, poses)
    with pytest.raises(InputError, match="a square under the poses"):
        measured(right, [poses[0]] * 2)  # from one place


def moved_along_the_baseline(
    markers: dict[str, np.ndarray], poses: list[np.ndarray], share: float, name: str
) -> list[dict[str, np.ndarray]]:
    """Two pictures, between which a marker moves by a share of the cameras' distance. It is a
    square under the poses, too."""
    first, second = (-pose[:, :3].T @ pose[:, 3] for pose in poses)
    moved = {**markers, name: markers[name] + share * (second - first)}
    return [*pictures(markers, poses[:1]), *pictures(moved, poses[1:], seed=1)]


def test_a_marker_that_moved_between_two_pictures_is_named() -> None:
    """By the points around it: behind them it does not count; in front of them it may stand out,
    and has no stated error. Another marker is used alone."""
    poses = views(2)
    markers = {"a:1": square(0.15, (0.1, 0, 2)), "a:2": square(0.15, (-0.2, 0.1, 2))}
    alone, cameras = {"a:1": markers["a:1"]}, [CAMERA] * 2
    still = marker_side(pictures(alone, poses), cameras, poses, wall(poses))
    assert still.warnings == () and abs(still.side / 0.15 - 1) < 3 * still.std < 0.03
    away = moved_along_the_baseline(alone, poses, 0.1, "a:1")
    assert marker_side(away, cameras, poses).side > 1.1 * 0.15  # nothing shows it
    with pytest.raises(InputError, match=": a:1 is 11 % farther than the points around it$"):
        marker_side(away, cameras, poses, wall(poses))
    near = moved_along_the_baseline(alone, poses, -0.1, "a:1")
    found = marker_side(near, cameras, poses, wall(poses))
    assert found.std is None and found.side < 0.95 * 0.15
    (told,) = found.warnings
    nearer = "marker a:1 is 9 % nearer than the points around it"
    assert told == f"{nearer}: it is used, without a stated error"
    for share in (0.1, -0.1):
        seen = moved_along_the_baseline(markers, poses, share, "a:1")
        found = marker_side(seen, cameras, poses, wall(poses))
        assert abs(found.side / 0.15 - 1) < 3 * found.std < 0.03
        assert [*found.images] == ["a:2"]
        (told,) = found.warnings
        assert told.startswith("marker a:1 is ") and told.endswith(": it is not used")


def test_a_marker_amid_points_does_not_stand_out() -> None:
    poses, rng = views(2), np.random.default_rng(0)
    points = rng.uniform((-1, -1, 1.7), (1, 1, 2.3), (400, 3))
    local = [points @ pose[:, :3].T + pose[:, 3] for pose in poses]
    cloud = [(at[:, :2] / at[:, 2:], at[:, 2]) for at in local]
    seen = pictures({"a:1": square(0.15, (0.1, 0, 2))}, poses)
    found = marker_side(seen, [CAMERA] * 2, poses, cloud)
    assert found.std is not None and found.warnings == ()


def test_most_markers_and_most_pictures_decide() -> None:
    markers = {f"a:{n}": square(0.15, (0.2 * n, 0, 2)) for n in range(3)}
    seen = moved_along_the_baseline(markers, views(2), 0.1, "a:1")
    found = marker_side(seen, [CAMERA] * 2, views(2))
    assert [*found.images] == ["a:0", "a:2"] or [*found.images] == ["a:2", "a:0"]
    (told,) = found.warnings
    assert re.match(r"marker a:1 is 1\.1\d* times as large as a:\d: it is not used$", told)
    poses = views(5)
    moved = {"a:0": markers["a:0"] + (0, 0.05, 0)}
    seen = [*pictures({"a:0": markers["a:0"]}, poses[:3]), *pictures(moved, poses[3:])]
    found = marker_side(seen, [CAMERA] * 5, poses)
    assert found.images == {"a:0": 3} and abs(found.side / 0.15 - 1) < 0.01
    assert found.warnings == (
        "marker a:0 is a square under the poses of 3 of its 5 images: it is used",
    )
    with pytest.raises(InputError, match=" 2 of its 4 images$"):
        marker_side([*seen[:2], *seen[3:]], [CAMERA] * 4, [*poses[:2], *poses[3:]])
