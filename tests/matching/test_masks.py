"""No match on a masked pixel, in any step of any matcher."""

from dataclasses import replace

import cv2
import dense_scene
import numpy as np
import pytest

from dgc_pose import load_matcher
from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.images.image import Image, masked
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchResult, NetworkMatcher, network_matcher

SIDE = 4 * np.array(dense_scene.SIZE)  # more than textures are computed on
CAMERA = Camera(dense_scene.K, dense_scene.SIZE)


def _on_masked(points: np.ndarray, image: Image) -> np.ndarray:
    """By a look at the mask, point by point."""
    assert image.mask is not None
    return np.array([not image.mask[int(y + 0.5), int(x + 0.5)] for x, y in points], bool)


def _assert_none_masked(matches: Matches, image1: Image, image2: Image) -> None:
    assert not _on_masked(matches.points1, image1).any()
    assert not _on_masked(matches.points2, image2).any()


def _bars(seed: int, size: np.ndarray) -> np.ndarray:
    """Bars of random widths, which cover some 40 per cent."""
    edges = np.cumsum(np.random.default_rng(seed).integers(9, 60, size[0]))
    return np.broadcast_to(np.searchsorted(edges, np.arange(size[0])) % 5 > 1, size[::-1]).copy()


PLAIN = dense_scene.images()
IMAGES = [
    masked(image, _bars(seed, np.array(dense_scene.SIZE))) for seed, image in enumerate(PLAIN)
]


def test_every_pixel_counts_on_images_of_any_size() -> None:
    """Every second pixel is masked, of a large image; the map's matches lie anywhere."""
    rng = np.random.default_rng(0)
    large = [Image(cv2.resize(pixels, SIDE)) for pixels in dense_scene.pictures()]
    both = [replace(image, mask=rng.random(SIDE[::-1]) < 0.5) for image in large]
    dense = dense_scene.true_map()
    dense = replace(dense, map=4 * dense.map, grid=4 * dense.grid, size1=tuple(SIDE))
    matcher = dense_scene.MapMatcher(replace(dense, size2=tuple(SIDE)))
    all_matches, matches = (matcher.match(*pair).matches for pair in (large, both))
    _assert_none_masked(matches, *both)
    kept = ~(_on_masked(all_matches.points1, both[0]) | _on_masked(all_matches.points2, both[1]))
    assert len(all_matches) > 1000 and 0.2 < kept.mean() < 0.3
    np.testing.assert_array_equal(matches.points2, all_matches.points2[kept])


def test_no_step_of_the_network_matches_masked_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of aligned matches, and where those that agree complete them."""
    hypotheses = [TwoViews(CAMERA, CAMERA, dense_scene.R, dense_scene.T)]
    matcher = load_matcher()
    assert isinstance(matcher, NetworkMatcher)
    steps = []
    for pair, min_aligned in ((IMAGES, 100), (IMAGES, 10_000), (PLAIN, 100)):
        monkeypatch.setattr(network_matcher, "MIN_ALIGNED", min_aligned)
        coarse, full = matcher.coarse(*pair), matcher.match(*pair)
        assert coarse is not None
        results = coarse, matcher.refined(*pair, coarse), full
        steps.append([*results, matcher.guided(*pair, full, hypotheses)])
    for *found, other in zip(*steps, strict=True):
        for result in found:
            assert result is not None
            _assert_none_masked(result.matches, *IMAGES)
            assert len(result.matches) > 50
        assert other is not None and _on_masked(other.matches.points2, IMAGES[1]).mean() > 0.2


def test_masked_cells_are_no_evidence() -> None:
    """A map that is wrong in masked areas alone speaks for the pose as the true one does."""
    both, true = (PLAIN[0], IMAGES[1]), dense_scene.true_map()
    hidden = _on_masked(true.grid.reshape(-1, 2), both[1]).reshape(true.matchability.shape)
    noise = np.random.default_rng(0).random(true.map.shape) * dense_scene.SIZE - 0.5
    wrong = replace(true, map=np.where(hidden[..., None], noise, true.map).astype(np.float32))
    matches, agreement = dense_scene.MapMatcher(true).match(*both).matches, []
    for dense in (wrong, wrong.masked(*both)):
        sample, options = MatchResult(matches, dense).map_matches, EstimationOptions(runs=1)
        pose = estimate_pose(matches, CAMERA, CAMERA, options, map_matches=sample)
        assert pose.evidence is not None
        agreement.append(pose.evidence.map_agreement)
    assert agreement[0] is not None and agreement[0] < 0.8
    assert agreement[1] == pytest.approx(1, abs=1e-6)
    dense = true.masked(*both)
    assert dense.used is not None and np.array_equal(dense.used, ~hidden)
    assert dense.mean_matchability == pytest.approx(true.matchability[~hidden].mean(), rel=1e-4)
    assert not dense.matchability[hidden].any() and true.masked(*PLAIN) is true
