"""Points in pixels of another image than their camera's."""

from dataclasses import replace

import numpy as np
import pytest

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import estimate_pose
from dgc_pose.estimation.extent import odd_extent
from two_view import K1, SIZE1, two_view_scene

POINTS = two_view_scene(count=300).points1  # of 1600 x 1200 pixels
ODD = {  # as another program hands them out, or as real ones may be
    "a resized copy": 0.4 * POINTS,
    "x and y swapped": POINTS[:, ::-1],
    "from -1 to 1": POINTS / (800, 600) - 1,
    "an enlarged copy": 2 * POINTS,
    "COLMAP's convention": POINTS + 0.5,
    "strays": np.vstack([POINTS[:290], np.full((10, 2), 1700.0)]),
    "not finite": np.vstack([POINTS, np.full((30, 2), np.nan), [[np.inf, 0]]]),
    "as they are": POINTS,
    "a third of the image": POINTS[POINTS[:, 0] < 533],
    "few": 0.1 * POINTS[:19],
    "none": POINTS[:0],
}


@pytest.mark.parametrize(
    ("name", "with_size", "without_size"),
    [
        ("a resized copy", "warned", "warned"),
        ("x and y swapped", "refused", "warned"),
        ("from -1 to 1", "warned", "warned"),
        ("an enlarged copy", "refused", "warned"),
        *((name, "taken", "taken") for name in list(ODD)[4:]),
    ],
)
def test_points_of_another_size(name: str, with_size: str, without_size: str) -> None:
    """What is told are the extent of the points and the size; nothing of real points."""
    points = ODD[name]
    sizes = (
        (SIZE1, 1, "1600 x 1200 pixels of camera2", with_size),
        (None, 1.4, "1621 x 1181 pixels of camera2, by 2 cx + 1 and 2 cy + 1", without_size),
    )
    for size, slack, pixels, expected in sizes:
        camera = Camera(K1, size)
        if expected == "taken":
            assert odd_extent(points, camera, 2) == ()
            continue
        (left, top), (right, bottom) = points.min(0), points.max(0)
        middle = (np.array(SIZE1) - 1) / 2 if size else K1[:2, 2]
        outside = (np.abs(points - middle) > slack * (middle + 0.5) + 0.5).any(1).sum()
        reach = (
            f"points2 have x from {left:.0f} to {right:.0f} and y from {top:.0f} to {bottom:.0f}: "
        )
        text = f"{reach}{outside} of 300 lie outside the {pixels}"
        if not outside:
            text = f"{reach}less than half of the {pixels} along both sides"
        if expected == "warned":
            assert odd_extent(points, camera, 2) == (text,)
        else:
            with pytest.raises(InputError) as caught:
                odd_extent(points, camera, 2)
            assert str(caught.value) == text


def test_normalised_points_of_a_K_that_is_the_identity_are_taken() -> None:
    assert odd_extent(Camera(K1).normalise(POINTS), Camera(np.eye(3)), 1) == ()


def test_a_pose_has_the_warnings_of_both_images() -> None:
    scene = two_view_scene(count=300)
    matches = replace(scene.matches, points2=0.4 * scene.points2)
    pose = estimate_pose(matches, *scene.cameras)
    assert [w.split(" have ")[0] for w in pose.warnings if w.startswith("points")] == ["points2"]
    matches = replace(scene.matches, points1=2 * scene.points1, points2=2 * scene.points2)
    for cameras, name in ((scene.cameras, "points1"), ((Camera(K1), scene.cameras[1]), "points2")):
        with pytest.raises(InputError, match=f"^{name} have "):
            estimate_pose(matches, *cameras)
