"""Matchers by name: what each name gives, and what the caches and fingerprints tell."""

import copy
import os
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import dense_scene
import numpy as np
import pytest
import torch

from dgc_pose import Camera, MatcherCaches, estimate_pose, load_dense_matcher, load_matcher
from dgc_pose.cameras.camera import TwoViews
from dgc_pose.errors import InputError, WeightsError
from dgc_pose.images.image import Image
from dgc_pose.matching import MatchingOptions
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.refinement import RefinementOptions, Refiner
from dgc_pose.training.run import save_weights


@pytest.fixture(scope="module")
def images() -> tuple[Image, Image]:
    first, second = dense_scene.pictures()
    return Image(first), Image(second)


def test_by_default_it_is_the_shipped_network_refined(images: tuple[Image, Image]) -> None:
    bare = load_matcher(refinement=None).match(*images)
    refined = load_matcher().match(*images)
    assert bare.correspondence_map is not None and refined.correspondence_map is not None
    assert np.array_equal(bare.correspondence_map.map, refined.correspondence_map.map)
    by_dense = load_dense_matcher().match(*images)
    assert np.array_equal(bare.matches.points1, by_dense.matches.points1)
    errors = [
        np.median(
            np.linalg.norm(found.points1 - dense_scene.points_in_image1(found.points2), axis=1)
        )
        for found in (bare.matches, refined.matches)
    ]
    assert errors[1] < 0.6 * errors[0] and errors[1] < 0.1


def test_matches_state_the_weights_of_the_network_that_made_them(
    images: tuple[Image, Image],
) -> None:
    """Those of each step, refined or not."""
    matcher, camera = load_matcher(), Camera(dense_scene.K, dense_scene.SIZE)
    search = matcher.search(*images)
    whole = search.whole()
    poses = estimate_pose(whole.matches, camera, camera).hypotheses
    views = [TwoViews(camera, camera, pose.R, pose.t) for pose in poses]
    steps = [whole, search.more(views), search.quick(), search.fine()]
    steps += [load_matcher(refinement=r).match(*images) for r in (None, RefinementOptions("map"))]
    assert all(step is not None and step.matches.weights == matcher.fingerprint for step in steps)
    others = load_matcher("dis"), Refiner(load_matcher("dis")), load_matcher("sift")
    assert [other.match(*images).matches.weights for other in others] == [None] * 3


@pytest.mark.parametrize("weights", ["shipped", None, "0123456789abcdef"])
def test_only_the_shipped_network_s_matches_have_a_probability(
    images: tuple[Image, Image], weights: str | None
) -> None:
    """It is fitted on them; without, the gates decide."""
    result, camera = load_matcher().match(*images), Camera(dense_scene.K, dense_scene.SIZE)
    matches = result.matches if weights == "shipped" else replace(result.matches, weights=weights)
    for map_matches in (result.map_matches, None):
        for one in (camera, replace(camera, focal_std=0.1)):
            pose = estimate_pose(matches, one, one, map_matches=map_matches)
            assert pose.success and (pose.probability is None) == (weights != "shipped")
            assert (pose.to_dict()["any_probability"] is None) == (weights != "shipped")
            assert ("not known" in repr(pose)) == (weights != "shipped")


def test_caches_keep_what_is_computed_of_an_image(images: tuple[Image, Image]) -> None:
    for name, used in (("sift", ["key_points"]), ("dgcm-lite0", ["features", "native"])):
        caches = MatcherCaches()
        matcher = load_matcher(name, caches=caches)
        for _ in range(2):
            found = matcher.match(*images)
        assert np.array_equal(
            found.matches.points1, load_matcher(name).match(*images).matches.points1
        )
        for field in ("features", "native", "key_points"):
            cache = getattr(caches, field)
            assert (cache.asked > cache.made > 0) if field in used else cache.asked == 0


@pytest.mark.parametrize(
    "options",
    [
        {"name": "sift"},
        {"name": "dis", "matching": MatchingOptions(max_matches=500)},
        {},
        {"refinement": None},
        {"runtime": "torch"},
        {"caches": MatcherCaches()},
    ],
)
def test_a_matcher_is_pickled_and_copied_without_what_it_keeps(
    images: tuple[Image, Image], options: dict[str, Any]
) -> None:
    matcher = load_matcher(**options)
    before = len(pickle.dumps(matcher))
    matches = matcher.match(*images).matches
    assert len(pickle.dumps(matcher)) == before
    for other in (pickle.loads(pickle.dumps(matcher)), copy.deepcopy(matcher), copy.copy(matcher)):
        assert other is not matcher and (other.cache is None or other.cache is not matcher.cache)
        again = other.match(*images).matches
        assert np.array_equal(again.points1, matches.points1)
        assert np.array_equal(again.points2, matches.points2)
        assert (other.name, other.fingerprint) == (matcher.name, matcher.fingerprint)


def test_key_points_of_the_last_three_images_are_kept(images: tuple[Image, Image]) -> None:
    matcher = load_matcher("sift")
    assert matcher.cache is not None
    for pair in (images, images[::-1], images):
        matcher.match(*pair)
    assert matcher.cache.made == 4  # key points and structure of each


def test_a_fingerprint_tells_weights_apart(tmp_path: Path) -> None:
    found = []
    for seed in (0, 1, 0):
        torch.manual_seed(seed)
        save_weights(DGCNet(preset("dgcm-lite0")), tmp_path / "w.safetensors")
        loaded = [load_matcher(tmp_path / "w.safetensors", refinement=None)]
        with os.scandir(tmp_path) as (entry,):  # which `open` takes, too
            loaded.append(load_matcher(entry))
        assert len({one.fingerprint for one in loaded}) == 1
        found.append(loaded[0].fingerprint)
    assert found[0] == found[2] != found[1] and len(found[0] or "") == 16


def test_other_names_are_paths_to_weights() -> None:
    with pytest.raises(WeightsError, match="nowhere.pth: no such weights"):
        load_matcher("nowhere.pth")
    with pytest.raises(
        InputError, match="nowhere: no such file, .*: there are dgcm-lite0, sift, dis, "
    ):
        load_matcher("nowhere")


def test_a_quick_pass_is_coarse_and_what_it_leads_to_is_fine(images: tuple[Image, Image]) -> None:
    search = load_matcher().search(*images)
    quick = search.quick()
    assert quick is not None and quick.correspondence_map is not None
    assert max(quick.correspondence_map.matchability.shape) < 75
    fine, whole = search.fine(), search.whole()
    assert fine is not None and fine.correspondence_map is quick.correspondence_map
    counts = [len(result.matches) for result in (quick, fine, whole)]
    assert 50 < counts[0] and counts[1] == pytest.approx(counts[2], rel=0.1)
    for result in (quick, fine):
        truth = dense_scene.points_in_image1(result.matches.points2)
        assert np.median(np.linalg.norm(result.matches.points1 - truth, axis=1)) < 0.15


def test_images_that_may_be_rotated_and_those_without_structure_have_no_quick_pass(
    images: tuple[Image, Image],
) -> None:
    first, second = images
    blank = Image(np.full_like(second.pixels, 90))
    rotated = Image(np.ascontiguousarray(np.rot90(second.pixels)))
    matcher = load_matcher()
    assert matcher.search(first, rotated).quick() is None
    assert matcher.search(first, blank).quick() is None
    for other in (load_matcher(refinement=RefinementOptions(source="map")), load_matcher("sift")):
        assert other.search(first, second).quick() is None
