"""Results of pairs whose poses are made up or known."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from worlds import SIZE, K

from dgc_pose.batch.pairs import PairRow, row_of
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import Hypothesis, RelativePose, Status
from dgc_pose.estimation.evidence import Evidence

GOOD_EVIDENCE = Evidence(
    num_inliers=300,
    inlier_ratio=0.6,
    chance_ratio=0.01,
    log10_false_alarms=-100.0,
    cheirality_ratio=0.95,
    rotation=np.eye(3),
    num_rotation_inliers=100,
    rotation_share=0.3,
    strict_rotation_share=0.2,
    parallax=20.0,
    median_triangulation_angle_deg=8.0,
    homography_ratio=0.4,
    collinear=False,
    occupied_cells=80,
    key_points=False,
    raw_rotation_90_deg=0.5,
    raw_translation_90_deg=1.0,
    raw_focal_90_percent=None,
    residual=0.2,
    threshold_cells=0.05,
    confidence=0.95,
    other_ratio=0.3,
    map_matchability=0.5,
    map_agreement=0.9,
    map_chance=0.2,
)
EYE = np.eye(3)
PROBABILITIES = 0.52, 0.45
INLIERS = 271, 270


def ambiguous_pose(count: int = 300) -> RelativePose:
    """The result of a pair of so many matches that two poses explain."""
    rotations = Rotation.from_rotvec([[0.0, 0.5, 0.0], [0.1, -0.3, 0.0]]).as_matrix()
    directions = np.array([[0.6, 0.0, 0.8], [-0.8, 0.6, 0.0]])
    inliers = [np.arange(count) < number for number in INLIERS]
    every = np.ones(count, dtype=bool)
    return RelativePose(
        status="ambiguous",
        reason="two poses explain the matches: probabilities 52 % and 45 %",
        inliers=inliers[0],
        num_matches=count,
        evidence=replace(GOOD_EVIDENCE, num_inliers=INLIERS[0], inlier_ratio=INLIERS[0] / count),
        any_probability=sum(PROBABILITIES),
        alternatives=tuple(
            Hypothesis(R, t, found, every, probability=probability)
            for R, t, found, probability in zip(
                rotations, directions, inliers, PROBABILITIES, strict=True
            )
        ),
    )


def pair_row(
    names: str | tuple[str, str],
    status: Status = "ok",
    R: np.ndarray = EYE,
    t: Sequence[float] = (0.0, 0.0, 1.0),
    *,
    count: int = 9,
    inliers: int | None = None,
    **values: Any,
) -> PairRow:
    """The row of a pair of two names, or letters, with the parts of a pose that its status has.

    inliers: of `count` matches, by default all of a pose. values: further ones of the pose.
    """
    has_R = status in ("ok", "planar", "rotation_only")
    if inliers is None:
        inliers = count if has_R else 0
    pose = RelativePose(
        status=status,
        reason="a pose",
        inliers=np.arange(count) < inliers,
        num_matches=count,
        R=R if has_R else None,
        t=np.asarray(t) / np.linalg.norm(t) if status in ("ok", "planar") else None,
        **values,
    )
    return row_of((names[0], names[1]), pose, 0.5)


def exif_camera(identity: str | None = "x") -> Camera:
    """Of 100 x 80 pixels, by EXIF data."""
    return Camera(
        np.array([110.0, 110, 49.5, 39.5]),
        (100, 80),
        focal_std=0.4,
        centre_std=5.0,
        lens_std=0.1,
        focal_source="exif",
        identity=identity,
    )


def camera() -> Camera:
    """Of all views of `worlds`."""
    return Camera(K, SIZE)
