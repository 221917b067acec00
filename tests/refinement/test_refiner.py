"""The refiner as a whole: as exact as the images allow, and never worse than what it was given."""

from collections.abc import Sequence

import dense_scene
import numpy as np
import pytest
import torch

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.two_views import TwoViews
from dgc_pose.errors import InputError
from dgc_pose.estimation import estimate_pose
from dgc_pose.images.image import Image
from dgc_pose.matchers import MatcherOptions, refined
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap, Matcher, MatchingOptions, MatchResult
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.refinement import (
    AlignmentOptions,
    FeatureOptions,
    RefinementOptions,
    Refiner,
)
from dgc_pose.refinement.features import FeatureMatches
from dgc_pose.refinement.refiner import MapMatches
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


def _noisy() -> dense_scene.MapMatcher:
    """A matcher whose map has an error of half a cell."""
    return dense_scene.MapMatcher(dense_scene.true_map(error_px=0.7), _OPTIONS)


def _errors(matches: Matches) -> np.ndarray:
    truth = dense_scene.points_in_image1(matches.points2)
    return np.linalg.norm(matches.points1 - truth, axis=1)


class _GivenPoints(Matcher):
    """Key points without a map."""

    name = "points"

    def __init__(self, matches: Matches) -> None:
        self.matches = matches

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        return MatchResult(self.matches, None)


def test_matches_become_ten_times_as_exact_and_so_does_the_pose(
    images: tuple[Image, Image],
) -> None:
    matcher = _noisy()
    result = Refiner(matcher).match(*images)
    given = matcher.match(*images).matches
    assert np.median(_errors(given)) > 0.5
    assert len(result.matches) > 150 and np.median(_errors(result.matches)) < 0.1
    assert result.correspondence_map is matcher.correspondence_map
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    errors = []
    for matches in (given, result.matches):
        pose = estimate_pose(matches, camera, camera)
        assert pose.R is not None and pose.t is not None
        errors.append(
            rotation_error_deg(pose.R, dense_scene.R) + translation_error_deg(pose.t, dense_scene.T)
        )
    assert errors[1] < 0.5 * errors[0]


def test_a_batch_gives_what_its_pairs_give_alone(images: tuple[Image, Image]) -> None:
    refiner = Refiner(_noisy())
    alone = [refiner.match(*pair) for pair in (images, images[::-1])]
    for one, other in zip(alone, refiner.match_batch([images, images[::-1]]), strict=True):
        assert np.array_equal(one.matches.points1, other.matches.points1)


def test_without_a_map_the_matcher_s_own_matches_are_aligned(
    images: tuple[Image, Image], engine: TorchEngine
) -> None:
    """Sources that need a map are passed over, and the matches stay those of key points."""
    rng = np.random.default_rng(0)
    points2 = rng.uniform((60, 40), (260, 200), (400, 2))
    points1 = dense_scene.points_in_image1(points2) + rng.normal(0, 0.5, points2.shape)
    given = Matches(points1, points2, np.ones(400), 1.0, key_points=True)
    result = Refiner(_GivenPoints(given), [FeatureMatches(engine)]).match(*images)
    assert result.correspondence_map is None and result.matches.key_points
    assert len(result.matches) > 150 and np.median(_errors(result.matches)) < 0.1

    sift = SiftMatcher().match(*images).matches
    aligned = Refiner(SiftMatcher()).match(*images).matches
    assert np.median(_errors(aligned)) < np.median(_errors(sift)) < 0.5


def test_without_alignment_the_error_is_the_source_s_own(images: tuple[Image, Image]) -> None:
    matcher = _noisy()
    options = AlignmentOptions(align=False)
    kept = Refiner(matcher, [MapMatches()], options, 200).match(*images).matches
    given = matcher.match(*images).matches
    assert kept.error_px == given.error_px and 100 < len(kept) <= 200
    rows = {tuple(row) for row in np.hstack([given.points1, given.points2])}
    assert all(tuple(row) in rows for row in np.hstack([kept.points1, kept.points2]))


def test_a_scene_that_cannot_be_refined_is_no_worse(images: tuple[Image, Image]) -> None:
    """Inconsistent matches are returned as they were; those that are consistent but cannot be
    aligned are returned with the error that they had."""
    matcher = dense_scene.MapMatcher(dense_scene.noise_map(), _OPTIONS)
    given = matcher.match(*images)
    assert Refiner(matcher).refine(*images, given) is given

    other = Image(dense_scene.pictures(seed=9)[0])
    kept = Refiner(_noisy()).match(other, images[1]).matches
    assert kept.error_px == _noisy().match(*images).matches.error_px and len(kept) > 1000


