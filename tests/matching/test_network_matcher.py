"""The refined matches of a network: as exact as the images allow, and never worse than given."""

from dataclasses import replace
from typing import Any, Literal

import dense_scene
import numpy as np
import pytest
import torch

from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.estimation import estimate_pose
from dgc_pose.images.image import Image, flipped
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchingOptions, NetworkMatcher, network_matcher
from dgc_pose.matching.correspondence_map import CorrespondenceMap
from dgc_pose.matching.dense import dense_map
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.runtime.torch_engine import TorchEngine

_OPTIONS = MatchingOptions(max_matches=1500)


@pytest.fixture(scope="module")
def images() -> tuple[Image, Image]:
    first, second = dense_scene.pictures()
    return Image(first), Image(second)


@pytest.fixture(scope="module")
def engine() -> TorchEngine:
    torch.manual_seed(0)
    return TorchEngine(DGCNet(preset("dgcm-lite0")))


def _noisy(
    aligned: Literal["none", "auto", "map", "features"] = "none", engine: TorchEngine | None = None
) -> dense_scene.MapMatcher:
    """A matcher whose map has an error of half a cell."""
    options = replace(_OPTIONS, aligned=aligned)
    return dense_scene.MapMatcher(dense_scene.true_map(error_px=0.7), options, engine)


def _errors(matches: Matches) -> np.ndarray:
    truth = dense_scene.points_in_image1(matches.points2)
    return np.linalg.norm(matches.points1 - truth, axis=1)


def test_matches_become_ten_times_as_exact_and_so_does_the_pose(
    images: tuple[Image, Image],
) -> None:
    matcher = _noisy()
    result = _noisy("map").match(*images)
    given = matcher.match(*images).matches
    assert np.median(_errors(given)) > 0.5
    assert len(result.matches) > 150 and np.median(_errors(result.matches)) < 0.1
    assert result.correspondence_map is not None
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    errors = []
    for matches in (given, result.matches):
        pose = estimate_pose(matches, camera, camera)
        assert pose.R is not None and pose.t is not None
        errors.append(
            rotation_error_deg(pose.R, dense_scene.R) + translation_error_deg(pose.t, dense_scene.T)
        )
    assert errors[1] < 0.5 * errors[0]


def test_a_scene_that_cannot_be_refined_is_no_worse(images: tuple[Image, Image]) -> None:
    """Inconsistent matches are returned as they were; those that are consistent but cannot be
    aligned are returned with the error that they had."""
    plain, refined = (
        dense_scene.MapMatcher(dense_scene.noise_map(), options).match(*images)
        for options in (replace(_OPTIONS, aligned="none"), replace(_OPTIONS, aligned="map"))
    )
    assert refined.aligned is None and _rows(refined.matches) == _rows(plain.matches)

    other = Image(dense_scene.pictures(seed=9)[0])
    kept = _noisy("map").match(other, images[1]).matches
    assert kept.error_px == _noisy().match(*images).matches.error_px and len(kept) > 1000


@pytest.mark.parametrize("count", [0, 400])
def test_auto_takes_the_map_only_if_the_features_give_too_few(
    images: tuple[Image, Image], engine: TorchEngine, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = _points((60, 260), (40, 200), count, 0)
    monkeypatch.setattr(network_matcher, "feature_matches", lambda *arguments: points)
    by_auto, by_map = (_noisy(way, engine).match(*images).matches for way in ("auto", "map"))
    assert np.array_equal(by_auto.points1, by_map.points1) == (count == 0)
    assert by_auto.error_px == 0.5 and len(by_auto) > 150


def _points(x: tuple[int, int], y: tuple[int, int], count: int, seed: int) -> Matches:
    """Random true matches with x and y in image 2 between limits, off by half a pixel."""
    rng = np.random.default_rng(seed)
    points2 = rng.uniform((x[0], y[0]), (x[1], y[1]), (count, 2))
    points1 = dense_scene.points_in_image1(points2) + rng.normal(0, 0.5, points2.shape)
    return Matches(points1, points2, np.ones(count), 1.0)


_RIGHT = [_points((170, 260), y, 150, seed) for seed, y in ((1, (40, 110)), (2, (130, 200)))]


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Features that match first on the left, and then on the right, above and, with a second
    hypothesis, below."""
    left = _points((60, 150), (40, 200), 250, 0)
    monkeypatch.setattr(network_matcher, "feature_matches", lambda *arguments: left)
    monkeypatch.setattr(
        network_matcher, "guided_matches", lambda *arguments: _RIGHT[: len(arguments[-1])]
    )


_CAMERA = Camera(dense_scene.K, dense_scene.SIZE)
_HYPOTHESES = 2 * [TwoViews(_CAMERA, _CAMERA, dense_scene.R, dense_scene.T)]


def _rows(matches: Matches) -> set[tuple[float, ...]]:
    return {tuple(row) for row in np.hstack([matches.points1, matches.points2])}


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize("min_aligned", [100, 10_000])
def test_guided_matches_join_the_first(
    images: tuple[Image, Image],
    engine: TorchEngine,
    monkeypatch: pytest.MonkeyPatch,
    min_aligned: int,
) -> None:
    """Those that are aligned, if they are enough; else all that agree with their neighbours."""
    monkeypatch.setattr(network_matcher, "MIN_ALIGNED", min_aligned)
    matcher = _noisy("features", engine)
    first = matcher.match(*images)
    more = matcher.guided(*images, first, _HYPOTHESES)
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
    above = matcher.guided(*images, first, _HYPOTHESES[:1])
    assert above is not None
    assert len(first.matches) < len(above.matches) < len(more.matches)


def test_without_features_there_is_no_coarse_pass_and_no_more_matches(
    images: tuple[Image, Image],
) -> None:
    for aligned in ("none", "map"):
        matcher = _noisy(aligned)
        assert matcher.coarse(*images) is None
        assert matcher.guided(*images, matcher.match(*images), _HYPOTHESES) is None


def test_a_coarse_pass_ends_at_a_weak_map_of_30_cells_if_the_next_would_go_on_from_it(
    images: tuple[Image, Image], engine: TorchEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells: list[int] = []

    def recorded(*arguments: Any, **options: Any) -> CorrespondenceMap:
        cells.append(options["cells"])
        return dense_map(*arguments, **options)

    monkeypatch.setattr(network_matcher, "dense_map", recorded)
    first, upside_down = images[0], flipped(images[1], 0)
    matcher = load_matcher()
    assert matcher.coarse(*images) is not None and cells == [30, 60]
    assert matcher.coarse(first, upside_down) is None and cells == [30, 60, 30]
    NetworkMatcher(engine).coarse(*images)
    assert cells[3:] == [60]
