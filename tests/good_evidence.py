"""Evidence of a pose that passes every gate."""

import numpy as np

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
    focal_check=None,
    residual=0.2,
    threshold_cells=0.05,
    confidence=0.95,
    other_ratio=0.3,
    map_matchability=0.5,
    map_agreement=0.9,
    map_chance=0.2,
)
