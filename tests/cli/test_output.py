"""What the commands print of a pose."""

from dataclasses import replace

import numpy as np
from results import INLIERS, ambiguous_pose

from dgc_pose.cameras.camera import Camera
from dgc_pose.cli.output import pose_text
from dgc_pose.estimation import RelativePose


def test_an_ambiguous_pair_has_no_pose_and_all_that_explain_it() -> None:
    pose = ambiguous_pose()
    lines = pose_text(pose).splitlines()
    assert lines[0] == f"no pose (ambiguous): {pose.reason}"
    heads = [line for line in lines if line.startswith("alternative ")]
    assert heads == [
        f"alternative 1: {INLIERS[0]} inliers, probability 52 %",
        f"alternative 2: {INLIERS[1]} inliers, probability 45 %",
    ]
    for head, other in zip(heads, pose.alternatives, strict=True):
        block = lines[lines.index(head) + 1 :][:5]
        R = [[float(v) for v in line.strip(" R[]").split()] for line in block[:3]]
        np.testing.assert_allclose(R, other.R, atol=1e-6)
        t = block[4].removeprefix("  t  [").split("]")[0]
        np.testing.assert_allclose([float(v) for v in t.split()], other.t, atol=1e-6)
    # No R or t besides those of the two, and nothing that is known of one pose alone.
    assert sum(line.startswith("  t  ") for line in lines) == 2
    assert "expected error" not in pose_text(pose) and "camera " not in pose_text(pose)
    assert f"{INLIERS[0]} of 300 matches are inliers of the best essential matrix (90.3 %)" in lines


K = np.array([[1210.0, 0, 639.5], [0, 1210, 479.5], [0, 0, 1]])
FITTED = Camera(
    K, (1280, 960), focal_std=0.01, centre_std=8, focal_source="matches", identity="a telephone"
)
OFF_CENTRE = replace(FITTED, K=K + [[0, 0, 9], [0, 0, 0], [0, 0, 0]])
EXIF = replace(FITTED, K=np.diag((0.9, 0.9, 1)) @ K, focal_std=0.05, focal_source="exif")
TEXT = "f = 1210.0 +- 12.1 px by the matches"
CENTRE = "; principal point (639.5, 479.5) +- 8.0"


def test_focal_lengths_are_told_with_their_deviations() -> None:
    for first, second, priors, lines in (
        (
            *(FITTED, FITTED, (EXIF, EXIF)),
            [f"camera of both images: {TEXT} (1089.0 +- 54.5 px by EXIF data){CENTRE}"],
        ),
        (
            *(replace(FITTED, identity=None), OFF_CENTRE, None),
            [f"camera 1: {TEXT}{CENTRE}", f"camera 2: {TEXT}{CENTRE.replace('639', '648')}"],
        ),
    ):
        found = (np.ones(9, bool), 9, np.eye(3), np.array([1.0, 0, 0]))
        pose = RelativePose("ok", "", *found, camera1=first, camera2=second)
        told = pose_text(pose, priors).splitlines()
        assert [line for line in told if line.startswith("camera ")] == lines
