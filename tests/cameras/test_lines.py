"""Focal lengths by the lines of pictures that are drawn with a known one, and of pictures that tell
none; a prior of a focal length after the lines, against a numerical integration."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from boxes import box_picture, grey
from scipy.stats import norm

from dgc_pose.cameras.camera import LOG_FOCALS, FocalPrior, Part
from dgc_pose.cameras.lines import CHANCE, SHARPNESS, calibrated, focal_scores, log_likelihoods
from dgc_pose.images.image import Image

SIZE = (960, 720)
STEP = LOG_FOCALS[1] - LOG_FOCALS[0]
PRIOR = Part(0.0, np.log(0.9), 0.35)


def _peak(lines: np.ndarray) -> float:
    return float(LOG_FOCALS[lines.argmax()])


@pytest.mark.parametrize(
    ("focal", "turn_deg"),
    [(0.5, (30, 20, 3)), (0.9, (-35, 15, 10)), (1.3, (30, 20, 3)), (3.0, (-35, 15, 10))],
)
def test_the_likeliest_focal_length_is_that_of_the_picture(
    focal: float, turn_deg: tuple[float, float, float]
) -> None:
    """The posterior covers it: narrower than the prior for usual focal lengths, and 3 times the
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
    first = rng.uniform(0, SIZE, (count, 2))
    angle = rng.uniform(0, np.pi, count)
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    return _drawn(*np.stack([first, first + rng.uniform(40, 200, (count, 1)) * along], 1))


def _grid(angle_deg: float) -> np.ndarray:
    """A plane that the camera faces: its lines meet at infinity, whatever the focal length."""
    angle = np.radians(angle_deg)
    middle = (np.array(SIZE) - 1) / 2
    u = np.array([np.cos(angle), np.sin(angle)])
    v = np.array([-np.sin(angle), np.cos(angle)])
    offsets = 90 * np.arange(-10, 11)
    return _drawn(
        *(
            middle + offset * across + np.array([[-2000], [2000]]) * along
            for offset in offsets
            for along, across in ((u, v), (v, u))
        )
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("drawn", [_clouds, lambda seed: _scribble(seed, 60)])
def test_a_picture_without_three_directions_tells_hardly_anything(
    drawn: Callable[[int], np.ndarray], seed: int
) -> None:
    lines = log_likelihoods(Image(grey(drawn(seed))))
    found = PRIOR.given(lines)
    assert found.std > 0.85 * PRIOR.std and lines.max() < 2
    assert abs(found.log_focal - PRIOR.log_focal) < 0.5 * PRIOR.std


@pytest.mark.parametrize("angle_deg", [0.0, 10.0])
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
    ],
    ids=["blank", "noise", "two lines", "one pixel"],
)
def test_a_picture_without_segments_tells_nothing(picture: np.ndarray) -> None:
    image = Image(grey(picture))
    scores, count = focal_scores(image)
    assert count == 0 and not scores.any()
    np.testing.assert_array_equal(log_likelihoods(image), 0)
    assert PRIOR.given(log_likelihoods(image)) == pytest.approx(PRIOR, abs=1e-6)


def test_lines_on_masked_pixels_do_not_count() -> None:
    """A picture of another focal length is glued over a part of it."""
    pixels = box_picture(0.8)
    mask = np.ones(SIZE[::-1], bool)
    mask[:, :400] = False
    glued = pixels.copy()
    glued[:, :400] = box_picture(2.5, (45, 10, 0), seed=2)[:, :400]
    image = Image(glued, mask=mask)
    lines = log_likelihoods(image)
    assert 8 <= focal_scores(image)[1] < focal_scores(Image(glued))[1]
    assert abs(_peak(lines) - np.log(0.8)) < 1.5 * STEP
    nothing = Image(pixels, mask=np.zeros_like(mask))
    np.testing.assert_array_equal(log_likelihoods(nothing), 0)
    np.testing.assert_array_equal(log_likelihoods(Image(pixels, pixel_aspect=1.25)), 0)


