"""What `print` and a prompt show of the results: a few lines for a person, and no arrays."""

from dataclasses import replace

import dense_scene
import numpy as np
from ambiguous_pose import ambiguous_pose

from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.images.image import Image
from dgc_pose.matching import MatchResult
from two_view import SceneKind, two_view_scene

OPTIONS = EstimationOptions(runs=1, iterations=300)


def pose_of(kind: SceneKind):
    scene = two_view_scene(kind, count=300)
    return estimate_pose(scene.matches, *scene.cameras, OPTIONS)


def test_a_pose_is_five_lines() -> None:
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pose = replace(pose_of("general"), R=R, t=np.array([0.6, -0.8, -1e-9]), probability=0.874)
    R_error, t_error = pose.rotation_error_90_deg, pose.translation_error_90_deg
    assert repr(pose).splitlines() == [
        f"RelativePose: ok, {pose.num_inliers} of 300 matches are inliers",
        "  R [[0.0000 -1.0000 0.0000] [1.0000 0.0000 0.0000] [0.0000 0.0000 1.0000]]",
        "  t [0.6000 -0.8000 0.0000], up to scale",
        f"  expected error: R {R_error:.3f} deg, t {t_error:.3f} deg, nine times in ten if "
        "the pose is right",
        "  probability 87 %",
    ]
    other = ambiguous_pose().alternatives[1]
    more = repr(replace(pose, alternatives=(other,))).splitlines()
    assert len(more) == 5 and more[-1] == "  probability 87 %, 1 alternative: probability 45 %"


def test_no_pose_has_its_reason() -> None:
    pose = ambiguous_pose()
    assert repr(pose).splitlines() == [
        "RelativePose: ambiguous, 271 of 300 matches are inliers",
        f"  no pose: {pose.reason}",
        "  2 alternatives: probability 52 %, probability 45 %",
    ]
    assert repr(pose.alternatives[0]).endswith(
        "t=[0.6000 0.0000 0.8000], 271 inliers, probability 52 %)"
    )


def test_matches_and_images_are_their_sizes() -> None:
    key_points = replace(two_view_scene(count=40).matches, key_points=True)
    result = repr(MatchResult(key_points, dense_scene.true_map()))
    assert result.startswith("MatchResult(matches=Matches(40 key points, error_px=0.5), ")
    assert "CorrespondenceMap(160 x 160 cells, 320 x 240 to 320 x 240, matchability=" in result
    assert "array" not in result and "\n" not in result
    assert repr(Image(np.zeros((5, 7, 3), np.uint8), "a.jpg")) == "Image(a.jpg, 7 x 5)"
