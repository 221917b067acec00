"""Corners located anew in each pair: positions, tracks, and matches that are wrong."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from results import camera, pair_row
from scenes import two_views
from scipy.spatial import cKDTree
from worlds import SIZE, render_views

from dgc_pose.batch.pairs import epipolar_error_px
from dgc_pose.colmap.tracking import PairGeometry, SharedMatches, one_to_one, track_corners
from dgc_pose.images.image import Image, masked


def _shared(
    noise_px: float, wrong: int = 0, masks: Mapping[str, np.ndarray] | None = None
) -> tuple[SharedMatches, list[PairGeometry]]:
    """Of four rendered views whose matches come from the true geometry of their back wall.

    masks: by the name of the image.
    """
    views = render_views(4)
    names = [f"view{i}.png" for i in range(4)]
    images = {
        name: masked(Image(v.pixels, name), (masks or {}).get(name))
        for name, v in zip(names, views, strict=True)
    }
    rng = np.random.default_rng(3)
    made = []
    for i, j in combinations(range(4), 2):
        view1, view2 = views[i], views[j]
        pose = view2.R @ view1.R.T, view2.t - view2.R @ view1.R.T @ view1.t
        wall = rng.uniform((-1.2, -1.4), (1.5, -0.5), (300, 2))
        points = np.column_stack([wall, np.full(300, 6.0)]) @ view1.R.T + view1.t
        cameras = camera(), camera()
        matches = two_views(points, cameras, pose, rng, everywhere=True).matches
        matches.points1[:] += noise_px * rng.standard_normal(matches.points1.shape)
        matches.points2[:wrong] += 30
        made.append(PairGeometry(pair_row((names[i], names[j]), "ok", *pose), cameras, matches))
    return track_corners(made, images.__getitem__, per_image=200), made


def test_corners_are_located_better_than_the_matches() -> None:
    """Matches with noise of 0.5 px give key points within a fraction of that, in tracks of all
    four views."""
    shared, pairs = _shared(0.5)
    errors = []
    for pair in pairs:
        index = shared.pairs[pair.row.names]
        assert len(index) > 50
        points = [shared.key_points[name][index[:, k]] for k, name in enumerate(pair.row.names)]
        errors.append(np.median(epipolar_error_px(pair.row, pair.cameras, *points)))
    assert np.mean(errors) < 0.05
    starts = shared.pairs[("view0.png", "view1.png")][:, 0]
    for name in ("view2.png", "view3.png"):
        starts = np.intersect1d(starts, shared.pairs[("view0.png", name)][:, 0])
    assert len(starts) > 100


def test_wrong_matches_give_no_key_points() -> None:
    """A third of the matches is moved by 30 px, and nothing near them is located there."""
    shared, pairs = _shared(0.2, wrong=100)
    for pair in pairs:
        index = shared.pairs[pair.row.names]
        first, second = (shared.key_points[n][index[:, k]] for k, n in enumerate(pair.row.names))
        right = cKDTree(pair.matches.points1[100:]).query(first)[1] + 100
        far = np.linalg.norm(second - pair.matches.points2[right], axis=1) > 15
        assert far.mean() < 0.02


def test_neither_corners_nor_their_locations_are_masked() -> None:
    """Every second pixel is, and there are matches everywhere."""
    rng = np.random.default_rng(0)
    masks = {f"view{i}.png": rng.random(SIZE[::-1]) < 0.5 for i in (0, 2)}
    (shared, _), (plain, _) = _shared(0.3, masks=masks), _shared(0.3)
    for name in masks:
        on_masked = []
        for points in (shared.key_points[name], plain.key_points[name]):
            x, y = np.floor(points + 0.5).astype(int).T
            on_masked.append((~masks[name][y, x]).mean())
        assert on_masked[0] == 0 and on_masked[1] > 0.4 and len(shared.key_points[name]) > 50


def test_one_to_one_keeps_the_best() -> None:
    index = np.array([[0, 0], [0, 1], [1, 1], [2, 2], [3, 2]])
    scores = np.array([0.5, 0.9, 0.8, 0.3, 0.4])
    assert one_to_one(index, scores).tolist() == [[0, 1], [3, 2]]
    assert one_to_one(index[:0], scores[:0]).shape == (0, 2)


def test_matches_far_from_the_pose_do_not_fit() -> None:
    pair = _shared(0.0)[1][0]
    points1, points2 = pair.matches.points1, pair.matches.points2
    assert epipolar_error_px(pair.row, pair.cameras, points1, points2).max() < 1e-3
    assert epipolar_error_px(pair.row, pair.cameras, points1, points2 + (0, 3)).min() > 1
    turned = pair_row(pair.row.names, "rotation_only")
    assert (epipolar_error_px(turned, pair.cameras, points1, points2 + (0, 3)) == 0).all()
