"""Matches that agree with their neighbours, and the affinity that they share."""

import numpy as np

from dgc_pose.matches import Matches
from dgc_pose.matching.patches import consistent

_AFFINITY = np.array([[0.9, -0.35], [0.2, 1.1]])


def _matches(count: int, wrong: int, seed: int = 0) -> tuple[Matches, np.ndarray]:
    """Matches of an affine surface with an error of 0.5 px, the first `wrong` of them random."""
    rng = np.random.default_rng(seed)
    points2 = rng.uniform(0, 400, (count, 2))
    points1 = points2 @ _AFFINITY.T + (30, -10) + rng.normal(0, 0.5, (count, 2))
    points1[:wrong] = rng.uniform(0, 400, (wrong, 2))
    return Matches(points1, points2, np.ones(count), error_px=0.5), np.arange(count) >= wrong


def test_wrong_matches_go_and_the_others_have_the_surface_s_affinity() -> None:
    matches, right = _matches(1500, wrong=300)
    found = consistent(matches, 12)
    kept = np.zeros(1500, bool)
    kept[found.index] = True
    assert kept[right].mean() > 0.94 and kept[~right].mean() < 0.02
    np.testing.assert_allclose(np.median(found.affinity, 0), _AFFINITY, atol=0.01)
    off = found.points1 - (found.points2 @ _AFFINITY.T + (30, -10))
    # The mean of some dozen matches is more exact than one alone.
    assert np.sqrt((off**2).mean()) < 0.45
    assert np.array_equal(found.points2, matches.points2[found.index])


def test_a_mirror_image_is_no_surface() -> None:
    matches, _ = _matches(300, wrong=0)
    mirrored = Matches(matches.points2 * (-1, 1), matches.points2, np.ones(300), 0.5)
    assert len(consistent(mirrored, 12).index) == 0


def test_few_matches_and_matches_that_are_not_finite() -> None:
    matches, _ = _matches(200, wrong=0)
    points1 = matches.points1.copy()
    points1[7] = np.nan
    found = consistent(Matches(points1, matches.points2, np.ones(200), 0.5), 12)
    assert 7 not in found.index and len(found.index) > 180
    few = Matches(points1[:12], matches.points2[:12], np.ones(12), 0.5)
    assert len(consistent(few, 12).index) == 0


def test_matches_on_a_line_or_in_one_place_do_not_break_it() -> None:
    line = np.stack([np.arange(50.0), np.full(50, 3.0)], -1)
    heap = np.full((50, 2), 8.0)
    for points in (line, heap):
        found = consistent(Matches(points + 5, points, np.ones(50), 0.5), 12)
        assert np.isfinite(found.affinity).all() and np.isfinite(found.points1).all()