@pytest.mark.parametrize("count", [0, 10, 160])
def test_likelihoods_by_scores(count: int) -> None:
    """By the formula, written as a loop: more segments are surer, and no focal length is excluded
    by more than chance."""
    scores = np.random.default_rng(0).random(len(LOG_FOCALS))
    terms = [np.exp(SHARPNESS * count**0.5 * (s - max(scores))) for s in scores]
    mean = sum(terms) / len(terms)
    expected = [np.log((1 - CHANCE) * term / mean + CHANCE) for term in terms]
    np.testing.assert_allclose(calibrated(scores, count), expected, atol=1e-12)


USUAL = Part(math.log(0.85), math.log(0.9), 0.35)
TAIL = Part(math.log(0.15), math.log(2.0), 0.7)
FLAT = np.zeros(len(LOG_FOCALS))


def _lines(focal: float, width: float = 0.1, height: float = 6.0) -> np.ndarray:
    """Log-likelihoods with a peak."""
    return height * np.exp(-(((LOG_FOCALS - np.log(focal)) / width) ** 2) / 2)


def _integrated(part: Part, lines: np.ndarray) -> Part:
    """By the trapezium rule, over 8 standard deviations or what a lens may have."""
    first = max(part.log_focal - 8 * part.std, math.log(0.1))
    last = min(part.log_focal + 8 * part.std, math.log(25.0))
    at, step = np.linspace(first, last, 20_001, retstep=True)
    density = np.exp(np.interp(at, LOG_FOCALS, lines)) * norm.pdf(at, part.log_focal, part.std)
    density[[0, -1]] /= 2
    total = density.sum()
    mean = density @ at / total
    square = density @ at**2 / total
    log_weight = part.log_weight + math.log(total * step)
    return Part(log_weight, mean, math.sqrt(square - mean**2))


@pytest.mark.parametrize(
    "lines",
    [
        _lines(0.9),
        _lines(2.0),
        _lines(0.6) + _lines(1.5, 0.3, 5.0),
        np.random.default_rng(0).normal(0, 2.0, len(LOG_FOCALS)),
    ],
    ids=["middle", "long", "two", "rough"],
)
@pytest.mark.parametrize("part", [USUAL, TAIL, Part(-1.0, math.log(1.2), 0.08)])
def test_a_part_after_the_lines(part: Part, lines: np.ndarray) -> None:
    found = part.given(lines)
    np.testing.assert_array_less(
        abs(np.subtract(found, _integrated(part, lines))), (8e-3, 3e-3, 2e-3)
    )
    assert part.given(lines - 700).log_weight == pytest.approx(found.log_weight - 700)


@pytest.mark.parametrize(("focal", "usual_first"), [(0.8, True), (1.2, True), (4.0, False)])
def test_the_likelier_part_comes_first(focal: float, usual_first: bool) -> None:
    lines = _lines(focal)
    first, second = FocalPrior(USUAL, TAIL, FLAT).parts([lines])
    assert first.log_weight > second.log_weight
    assert (first == USUAL.given(lines)) is usual_first
    assert {first, second} == {USUAL.given(lines), TAIL.given(lines)}
    assert first.log_focal == pytest.approx(math.log(focal), abs=0.1)


def test_lines_of_many_images_count_by_the_root_of_their_number() -> None:
    """All of one or two, half of 8."""
    focal_prior = FocalPrior(USUAL, TAIL, FLAT)
    lines = _lines(1.1, 0.2, 1.0)
    for many, few in (
        ([lines, lines], [2 * lines]),
        (8 * [lines], [4 * lines]),
        ([lines, -lines], [FLAT]),
    ):
        np.testing.assert_allclose(focal_prior.parts(many), focal_prior.parts(few), atol=1e-9)
    stds = [focal_prior.parts(count * [lines])[0].std for count in (1, 2, 8, 32)]
    assert stds == sorted(stds, reverse=True)
