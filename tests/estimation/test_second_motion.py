"""Two motions: of a plane, and of the matches that it leaves over."""

import numpy as np
import pytest

from dgc_pose.estimation import RelativePose, estimate_pose
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from two_view import TwoViewScene, two_view_scene


def _pose(*scenes: TwoViewScene, key_points: bool = False) -> RelativePose:
    points1, points2 = (
        np.concatenate([getattr(scene, name) for scene in scenes])
        for name in ("points1", "points2")
    )
    matches = Matches(points1, points2, np.ones(len(points1)), 0.5, key_points)
    return estimate_pose(matches, *scenes[0].cameras)


@pytest.mark.parametrize("key_points", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_plane_that_may_have_moved_is_ambiguous(seed: int, key_points: bool) -> None:
    """A plane over most of the image, before a scene that the camera moved past."""
    plane = two_view_scene("planar", seed=seed, count=700, outliers=0.0, rotation_deg=15)
    scene = two_view_scene("general", seed=seed + 9, count=250, outliers=0.1, rotation_deg=25)
    pose = _pose(plane, scene, key_points=key_points)
    assert pose.status == "ambiguous" and pose.R is None and "another motion" in pose.reason
    errors = [
        max(rotation_error_deg(other.R, scene.R), translation_error_deg(other.t, scene.t))
        for other in pose.alternatives
    ]
    assert min(errors) < 2
    if not key_points:
        assert sum(other.probability or 0 for other in pose.alternatives) <= 1


@pytest.mark.parametrize("seed", range(3))
def test_wrong_matches_are_no_second_motion(seed: int) -> None:
    pose = _pose(two_view_scene("planar", seed=seed, outliers=0.4))
    assert pose.evidence is not None and pose.evidence.num_second_inliers == 0


def test_an_object_before_a_scene_with_depth_is_left_over() -> None:
    """The scene is no plane, so that its motion is the camera's."""
    scene = two_view_scene("general", count=700, outliers=0.0)
    pose = _pose(scene, two_view_scene("planar", seed=5, count=150, outliers=0.0))
    assert pose.status == "ok" and rotation_error_deg(pose.R, scene.R) < 0.5
