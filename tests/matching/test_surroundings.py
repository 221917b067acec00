"""What surrounds matches without a map: alike in views of one place, at any scale and orientation;
different where only a part of the images is the same."""

import cv2
import numpy as np
import pytest
from worlds import render_views

from dgc_pose import Matches, load_matcher
from dgc_pose.images.image import Image
from dgc_pose.matching.key_points import SiftMatcher
from dgc_pose.matching.surroundings import surroundings


@pytest.fixture(scope="module")
def network():
    return load_matcher()


@pytest.fixture(scope="module")
def views() -> tuple[Image, Image]:
    K = np.array([[560.0, 0, 319.5], [0, 560, 239.5], [0, 0, 1]])
    first, second = (
        Image(view.pixels, f"{number}")
        for number, view in enumerate(render_views(2, K=K, size=(640, 480)))
    )
    return first, second


def sift(image1: Image, image2: Image) -> Matches:
    return SiftMatcher().match(image1, image2).matches


def test_one_place_is_alike(network, views) -> None:
    """Also if image 2 is on its side or half as large."""
    first, second = views
    upright = surroundings(network, first, second, sift(first, second))
    assert upright is not None and upright > 0.4
    small = Image(cv2.resize(second.pixels, None, fx=0.5, fy=0.5), "small")
    turned = Image(np.ascontiguousarray(np.rot90(second.pixels)), "turned")
    for other in (small, turned):
        around = surroundings(network, first, other, sift(first, other))
        assert around is not None and abs(around - upright) < 0.3


def test_another_place_with_the_same_object_is_not(network, views) -> None:
    """The matches lie on what both images show, amid noise and amid the place."""
    first, second = views
    matches = sift(first, second)
    low, high = (180, 130), (430, 330)
    kept = ((matches.points2 >= low) & (matches.points2 < high)).all(1)
    assert kept.sum() > 50
    noise = cv2.resize(np.random.default_rng(0).integers(0, 256, (60, 80, 3), np.uint8), (640, 480))
    noise[low[1] : high[1], low[0] : high[0]] = second.pixels[low[1] : high[1], low[0] : high[0]]
    inside = matches.subset(kept)
    same = surroundings(network, first, second, inside)
    other = surroundings(network, first, Image(noise, "other"), inside)
    assert same is not None and other is not None and other < same - 0.2


def test_too_few_matches_tell_nothing(network, views) -> None:
    first, second = views
    few = sift(first, second).subset(np.arange(5))
    assert surroundings(network, first, second, few) is None
    assert surroundings(SiftMatcher(), first, second, sift(first, second)) is None