@pytest.mark.parametrize("found_by_features", [0, 400])
def test_auto_takes_the_map_only_if_the_features_give_too_few(
    images: tuple[Image, Image],
    engine: TorchEngine,
    found_by_features: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(0)
    points2 = rng.uniform((60, 40), (260, 200), (found_by_features, 2))
    points1 = dense_scene.points_in_image1(points2) + rng.normal(0, 0.5, points2.shape)

    def find(*arguments: object, **options: object) -> Matches:
        return Matches(points1, points2, np.ones(len(points1)), 1.0)

    monkeypatch.setattr("dgc_pose.refinement.features.FeatureMatches.find", find)
    matcher = _noisy()
    matcher.engine = engine
    by_auto, by_map = (
        refined(matcher, MatcherOptions(refinement=RefinementOptions(source=source)))
        .match(*images)
        .matches  # type: ignore[arg-type]
        for source in ("auto", "map")
    )
    assert np.array_equal(by_auto.points1, by_map.points1) == (found_by_features == 0)
    assert by_auto.error_px == 0.5 and len(by_auto) > 150


def test_few_aligned_matches_are_completed(images: tuple[Image, Image]) -> None:
    """Patches that differ too much stay where they were found, with the error that they had."""
    matcher = _noisy()
    aligned, completed, as_found = (
        Refiner(matcher, options=options).match(*images).matches
        for options in (
            AlignmentOptions(),
            AlignmentOptions(min_zncc=0.97, min_aligned=2000),
            AlignmentOptions(align=False),
        )
    )
    assert aligned.error_px == 0.5
    assert completed.error_px == as_found.error_px > 0.5
    assert len(completed) > len(aligned) - 50
    moved = _errors(completed) < 0.1
    assert 0.02 < moved.mean() and np.median(_errors(completed)) < np.median(_errors(as_found))


def _points(x: tuple[int, int], y: tuple[int, int], count: int, seed: int) -> Matches:
    """Random true matches with x and y in image 2 between limits, off by half a pixel."""
    rng = np.random.default_rng(seed)
    points2 = rng.uniform((x[0], y[0]), (x[1], y[1]), (count, 2))
    points1 = dense_scene.points_in_image1(points2) + rng.normal(0, 0.5, points2.shape)
    return Matches(points1, points2, np.ones(count), 1.0)


_RIGHT = [_points((170, 260), y, 150, seed) for seed, y in ((1, (40, 110)), (2, (130, 200)))]


class _Parts(MapMatches):
    """First the matches on the left; of squeezed images, and near the lines of two hypotheses,
    those on the right, above and below."""

    def find(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap, matches: Matches
    ) -> Matches:
        return _points((60, 150), (40, 200), 250, 0)

    def find_near(
        self,
        image1: Image,
        image2: Image,
        correspondence_map: CorrespondenceMap,
        hypotheses: Sequence[TwoViews],
    ) -> list[Matches]:
        return _RIGHT[: len(hypotheses)]

    def find_squeezed(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap
    ) -> list[Matches]:
        return _RIGHT


_CAMERA = Camera(dense_scene.K, dense_scene.SIZE)
_HYPOTHESES = 2 * [TwoViews(_CAMERA, _CAMERA, dense_scene.R, dense_scene.T)]


def _rows(matches: Matches) -> set[tuple[float, ...]]:
    return {tuple(row) for row in np.hstack([matches.points1, matches.points2])}


@pytest.mark.parametrize("squeezed", [False, True])
@pytest.mark.parametrize("min_aligned", [100, 10_000])
def test_matches_of_a_search_join_the_first(
    images: tuple[Image, Image], min_aligned: int, squeezed: bool
) -> None:
    """Those that are aligned, if they are enough; else all that agree with their neighbours."""
    options = AlignmentOptions(min_aligned=min_aligned)
    refiner = Refiner(_noisy(), [_Parts()], options)
    first = refiner.match(*images)
    more = refiner.match_near(*images, first, _HYPOTHESES)
    if squeezed:
        more = refiner.match_squeezed(*images, first)
    assert more.correspondence_map is first.correspondence_map
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
    above = refiner.match_near(*images, first, _HYPOTHESES[:1])
    assert len(first.matches) < len(above.matches) < len(more.matches)


def test_a_result_that_cannot_be_searched_is_returned_itself(
    images: tuple[Image, Image], engine: TorchEngine
) -> None:
    matcher = _noisy()
    plain = matcher.match(*images)
    assert plain.aligned is None
    assert matcher.match_near(*images, plain, _HYPOTHESES) is plain
    assert matcher.match_squeezed(*images, plain) is plain
    by_map = Refiner(matcher)
    refined = by_map.match(*images)
    assert by_map.match_near(*images, refined, _HYPOTHESES) is refined
    assert by_map.match_squeezed(*images, refined) is refined
    searching = Refiner(matcher, [_Parts()])
    assert searching.match_near(*images, plain, _HYPOTHESES) is plain  # not refined
    options = FeatureOptions(hypotheses=0, squeezed=False)
    none = Refiner(matcher, [FeatureMatches(engine, options)])
    assert none.match_near(*images, refined, _HYPOTHESES) is refined
    assert none.match_squeezed(*images, refined) is refined


def test_features_of_an_untrained_network_match_a_picture_with_itself(engine: TorchEngine) -> None:
    first = Image(dense_scene.pictures()[0])
    grid = dense_scene.grid(dense_scene.CELLS, dense_scene.CELLS)
    matcher = dense_scene.MapMatcher(dense_scene.make_map(grid + 6, grid), _OPTIONS)
    found = Refiner(matcher, [FeatureMatches(engine)]).match(first, first).matches
    off = np.abs(found.points1 - found.points2).max(1)
    assert len(found) > 200 and np.median(off) < 0.1 and off.max() < 2
    assert found.error_px == 0.5


@pytest.mark.parametrize(
    "options, name, value",
    [
        (RefinementOptions, "source", "nothing"),
        (FeatureOptions, "long_side", 16),
        (AlignmentOptions, "min_zncc", 0.0),
    ],
)
def test_options_out_of_range_are_named(options: type, name: str, value: object) -> None:
    with pytest.raises(InputError, match=name):
        options(**{name: value})
