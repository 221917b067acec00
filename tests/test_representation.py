"""What `print` and a prompt show of the results: a few lines for a person, and no arrays."""

from dataclasses import replace

import dense_scene
import numpy as np
from ambiguous_pose import ambiguous_pose

from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.matching import MatchResult
from dgc_pose.pose import estimate_relative_pose
from two_view import two_view_scene

OPTIONS = EstimationOptions(runs=1, iterations=300)


def test_a_pose_is_a_few_lines() -> None:
    scene = two_view_scene("general", count=300)
    pose = estimate_pose(scene.matches, *scene.cameras, OPTIONS)
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pose = replace(pose, R=R, t=np.array([0.6, -0.8, -1e-9]), probability=0.874)
    R_error, t_error = pose.rotation_error_90_deg, pose.translation_error_90_deg
    assert repr(pose).splitlines() == [
        f"RelativePose: ok, {pose.num_inliers} of 300 matches are inliers",
        "  R [[0.0000 -1.0000 0.0000] [1.0000 0.0000 0.0000] [0.0000 0.0000 1.0000]]",
        "  t [0.6000 -0.8000 0.0000], up to scale",
        f"  expected error: R {R_error:.3f} deg, t {t_error:.3f} deg, nine times in ten if "
        "the pose is right",
        "  probability 87 %",
    ]
    pose = ambiguous_pose()
    assert repr(pose).splitlines() == [
        "RelativePose: ambiguous, 271 of 300 matches are inliers",
        f"  no pose: {pose.reason}",
        "  2 alternatives: probability 52 %, probability 45 %",
    ]


def test_a_trace_is_its_images_matches_and_pose() -> None:
    """And no array is printed."""
    matcher = dense_scene.MapMatcher(dense_scene.true_map())
    trace = estimate_relative_pose(
        *dense_scene.pictures(), dense_scene.K, matcher=matcher, options=OPTIONS, trace=True
    )
    images, matches, *pose = repr(trace).splitlines()
    assert images == "Trace: Image(image1, 320 x 240), Image(image2, 320 x 240)"
    assert matches == repr(trace.matches) and pose == repr(trace.pose).splitlines()
    result = repr(MatchResult(trace.matches, trace.correspondence_map))
    assert "CorrespondenceMap(160 x 160 cells, 320 x 240 to 320 x 240, matchability=" in result
    assert "array" not in result and "\n" not in result
