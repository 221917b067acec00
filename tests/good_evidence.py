"""What speaks for a pose that is right beyond doubt."""

from __future__ import annotations

import numpy as np

from dgc_pose.estimation.verdict import Evidence

GOOD_EVIDENCE = Evidence(
    inlier_ratio=0.6,
    chance_ratio=0.01,
    log10_false_alarms=-100.0,
    cheirality_ratio=0.95,
    rotation=np.eye(3),
    rotation_share=0.3,
    parallax=20.0,
    num_turned=100,
    still_share=0.2,
    median_angle_deg=8.0,
    homography_ratio=0.4,
    on_a_line=False,
    places=80,
    rotation_error_90_deg=0.5,
)
