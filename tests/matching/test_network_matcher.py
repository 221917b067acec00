"""The refined matches of a network: as exact as the images allow, and never worse than given."""

from dataclasses import replace
from typing import Any

import dense_scene
import numpy as np
import pytest
import torch

from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.estimation import estimate_pose
from dgc_pose.images.image import Image, flipped
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import (
    CorrespondenceMap,
    Matcher,
    MatchingOptions,
    MatchResult,
    NetworkMatcher,
    features,
    network_matcher,
)
from dgc_pose.matching.dense import dense_map
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.runtime.torch_engine import TorchEngine

_OPTIONS = MatchingOptions(max_matches=1500)
_PLAIN = replace(_OPTIONS, aligned="none")
_NOISY = dense_scene.true_map(error_px=0.7)  # by half a cell
_CAMERA = Camera(dense_scene.K, dense_scene.SIZE)
IMAGES = dense_scene.images()
_HYPOTHESES = 2 * [TwoViews(_CAMERA, _CAMERA, dense_scene.R, dense_scene.T)]


def _errors(matches: Matches) -> np.ndarray:
    truth = dense_scene.points_in_image1(matches.points2)
    return np.linalg.norm(matches.points1 - truth, axis=1)


def _points(x: tuple[int, int], y: tuple[int, int], count: int, seed: int) -> Matches:
    """Random true matches with x and y in image 2 between limits, off by half a pixel."""
    rng = np.random.default_rng(seed)
    points2 = rng.uniform((x[0], y[0]), (x[1], y[1]), (count, 2))
    points1 = dense_scene.points_in_image1(points2) + rng.normal(0, 0.5, points2.shape)
    return Matches(points1, points2, np.ones(count), 1.0)


def _features(monkeypatch: pytest.MonkeyPatch, first: Matches, *more: Matches) -> None:
    """The matches of the features, and further ones of each hypothesis."""

    def found(engine: Any, cache: Any, dense: Any, views: Any, hypotheses: Any) -> list[Matches]:
        return [first] if hypotheses is None else [*more[: len(hypotheses)]]

    monkeypatch.setattr(network_matcher, "feature_matches", found)
    monkeypatch.setattr(features, "encode_each", lambda e, c, both: dict.fromkeys(both))
    monkeypatch.setattr(network_matcher, "context_ratio", lambda *arguments: None)


def _rows(matches: Matches) -> set[tuple[float, ...]]:
    return {tuple(row) for row in np.hstack([matches.points1, matches.points2])}


