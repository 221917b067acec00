"""Optical flow as a matcher, against images drawn from a formula, whose map is known."""

import numpy as np
import pytest

from dgc_pose.benchmarks.other_matchers import FlowMatcher, agreement
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image
from dgc_pose.matching import CorrespondenceMap, select_matches
from dgc_pose.matching.texture import texture, textured


def _picture(x: np.ndarray, y: np.ndarray) -> Image:
    """Waves of many directions and lengths, at points (H, W) of a plane 200 wide."""
    rng = np.random.default_rng(0)
    value = np.zeros_like(x)
    for _ in range(40):
        angle = rng.uniform(0, 2 * np.pi)
        length = rng.uniform(8, 60)
        phase = rng.uniform(0, 6)
        value += np.sin(2 * np.pi * (np.cos(angle) * x + np.sin(angle) * y) / length + phase)
    grey = np.clip(128 + 14 * value, 0, 255).round().astype(np.uint8)
    return Image(np.ascontiguousarray(np.repeat(grey[..., None], 3, 2)))


def _plane(size: tuple[int, int], width: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """The pixels of an image of that size on a plane of width x height."""
    points = (pixel_grid(size) + 0.5) * np.divide((width, height), size)
    return points[..., 0], points[..., 1]


@pytest.mark.parametrize(
    ("sizes", "plane"),
    [
        (((100, 160), (200, 160)), (200, 160)),
        (((960, 768), (800, 640)), (640, 512)),
    ],
)
def test_the_map_leads_from_image_2_into_image_1(sizes, plane) -> None:
    """Image 2 shows the plane shifted and rotated a little; large images are shrunk and their maps
    scaled, each axis of each image by its own factor."""
    angle = 0.01
    shift = (4.0, -2.5)
    x, y = _plane(sizes[1], *plane)
    moved = (x - angle * y + shift[0], y + angle * x + shift[1])
    matcher = FlowMatcher()
    images = _picture(*_plane(sizes[0], *plane)), _picture(*moved)
    result = matcher.match(*images)
    found = result.correspondence_map
    assert isinstance(found, CorrespondenceMap)
    selected = textured(select_matches(found, matcher.options), *map(texture, images))
    assert len(result.matches) == len(selected) > 500 and result.matches.weights is None
    assert (found.size1, found.size2) == sizes
    # From the grid by the formula above, in plane units and back to pixels of image 1.
    unit1 = np.divide(sizes[0], plane)
    unit2 = np.divide(sizes[1], plane)
    u, v = np.moveaxis((found.grid + 0.5) / unit2, -1, 0)
    expected = np.stack([u - angle * v + shift[0], v + angle * u + shift[1]], -1) * unit1 - 0.5
    error = np.linalg.norm((found.map - expected) / unit1, axis=-1)[16:-16, 16:-16]
    assert np.median(error) < 0.3  # without the flow it would be 4
    matchable = found.matchability[16:-16, 16:-16] == 1
    assert matchable.mean() > 0.8
    assert error[matchable].mean() < error.mean() + 1e-6


def test_agreement_is_the_formula() -> None:
    """A constant flow and a constant flow back: |f + b|^2 < 0.01 (|f|^2 + |b|^2) + 0.5."""
    flow = np.zeros((20, 30, 2), np.float32)
    flow[..., 0] = 10
    for back, agrees in ((-10.0, 1), (-8.4, 0), (-8.8, 1), (-11.2, 1), (-11.8, 0)):
        returned = np.zeros_like(flow)
        returned[..., 0] = back
        limit = 0.01 * (100 + back**2) + 0.5
        assert ((10 + back) ** 2 < limit) == agrees
        found = agreement(flow, returned)
        assert (found[:, :20] == agrees).all()
        assert not found[:, 20:].any()  # the flow leaves the image
