"""Focal lengths by the lines of pictures that are drawn with a known one, and of pictures that tell
none."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from boxes import box_picture, grey

from dgc_pose.cameras.camera import Part
from dgc_pose.cameras.lines import (
    CHANCE,
    LOG_FOCALS,
    SHARPNESS,
    calibrated,
    focal_scores,
    log_likelihoods,
)
from dgc_pose.images.image import Image

SIZE = (960, 720)
STEP = LOG_FOCALS[1] - LOG_FOCALS[0]
PRIOR = Part(0.0, np.log(0.9), 0.35)
TURNS = [(30, 20, 3), (40, -25, -5), (-35, 15, 10), (20, 10, 0)]


def _peak(lines: np.ndarray) -> float:
    return float(LOG_FOCALS[lines.argmax()])


@pytest.mark.parametrize("focal", [0.5, 0.7, 0.9, 1.3, 2.0, 3.0])
@pytest.mark.parametrize("turn_deg", TURNS)
def test_the_likeliest_focal_length_is_that_of_the_picture(
    focal: float, turn_deg: tuple[float, float, float]
) -> None:
    """And the posterior covers it: narrower than the prior for usual focal lengths, and 3 times the
    longer side is in its tail."""
    lines = log_likelihoods(Image(box_picture(focal, turn_deg)))
    assert abs(_peak(lines) - np.log(focal)) < 1.5 * STEP
    found = PRIOR.given(lines)
    assert abs(found.log_focal - np.log(focal)) < 3 * found.std
    if 0.7 <= focal <= 1.3:
        assert abs(found.log_focal - np.log(focal)) < 0.1 and found.std < 0.2
    if focal > 2:  # of a wide prior alone
        wide = Part(0.0, 0.0, 2.0).given(lines)
        assert abs(wide.log_focal - np.log(focal)) < wide.std < 0.7


@pytest.mark.parametrize("size", [(1920, 1440), (720, 960), (480, 480)])
def test_the_size_and_the_colours_of_a_picture_do_not_matter(size: tuple[int, int]) -> None:
    pixels = box_picture(0.9, size=size)
    lines = log_likelihoods(Image(pixels))
    assert abs(_peak(lines) - np.log(0.9)) < 1.5 * STEP
    inverse = log_likelihoods(Image(255 - pixels))
    assert abs(_peak(inverse) - np.log(0.9)) < 1.5 * STEP


def test_the_same_picture_has_the_same_lines() -> None:
    image = Image(box_picture(0.9))
    np.testing.assert_array_equal(log_likelihoods(image), log_likelihoods(image))


def _noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, SIZE[::-1], dtype=np.uint8)


def _clouds(seed: int) -> np.ndarray:
    blurred = cv2.GaussianBlur(_noise(seed), (0, 0), 6.0)
    return cv2.normalize(blurred, None, 0, 255, cv2.NORM_MINMAX)


def _drawn(*segments: np.ndarray) -> np.ndarray:
    """Segments (2, 2), pixels."""
    picture = np.full(SIZE[::-1], 90, np.uint8)
    for segment in segments:
        first, second = np.round(16 * np.asarray(segment)).astype(int).tolist()
        cv2.line(picture, first, second, 230, 3, cv2.LINE_AA, 4)
    return picture


def _scribble(seed: int, count: int) -> np.ndarray:
    """Segments in any direction."""
    rng = np.random.default_rng(seed)
    first, angle = rng.uniform(0, SIZE, (count, 2)), rng.uniform(0, np.pi, count)
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    return _drawn(*np.stack([first, first + rng.uniform(40, 200, (count, 1)) * along], 1))


def _grid(angle_deg: float) -> np.ndarray:
    """Of a plane that the camera faces: its lines meet at infinity, whatever the focal length."""
    angle, middle = np.radians(angle_deg), (np.array(SIZE) - 1) / 2
    u, v = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    offsets = 90 * np.arange(-10, 11)
    return _drawn(
        *(
            middle + offset * across + np.array([[-2000], [2000]]) * along
            for offset in offsets
            for along, across in ((u, v), (v, u))
        )
    )


def _circles(seed: int) -> np.ndarray:
    rng, picture = np.random.default_rng(seed), np.full(SIZE[::-1], 90, np.uint8)
    for _ in range(40):
        centre, radius = rng.integers(0, SIZE).tolist(), int(rng.integers(10, 120))
        cv2.circle(picture, centre, radius, int(rng.integers(100, 255)), 2, cv2.LINE_AA)
    return picture


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "drawn", [_clouds, lambda seed: _scribble(seed, 60), lambda seed: _scribble(seed, 12), _circles]
)
def test_a_picture_without_three_directions_tells_hardly_anything(
    drawn: Callable[[int], np.ndarray], seed: int
) -> None:
    lines = log_likelihoods(Image(grey(drawn(seed))))
    found = PRIOR.given(lines)
    assert found.std > 0.85 * PRIOR.std and lines.max() < 2
    assert abs(found.log_focal - PRIOR.log_focal) < 0.5 * PRIOR.std


@pytest.mark.parametrize("angle_deg", [0.0, 10.0, 45.0])
def test_a_plane_that_the_camera_faces_agrees_with_every_focal_length(angle_deg: float) -> None:
    image = Image(grey(_grid(angle_deg)))
    scores, count = focal_scores(image)
    assert count > 100 and scores.min() > 0.9
    np.testing.assert_allclose(log_likelihoods(image), 0, atol=0.01)


@pytest.mark.parametrize(
    "picture",
    [
        np.full(SIZE[::-1], 200, np.uint8),
        _noise(0),
        _drawn([[100, 100], [800, 150]], [[100, 600], [700, 500]]),
        np.zeros((1, 1), np.uint8),
        np.zeros((2, 300), np.uint8),
    ],
    ids=["blank", "noise", "two lines", "one pixel", "two rows"],
)
def test_a_picture_without_segments_tells_nothing(picture: np.ndarray) -> None:
    image = Image(grey(picture))
    scores, count = focal_scores(image)
    assert count == 0 and not scores.any()
    np.testing.assert_array_equal(log_likelihoods(image), 0)
    assert PRIOR.given(log_likelihoods(image)) == pytest.approx(PRIOR, abs=1e-6)


def test_lines_on_masked_pixels_do_not_count() -> None:
    """A picture of another focal length is glued over a part of it."""
    pixels, mask = box_picture(0.8), np.ones(SIZE[::-1], bool)
    mask[:, :400] = False
    glued = pixels.copy()
    glued[:, :400] = box_picture(2.5, (45, 10, 0), seed=2)[:, :400]
    image = Image(glued, mask=mask)
    lines = log_likelihoods(image)
    assert 8 <= focal_scores(image)[1] < focal_scores(Image(glued))[1]
    assert abs(_peak(lines) - np.log(0.8)) < 1.5 * STEP
    # Whatever is below the mask.
    glued[:, :390] = grey(_scribble(0, 60))[:, :390]
    np.testing.assert_allclose(log_likelihoods(Image(glued, mask=mask)), lines, atol=0.1)
    nothing = Image(pixels, mask=np.zeros_like(mask))
    np.testing.assert_array_equal(log_likelihoods(nothing), 0)
    every = Image(pixels, mask=np.ones_like(mask))
    np.testing.assert_array_equal(log_likelihoods(every), log_likelihoods(Image(pixels)))


def test_pixels_that_are_not_square_tell_nothing() -> None:
    image = Image(box_picture(0.9))
    assert log_likelihoods(image).any()
    np.testing.assert_array_equal(log_likelihoods(replace(image, pixel_aspect=1.25)), 0)


def test_likelihoods_by_scores() -> None:
    """By the formula, written as a loop: more segments are surer, and no focal length is excluded
    by more than chance."""
    scores = np.random.default_rng(0).random(len(LOG_FOCALS))
    for count in (0, 10, 160):
        terms = [np.exp(SHARPNESS * count**0.5 * (s - max(scores))) for s in scores]
        mean = sum(terms) / len(terms)
        expected = [np.log((1 - CHANCE) * term / mean + CHANCE) for term in terms]
        np.testing.assert_allclose(calibrated(scores, count), expected, atol=1e-12)
        assert np.exp(calibrated(scores, count)).mean() == pytest.approx(1)
    assert np.ptp(calibrated(scores, 160)) > np.ptp(calibrated(scores, 10)) > 0
    assert calibrated(scores, 10_000).min() == pytest.approx(np.log(CHANCE))
    np.testing.assert_allclose(calibrated(scores, 160, 0.0, 0.1), 0, atol=1e-12)
    np.testing.assert_allclose(calibrated(scores, 160, 3.0, 1.0), 0, atol=1e-12)
