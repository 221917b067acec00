"""Matches that agree with their neighbours, and patches aligned to a fraction of a pixel."""

from dataclasses import replace

import cv2
import dense_scene
import numpy as np
import pytest

from dgc_pose.images.image import resize
from dgc_pose.matches import Matches
from dgc_pose.matching.align import Aligned, align, locate, nearby_corners
from dgc_pose.matching.patches import LocalMatches, consistent


def _local(points2: np.ndarray, error: np.ndarray) -> LocalMatches:
    """The surface's own matches and affinities (by differences of 1 px), points off by `error`."""
    slopes = [
        dense_scene.points_in_image1(points2 + half) - dense_scene.points_in_image1(points2 - half)
        for half in ((0.5, 0.0), (0.0, 0.5))
    ]
    points1 = dense_scene.points_in_image1(points2) + error
    return LocalMatches(points1, points2, np.stack(slopes, -1), np.arange(len(points2)))


def _align(first: np.ndarray, second: np.ndarray, sigma: float = 1.0) -> Aligned:
    rng = np.random.default_rng(1)
    points2 = rng.uniform((60, 40), (260, 200), (400, 2))
    local = _local(points2, rng.normal(0, sigma, points2.shape))
    return align(first, second, local, error_px=1.2, max_matches=300)


def _off(found: Aligned) -> np.ndarray:
    truth = dense_scene.points_in_image1(found.points2)
    return np.linalg.norm(found.points1 - truth, axis=1)


@pytest.mark.parametrize("gain, offset", [(1.0, 0), (0.6, 40)])
def test_aligned_to_a_fraction_of_a_pixel_at_any_gain_and_offset(gain: float, offset: int) -> None:
    first, second = dense_scene.pictures()
    first = np.rint(first * gain + offset).astype(np.uint8)
    found = _align(first, second)
    good = found.converged & (found.zncc > 0.8)
    assert good.mean() > 0.9
    assert np.median(_off(found)[good]) < 0.08
    assert (_off(found)[good] < 0.5).mean() > 0.97


def test_corners_are_those_of_the_whole_image() -> None:
    """Over several strips, at the image's edges and beyond them."""
    rng = np.random.default_rng(2)
    grey = rng.uniform(0, 255, (600, 90)).astype(np.float32)
    whole = cv2.cornerMinEigenVal(grey, 7)
    points = rng.uniform((-9, -9), (99, 609), (500, 2))
    corners, strength = nearby_corners(grey, points)
    for point, corner, value in zip(np.rint(points).astype(int), corners, strength, strict=True):
        x, y = ((point[k] + np.arange(-4, 5)).clip(0, grey.shape[1 - k] - 1) for k in (0, 1))
        assert value == whole[np.ix_(y, x)].max() == whole[int(corner[1]), int(corner[0])]
        assert corner[0] in x and corner[1] in y
    no_corners, no_strength = nearby_corners(grey, points[:0])
    assert no_corners.shape == (0, 2) and no_strength.shape == (0,)


def test_other_pictures_and_flat_ones_do_not_align() -> None:
    first, second = dense_scene.pictures()
    other = dense_scene.pictures(seed=5)[0]
    flat = np.full_like(second, 90)
    for one, two in ((other, second), (flat, second), (first, flat), (flat, flat)):
        found = _align(one, two)
        assert (found.converged & (found.zncc > 0.8)).mean() < 0.02
        assert np.isfinite(found.points1).all()


def test_starts_far_off_are_aligned_from_shrunk_images() -> None:
    """Starts off by several pixels, affinities off by a fifth, as of views far apart."""
    first, second = dense_scene.pictures()
    rng = np.random.default_rng(1)
    points2 = rng.uniform((60, 40), (260, 200), (250, 2))
    local = _local(points2, rng.normal(0, 2.5, points2.shape))
    skewed = local.affinity @ (np.eye(2) + rng.normal(0, 0.2, (250, 2, 2)))
    local = LocalMatches(local.points1, local.points2, skewed, local.index)
    grey1, grey2 = (
        cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(np.float32) for pixels in (first, second)
    )
    shifted = locate(grey1, grey2, local, radius=7, max_shift=12.5)
    truth = dense_scene.points_in_image1(points2)
    near = np.linalg.norm(shifted.points1 - truth, axis=1) < 0.3
    before = shifted.converged & (shifted.zncc > 0.8) & near
    found = align(first, second, local, error_px=2.5, max_matches=300)
    good = found.converged & (found.zncc >= 0.8)
    assert (good & (_off(found) < 0.3)).sum() > 1.5 * before.sum()
    assert (_off(found)[good] < 0.5).mean() > 0.8


def test_an_image_at_three_times_the_size_is_shrunk_first() -> None:
    """The coordinates stay those of the originals, and the errors grow with their pixels."""
    first, second = dense_scene.pictures()
    rng = np.random.default_rng(1)
    local = _local(rng.uniform((60, 40), (260, 200), (400, 2)), rng.normal(0, 0.5, (400, 2)))
    enlarged = replace(local, points2=(local.points2 + 0.5) * 3 - 0.5, affinity=local.affinity / 3)
    large = resize(second, (960, 720))
    found = align(first, large, enlarged, error_px=1.2, max_matches=300)
    assert found.pixel == pytest.approx(2.0, rel=0.05)  # the mean of 1 and 3
    good = found.converged & (found.zncc > 0.8)
    truth = dense_scene.points_in_image1((found.points2 + 0.5) / 3 - 0.5)
    assert good.mean() > 0.8
    assert np.median(np.linalg.norm(found.points1 - truth, axis=1)[good]) < 0.1


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


def test_matches_of_no_surface_are_left_out_and_nothing_is_nan() -> None:
    """A mirror image, too few, one that is not finite among good ones, a line, one place."""
    matches, _ = _matches(200, wrong=0)
    points1, ones = matches.points1.copy(), np.ones(200)
    points1[7] = np.nan
    mirrored = Matches(matches.points2 * (-1, 1), matches.points2, ones, 0.5)
    few = Matches(points1[:12], matches.points2[:12], ones[:12], 0.5)
    for none in (mirrored, few):
        assert len(consistent(none, 12).index) == 0
    found = consistent(Matches(points1, matches.points2, ones, 0.5), 12)
    assert 7 not in found.index and len(found.index) > 180
    for points in (np.stack([np.arange(50.0), np.full(50, 3.0)], -1), np.full((50, 2), 8.0)):
        found = consistent(Matches(points + 5, points, np.ones(50), 0.5), 12)
        assert np.isfinite(found.affinity).all() and np.isfinite(found.points1).all()
