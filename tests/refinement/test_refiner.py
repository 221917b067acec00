"""The refiner as a whole: exact where it can be, and never less than it was given."""

from __future__ import annotations

import dense_scene
import numpy as np
import pytest
import torch

from dgc_pose.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import estimate_pose
from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchingOptions
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.refinement import RefinementOptions, Refiner
from dgc_pose.refinement.native import native_cache

_OPTIONS = MatchingOptions(max_matches=1500)


@pytest.fixture(scope="module")
def images() -> tuple[Image, Image]:
    first, second = dense_scene.pictures()
    return Image(first), Image(second)


def _dense() -> dense_scene.MapMatcher:
    """A matcher whose map is off by half a cell, with an untrained network for its features."""
    matcher = dense_scene.MapMatcher(dense_scene.true_map(error_px=0.7), _OPTIONS)
    torch.manual_seed(0)
    matcher.net = DGCNet(preset("dgcm-lite")).eval().requires_grad_(False)
    return matcher


def _off(matches: Matches) -> np.ndarray:
    truth = dense_scene.places_in_image1(matches.points2)
    return np.linalg.norm(matches.points1 - truth, axis=1)


@pytest.mark.parametrize("source", ["map", "flow", "sift"])
def test_matches_become_ten_times_as_exact_and_so_does_the_pose(
    images: tuple[Image, Image], source: str
) -> None:
    dense = _dense()
    refined = Refiner(dense, RefinementOptions(source=source)).match(*images)  # type: ignore[arg-type]
    given = dense.match(*images)
    assert np.median(_off(given)) > 0.5
    assert len(refined) > 150 and np.median(_off(refined)) < 0.1
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    errors = []
    for matches in (given, refined):
        pose = estimate_pose(matches, camera, camera)
        assert pose.R is not None and pose.t is not None
        errors.append(
            rotation_error_deg(pose.R, dense_scene.R) + translation_error_deg(pose.t, dense_scene.T)
        )
    assert errors[1] < 0.5 * errors[0]


def test_without_alignment_the_error_is_the_source_s_own(images: tuple[Image, Image]) -> None:
    dense = _dense()
    options = RefinementOptions(source="map", align=False, max_matches=200)
    kept = Refiner(dense, options).match(*images)
    given = dense.match(*images)
    assert kept.error_px == given.error_px and 100 < len(kept) <= 200
    rows = {tuple(row) for row in np.hstack([given.points1, given.points2])}
    assert all(tuple(row) in rows for row in np.hstack([kept.points1, kept.points2]))


def test_a_scene_that_cannot_be_held_on_to_is_no_worse(images: tuple[Image, Image]) -> None:
    """Matches that agree with nothing come back as they were; those that agree but do not look
    alike come back consistent, with the error that they had."""
    dense = dense_scene.MapMatcher(dense_scene.noise_map(), _OPTIONS)
    correspondences = dense.correspond(*images)
    given = dense.select(correspondences)
    refiner = Refiner(dense, RefinementOptions(source="map"))
    assert refiner.refine(*images, correspondences, given) is given

    dense = _dense()
    other = Image(dense_scene.pictures(seed=9)[0])
    kept = Refiner(dense, RefinementOptions(source="map")).match(other, images[1])
    assert kept.error_px == dense.match(*images).error_px and len(kept) > 1000


@pytest.mark.parametrize("found_by_features", [0, 400])
def test_auto_takes_the_map_only_where_the_features_leave_too_few(
    images: tuple[Image, Image], found_by_features: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    points2 = rng.uniform((60, 40), (260, 200), (found_by_features, 2))
    points1 = dense_scene.places_in_image1(points2) + rng.normal(0, 0.5, points2.shape)

    def match_features(*arguments: object, **options: object) -> Matches:
        return Matches(points1, points2, np.ones(len(points1)), 1.0)

    monkeypatch.setattr("dgc_pose.refinement.refine.match_features", match_features)
    found = Refiner(_dense(), RefinementOptions(source="auto")).match(*images)
    by_map = Refiner(_dense(), RefinementOptions(source="map")).match(*images)
    assert np.array_equal(found.points1, by_map.points1) == (found_by_features == 0)
    assert found.error_px == 0.5 and len(found) > 150


@pytest.mark.parametrize(
    "sure, shown, true, tried",
    [
        (0.9, 1.1, 3.0, [1.0]),
        (0.9, 2.2, 3.0, [2.0]),
        (0.1, 1.1, 3.0, [1.0, 1 / 3, 3.0]),
        (0.1, 2.2, 3.0, [2.0, 1.0, 1 / 3, 3.0]),
        (0.1, 2.2, 1.0, [2.0, 1.0]),
        (0.1, 2.2, 2.0, [2.0, 1.0]),
    ],
)
def test_other_zooms_are_tried_where_the_map_is_weak(
    images: tuple[Image, Image],
    sure: float,
    shown: float,
    true: float,
    tried: list[float],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The images' own always, the others where few of the matches agree; the best is kept."""
    rng = np.random.default_rng(0)
    points2 = rng.uniform((60, 40), (260, 200), (400, 2))
    zooms: list[object] = []

    def match_features(*arguments: object, zoom: float, **options: object) -> Matches:
        zooms.append(zoom)
        points1 = dense_scene.places_in_image1(points2)
        if zoom != true:
            points1 = rng.permutation(points1)
        return Matches(points1, points2, np.ones(400), 1.0)

    monkeypatch.setattr("dgc_pose.refinement.refine.match_features", match_features)
    monkeypatch.setattr("dgc_pose.refinement.refine.zoom_between", lambda found: shown)
    dense = _dense()
    dense.correspondences.matchability[:] = sure
    found = Refiner(dense, RefinementOptions(source="features")).match(*images)
    assert zooms == pytest.approx(tried)
    assert (np.median(_off(found)) < 0.1) == (true in tried)


def test_a_cache_spares_native_passes_and_changes_nothing(images: tuple[Image, Image]) -> None:
    cache = native_cache()
    options = RefinementOptions(source="features")
    plain, cached = Refiner(_dense(), options), Refiner(_dense(), options, cache)
    for pair in (images, images[::-1]):
        expected, found = plain.match(*pair), cached.match(*pair)
        assert np.array_equal(found.points1, expected.points1)
    assert cache.made < cache.asked


def test_features_of_an_untrained_network_hold_on_to_the_same_picture() -> None:
    first = Image(dense_scene.pictures()[0])
    grid = dense_scene.grid(dense_scene.CELLS, dense_scene.CELLS)
    dense = _dense()
    dense.correspondences = dense_scene.make_map(grid + 6, grid)
    found = Refiner(dense, RefinementOptions(source="features")).match(first, first)
    off = np.abs(found.points1 - found.points2).max(1)
    assert len(found) > 200 and np.median(off) < 0.1 and off.max() < 2
    assert found.error_px == 0.5


@pytest.mark.parametrize(
    "name, value",
    [
        ("source", "nothing"),
        ("long_side", 16),
        ("candidates", 0),
        ("tiles", 0),
        ("window_cells", 0.0),
        ("sift_ratio", 1.5),
        ("min_zncc", 0.0),
        ("neighbours", 3),
        ("patch_radius", 1),
        ("max_matches", 0),
        ("min_matches", 0),
        ("back_px", 0.0),
    ],
)
def test_options_out_of_range_are_named(name: str, value: object) -> None:
    with pytest.raises(InputError, match=name):
        RefinementOptions(**{name: value})  # type: ignore[arg-type]
