"""Queries that are pictures of the place: points of a world seen by a camera whose image a plane
homography warps, as a camera does that photographs a print at a slant."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds import CAMERA, IMAGE, OPTIONS, PHOTO_CAMERA, WorldScene, world_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import estimate_pose
from dgc_pose.geometry.homography import transfer_error
from dgc_pose.localization.location import Location
from dgc_pose.localization.search import LocationSearch
from dgc_pose.metrics import rotation_error_deg

NO_POINTS = np.zeros(0, np.int64), np.zeros((0, 2))
MIDDLE = (np.array(IMAGE) - 1) / 2
ASSUMED = Camera(
    np.array([[1000.0, 0, MIDDLE[0]], [0, 1000, MIDDLE[1]], [0, 0, 1]]),
    IMAGE,
    focal_std=0.3,
    centre_std=5.0,
    lens_std=0.02,
    focal_source="size",
)
TO_MIDDLE = np.array([[1, 0, -MIDDLE[0]], [0, 1, -MIDDLE[1]], [0, 0, 1.0]])


def _printed(tilt_deg: float, axis_deg: float) -> np.ndarray:
    """The homography from an image to a photograph of its print, which is tilted about an axis that
    has this angle to the x axis. Both cameras have the same field of view."""
    axis = np.cos(np.radians(axis_deg)), np.sin(np.radians(axis_deg)), 0
    R = Rotation.from_rotvec(np.radians(tilt_deg) * np.array(axis)).as_matrix()
    on_print = np.diag([1 / 1100, 1 / 1100, 1.0]) @ TO_MIDDLE
    K = np.array([[1100.0, 0, MIDDLE[0]], [0, 1100, MIDDLE[1]], [0, 0, 1]])
    return K @ np.column_stack([R[:, 0], R[:, 1], [0, 0, 1.2]]) @ on_print


def _scaled(x: float, y: float, shift_x: float = 0.0, shift_y: float = 0.0) -> np.ndarray:
    return np.array([[x, 0, shift_x], [0, y, shift_y], [0, 0, 1]])


def _located(scene: WorldScene, H: np.ndarray) -> Location:
    """The location of a query whose image the homography warps."""
    search = LocationSearch(scene.model(), ASSUMED, OPTIONS, scene.names)
    for number, name in enumerate(scene.names):
        matches = scene.matches(number, outliers=0.1)
        warped = np.column_stack([matches.points2, np.ones(len(matches))]) @ H.T
        points2 = warped[:, :2] / warped[:, 2:]
        inside = ((points2 > 0) & (points2 < np.array(IMAGE) - 1)).all(axis=1)
        assert transfer_error(matches.points2, points2, H).max() < 1e-6
        seen = replace(matches, points2=points2).subset(inside)
        pose = estimate_pose(seen, CAMERA, search.pair_camera, OPTIONS)
        search.add(name, pose, seen, *NO_POINTS)
    return search.location()


@pytest.mark.parametrize("axis_deg", [70, 90])
def test_a_slanted_print_of_the_place_is_nowhere(axis_deg) -> None:
    location = _located(world_scene(), _printed(15, axis_deg))
    assert location.status == "nowhere" and location.R is None
    assert location.reason.startswith("the query looks like a picture of the place: most matches")
    assert not any(image.agrees for image in location.database_images)


@pytest.mark.parametrize(
    ("H", "told"),
    [
        (_scaled(1, 1), None),
        (_scaled(1, 1, 120, -90), "a principal point of its own"),
        (_scaled(0.8, 1, 0.2 * MIDDLE[0]), "pixels that are not square, fy / fx = 1.2"),
    ],
)
def test_a_cropped_or_squeezed_photograph_is_located(H: np.ndarray, told: str | None) -> None:
    """With a warning about its camera. A print seen from its front is one too."""
    scene = world_scene()
    location = _located(scene, H)
    assert location.success and location.R is not None and location.centre is not None
    assert rotation_error_deg(location.R, scene.R) < 0.5
    assert np.linalg.norm(location.centre - scene.centre) < 0.05
    assert location.camera is not None
    np.testing.assert_allclose(location.camera.K, H @ PHOTO_CAMERA.K, atol=20)
    assert len(location.warnings) == (told is not None)
    if told is not None:
        assert location.warnings[0].startswith(f"the matches agree with {told}")


def test_points_on_a_plane_determine_no_projective_camera() -> None:
    """Each camera there is related to the others by a homography."""
    scene = world_scene(count=400)
    flat = scene.points.copy()
    flat[:, 2] = 6.0 + 0.3 * flat[:, 0]
    location = _located(replace(scene, points=flat), _scaled(1, 1, 90, -60))
    assert "picture" not in location.reason
