"""Points in pixels of another image than their camera's."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import K1, SIZE1, two_view_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import estimate_pose
from dgc_pose.estimation.extent import odd_extent

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


SAID = {  # of a camera of 1600 x 1200 pixels, and of one without a size
    "a resized copy": ["less than half of the 1600 x 1200", "less than half of the 1621 x 1181"],
    "x and y swapped": ["refused", "lie outside the 1621 x 1181"],
    "from -1 to 1": ["less than half of the 1600 x 1200", "less than half of the 1621 x 1181"],
    "an enlarged copy": ["refused", "lie outside the 1621 x 1181"],
}


@pytest.mark.parametrize("name", ODD)
def test_points_of_another_size(name: str) -> None:
    """What is told are the extent of the points and the size; nothing of real points."""
    points = ODD[name]
    for camera, said in zip((Camera(K1, SIZE1), Camera(K1)), SAID.get(name, ("", "")), strict=True):
        if said == "refused":
            with pytest.raises(InputError, match="of 300 lie outside the 1600 x 1200 pixels"):
                odd_extent(points, camera, 2)
            continue
        texts = odd_extent(points, camera, 2)
        assert len(texts) == bool(said)
        if texts:
            left, right = points[:, 0].min(), points[:, 0].max()
            assert texts[0].startswith(f"points2 have x from {left:.0f} to {right:.0f} and y from ")
            assert said in texts[0] and "pixels of camera2" in texts[0]


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
