"""The result of a pair that two poses explain."""

from dataclasses import replace

import numpy as np
from good_evidence import GOOD_EVIDENCE
from scipy.spatial.transform import Rotation

from dgc_pose.estimation import Hypothesis, RelativePose

PROBABILITIES = 0.52, 0.45
INLIERS = 271, 270


def ambiguous_pose(count: int = 300) -> RelativePose:
    """Of so many matches."""
    rotations = Rotation.from_rotvec([[0.0, 0.5, 0.0], [0.1, -0.3, 0.0]]).as_matrix()
    directions = np.array([[0.6, 0.0, 0.8], [-0.8, 0.6, 0.0]])
    every = np.ones(count, dtype=bool)
    return RelativePose(
        status="ambiguous",
        reason="two poses explain the matches, with probabilities of 52 % and 45 %",
        inliers=np.arange(count) < INLIERS[0],
        num_matches=count,
        evidence=replace(GOOD_EVIDENCE, num_inliers=INLIERS[0], inlier_ratio=INLIERS[0] / count),
        any_probability=sum(PROBABILITIES),
        alternatives=tuple(
            Hypothesis(R, t, np.arange(count) < inliers, every, probability=probability)
            for R, t, inliers, probability in zip(
                rotations, directions, INLIERS, PROBABILITIES, strict=True
            )
        ),
    )
