"""Key points that pairs share: tracks, errors, one-to-one matches."""

from dataclasses import replace

import numpy as np
from multi_view import render_views
from results import cloud_pairs, true_row

from dgc_pose.batch.poses import epipolar_error_px
from dgc_pose.colmap.shared import one_to_one


def test_one_to_one_keeps_the_best() -> None:
    index = np.array([[0, 0], [0, 1], [1, 1], [2, 2], [3, 2]])
    scores = np.array([0.5, 0.9, 0.8, 0.3, 0.4])
    assert one_to_one(index, scores).tolist() == [[0, 1], [3, 2]]
    assert one_to_one(index[:0], scores[:0]).shape == (0, 2)


def test_matches_far_from_the_pose_do_not_fit() -> None:
    views = render_views(2)
    (pair,) = cloud_pairs([(v.R, v.t) for v in views], count=50, noise_px=0)
    assert epipolar_error_px(pair.row, pair.cameras, pair.points1, pair.points2).max() < 1e-3
    moved = pair.points2 + (0, 3)
    assert epipolar_error_px(pair.row, pair.cameras, pair.points1, moved).min() > 1
    turned = replace(pair, row=true_row(pair.names, np.eye(3), np.zeros(3), "rotation_only"))
    assert (epipolar_error_px(turned.row, turned.cameras, pair.points1, moved) == 0).all()
