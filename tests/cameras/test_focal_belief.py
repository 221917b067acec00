"""A belief of a focal length after the lines of images, against a numerical integration."""

import math

import numpy as np
import pytest

from dgc_pose.cameras.camera import LOG_FOCALS, FocalBelief, Part

USUAL, TAIL = Part(math.log(0.85), math.log(0.9), 0.35), Part(math.log(0.15), math.log(2.0), 0.7)
FLAT = np.zeros(len(LOG_FOCALS))


def _lines(focal: float, width: float = 0.1, height: float = 6.0) -> np.ndarray:
    """Log-likelihoods with a peak."""
    return height * np.exp(-(((LOG_FOCALS - np.log(focal)) / width) ** 2) / 2)


def _integrated(part: Part, lines: np.ndarray) -> Part:
    """By the trapezium rule, over 8 standard deviations or what a lens may have."""
    first = max(part.log_focal - 8 * part.std, math.log(0.1))
    last = min(part.log_focal + 8 * part.std, math.log(25.0))
    count = 20_000
    step = (last - first) / count
    total = mean = square = 0.0
    for k in range(count + 1):
        at = first + k * step
        place = (at - LOG_FOCALS[0]) / (LOG_FOCALS[1] - LOG_FOCALS[0])
        place = min(max(place, 0.0), len(LOG_FOCALS) - 1.0)
        below = min(int(place), len(LOG_FOCALS) - 2)
        line = lines[below] + (place - below) * (lines[below + 1] - lines[below])
        normal = math.exp(-(((at - part.log_focal) / part.std) ** 2) / 2)
        density = math.exp(line) * normal / (part.std * math.sqrt(2 * math.pi))
        density *= step if 0 < k < count else step / 2
        total, mean, square = total + density, mean + density * at, square + density * at**2
    mean, square = mean / total, square / total
    return Part(part.log_weight + math.log(total), mean, math.sqrt(square - mean**2))


@pytest.mark.parametrize(
    "lines",
    [
        _lines(0.9),
        _lines(2.0),
        _lines(0.45, 0.2, 3.0),
        _lines(0.6) + _lines(1.5, 0.3, 5.0),
        np.random.default_rng(0).normal(0, 2.0, len(LOG_FOCALS)),
    ],
    ids=["middle", "long", "short", "two", "rough"],
)
@pytest.mark.parametrize(
    "part", [USUAL, TAIL, Part(-1.0, math.log(1.2), 0.08), Part(0.0, 0.5, 0.55)]
)
def test_a_part_after_the_lines(part: Part, lines: np.ndarray) -> None:
    found = part.given(lines)
    np.testing.assert_array_less(
        abs(np.subtract(found, _integrated(part, lines))), (8e-3, 3e-3, 2e-3)
    )
    assert part.given(lines - 700).log_weight == pytest.approx(found.log_weight - 700)


def test_lines_that_tell_nothing_leave_a_part_as_it_is() -> None:
    for part in (USUAL, Part(-2.0, 0.2, 0.06)):
        assert part.given(FLAT) == pytest.approx(part, abs=1e-4)
        assert part.given(FLAT + 5) == pytest.approx(
            part._replace(log_weight=part[0] + 5), abs=1e-4
        )


@pytest.mark.parametrize(("focal", "usual_first"), [(0.8, True), (1.2, True), (4.0, False)])
def test_the_likelier_part_comes_first(focal: float, usual_first: bool) -> None:
    lines = _lines(focal)
    first, second = FocalBelief(USUAL, TAIL, FLAT).parts([lines])
    assert first.log_weight > second.log_weight
    assert (first == USUAL.given(lines)) is usual_first
    assert {first, second} == {USUAL.given(lines), TAIL.given(lines)}
    assert first.log_focal == pytest.approx(math.log(focal), abs=0.1)


def test_lines_of_many_images_count_by_the_root_of_their_number() -> None:
    """Of one or two images all of them, of 8 half."""
    belief, lines = FocalBelief(USUAL, TAIL, FLAT), _lines(1.1, 0.2, 1.0)
    for many, few in (
        ([lines, lines], [2 * lines]),
        (8 * [lines], [4 * lines]),
        ([lines, -lines], [FLAT]),
    ):
        np.testing.assert_allclose(belief.parts(many), belief.parts(few), atol=1e-9)
    stds = [belief.parts(count * [lines])[0].std for count in (1, 2, 8, 32)]
    assert stds == sorted(stds, reverse=True)