@pytest.mark.parametrize("count", [0, 400])
def test_the_features_matches_are_refined_and_the_maps_if_they_are_too_few(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """They become ten times as exact, and so does the pose."""
    _features(monkeypatch, _points((60, 260), (40, 200), count, 0))
    given = dense_scene.MapMatcher(_NOISY, _PLAIN).match(*IMAGES).matches
    result = dense_scene.MapMatcher(_NOISY, _OPTIONS).match(*IMAGES)
    assert np.median(_errors(given)) > 0.5
    assert len(result.matches) > 150 and np.median(_errors(result.matches)) < 0.1
    assert result.correspondence_map is _NOISY and result.matches.error_px == 0.5
    pose, before = (estimate_pose(m, _CAMERA, _CAMERA) for m in (result.matches, given))
    assert pose.R is not None and before.R is not None
    errors = [
        rotation_error_deg(of.R, dense_scene.R) + translation_error_deg(of.t, dense_scene.T)
        for of in (pose, before)
    ]
    assert errors[0] < 0.5 * errors[1]


def test_a_scene_that_cannot_be_refined_is_no_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inconsistent matches are returned as they were; those that are consistent but cannot be
    aligned are returned with the error that they had."""
    _features(monkeypatch, _points((60, 260), (40, 200), 0, 0))
    plain, refined = (
        dense_scene.MapMatcher(dense_scene.noise_map(), options).match(*IMAGES)
        for options in (_PLAIN, _OPTIONS)
    )
    assert refined.aligned is None and _rows(refined.matches) == _rows(plain.matches)
    other = Image(dense_scene.pictures(seed=9)[0])
    kept = dense_scene.MapMatcher(_NOISY, _OPTIONS).match(other, IMAGES[1]).matches
    assert kept.error_px == _NOISY.error_px and len(kept) > 1000


@pytest.mark.parametrize("min_aligned", [100, 10_000])
def test_guided_matches_join_the_first(monkeypatch: pytest.MonkeyPatch, min_aligned: int) -> None:
    """Those that are aligned, if they are enough; else all that agree with their neighbours. The
    first are on the left, and then there are some on the right, above and below."""
    left = _points((60, 150), (40, 200), 250, 0)
    right = [_points((170, 260), y, 150, seed) for seed, y in ((1, (40, 110)), (2, (130, 200)))]
    _features(monkeypatch, left, *right)
    monkeypatch.setattr(network_matcher, "MIN_ALIGNED", min_aligned)
    matcher = dense_scene.MapMatcher(_NOISY, _OPTIONS)
    first = matcher.match(*IMAGES)
    more = matcher.guided(*IMAGES, first, _HYPOTHESES)
    assert more is not None and more.correspondence_map is first.correspondence_map
    assert more.aligned is not None and first.aligned is not None
    x, y = more.matches.points2.T
    assert all(part.sum() > 30 for part in (x < 160, (x > 160) & (y < 120), (x > 160) & (y > 120)))
    aligned = min_aligned == 100
    assert (more.matches is more.aligned) == (first.matches is first.aligned) == aligned
    if aligned:
        assert more.matches.error_px == 0.5 and np.median(_errors(more.matches)) < 0.1
        assert _rows(first.matches) < _rows(more.matches)
    else:
        assert more.matches.error_px == 1.0 and len(more.matches) > 1.5 * len(first.matches)
        assert more.aligned.error_px == 0.5 and len(more.aligned) < len(more.matches)


class _OtherMatcher(Matcher):
    """In place of `LightGlueMatcher`: these key points."""

    def __init__(self, matches: Matches) -> None:
        self.matches = matches

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        return MatchResult(self.matches, None)


def _second(monkeypatch: pytest.MonkeyPatch, matches: Matches) -> None:
    other = _OtherMatcher(replace(matches, key_points=True))
    monkeypatch.setattr(network_matcher, "is_available", lambda: True)
    monkeypatch.setattr(network_matcher, "LightGlueMatcher", lambda cache: other)


@pytest.mark.parametrize("min_aligned", [100, 10_000])
def test_the_aligned_matches_of_a_second_matcher_join_the_first(
    monkeypatch: pytest.MonkeyPatch, min_aligned: int
) -> None:
    """Whether the first are aligned or only agree with their neighbours."""
    _features(monkeypatch, _points((60, 150), (40, 200), 250, 0))
    _second(monkeypatch, _points((170, 260), (40, 200), 250, 1))
    monkeypatch.setattr(network_matcher, "MIN_ALIGNED", min_aligned)
    matcher = dense_scene.MapMatcher(_NOISY, _OPTIONS)
    first = matcher.match(*IMAGES)
    more = matcher.second(*IMAGES, first)
    assert more is not None and more.correspondence_map is first.correspondence_map
    assert _rows(first.matches) < _rows(more.matches)
    added = more.matches.subset(more.matches.points2[:, 0] > 160)
    assert len(added) > 60 and np.median(_errors(added)) < 0.1
    assert more.matches.error_px == first.matches.error_px
    assert not more.matches.key_points and more.matches.weights == first.matches.weights


def test_a_second_matcher_answers_where_nothing_could_be_refined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its matches alone, then: those of the map have an error of several pixels."""
    _features(monkeypatch, _points((60, 260), (40, 200), 0, 0))
    _second(monkeypatch, _points((60, 260), (40, 200), 300, 1))
    matcher = dense_scene.MapMatcher(dense_scene.noise_map(), _OPTIONS)
    first = matcher.match(*IMAGES)
    more = matcher.second(*IMAGES, first)
    assert first.aligned is None and more is not None
    assert more.matches.error_px == 0.5 and np.median(_errors(more.matches)) < 0.1


def test_nothing_is_added_without_agreement_refinement_or_the_distribution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _features(monkeypatch, _points((60, 150), (40, 200), 250, 0))
    rng = np.random.default_rng(0)
    right = _points((60, 260), (40, 200), 300, 1)
    wrong = replace(right, points1=rng.permutation(right.points1))
    _second(monkeypatch, wrong)
    matcher = dense_scene.MapMatcher(_NOISY, _OPTIONS)
    first = matcher.match(*IMAGES)
    assert matcher.second(*IMAGES, first) is first
    _second(monkeypatch, right)
    plain = dense_scene.MapMatcher(_NOISY, _PLAIN)
    assert plain.second(*IMAGES, plain.match(*IMAGES)) is None
    monkeypatch.setattr(network_matcher, "is_available", lambda: False)
    without = dense_scene.MapMatcher(_NOISY, _OPTIONS)
    assert without.second(*IMAGES, without.match(*IMAGES)) is None
    assert without.second_matcher is None


def test_a_coarse_pass_ends_at_a_weak_map_of_30_cells_if_the_next_would_go_on_from_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cells: list[int] = []

    def recorded(*arguments: Any, **options: Any) -> CorrespondenceMap:
        cells.append(options["cells"])
        return dense_map(*arguments, **options)

    monkeypatch.setattr(network_matcher, "dense_map", recorded)
    first, upside_down = IMAGES[0], flipped(IMAGES[1], 0)
    matcher = load_matcher()
    assert matcher.coarse(*IMAGES) is not None and cells == [30, 60]
    assert matcher.coarse(first, upside_down) is None and cells == [30, 60, 30]
    cells.clear()
    assert matcher.coarse(first, Image(np.full_like(first.pixels, 90))) is None
    cells.clear()
    torch.manual_seed(0)
    NetworkMatcher(TorchEngine(DGCNet(preset("dgcm-lite0")))).coarse(*IMAGES)
    assert cells == [60]
