"""Key points that pairs share: tracks, errors, one-to-one matches."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from colmap_scene import cloud_pairs, true_row
from multi_view import render_views
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from dgc_pose.batch.poses import epipolar_error_px
from dgc_pose.colmap.shared import SharedMatches, one_to_one


def _tracks(shared: SharedMatches) -> dict[int, int]:
    tracks: dict[int, int] = shared.facts()["tracks_by_length"]
    return tracks


def test_track_lengths_count_images() -> None:
    """a0-b0-c0 has three images; a1-b1 two; a2-b2-a3 two, though three points."""
    points = {name: np.zeros((4, 2)) for name in "abc"}
    pairs = {
        ("a", "b"): np.array([[0, 0], [1, 1], [2, 2], [3, 2]], np.uint32),
        ("b", "c"): np.array([[0, 0]], np.uint32),
    }
    assert _tracks(SharedMatches(points, pairs)) == {2: 2, 3: 1}
    assert _tracks(SharedMatches({}, {})) == {}


@pytest.mark.parametrize("edges", [5, 60, 400])
def test_track_lengths_are_the_sizes_of_the_components(edges: int) -> None:
    """Of random graphs, each key point in an image of its own; against SciPy."""
    ends = np.random.default_rng(edges).integers(0, 100, (edges, 2))
    points = {str(k): np.zeros((1, 2)) for k in range(100)}
    pairs = {(str(a), str(b)): np.zeros((1, 2), np.uint32) for a, b in ends.tolist()}
    graph = coo_matrix((np.ones(edges), ends.T), (100, 100))
    sizes = np.bincount(connected_components(graph, directed=False)[1])
    assert _tracks(SharedMatches(points, pairs)) == Counter(sizes[sizes > 1].tolist())


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
