"""SIFT as a matcher, and a user's ONNX detector, by models whose key points are bright dots."""

from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
import tiny_onnx

from dgc_pose import load_matcher
from dgc_pose.errors import InputError, WeightsError
from dgc_pose.images.image import Image
from dgc_pose.matching.key_points import LONG_SIDE, RATIO, SiftMatcher, input_size


def test_sift_s_matches_lie_on_the_surface() -> None:
    result = SiftMatcher().match(*dense_scene.images())
    matches = result.matches
    off = np.linalg.norm(dense_scene.points_in_image1(matches.points2) - matches.points1, axis=1)
    assert np.median(off) < 1.0 and (off < 3).mean() > 0.8 and len(matches) > 60
    assert matches.confidence.min() >= 1 - RATIO
    assert matches.key_points and result.correspondence_map is None


def test_larger_images_are_seen_at_the_long_side() -> None:
    """Exactly, whatever the width; smaller ones at the next multiple of 32 below their size."""
    for width in range(1, 12_000):
        longer, shorter = input_size((width, -(-width // 2)))
        assert longer == (LONG_SIDE if width > LONG_SIDE else max(32, width // 32 * 32))
        assert shorter == max(32, longer // 2 // 32 * 32) or width < LONG_SIDE
        assert input_size((-(-width // 2), width)) == (shorter, longer)


SHIFT = (16, 8)  # pixels, x and y: whole cells of the grid
CUT = np.eye(64, dtype=np.float32).reshape(64, 1, 8, 8)  # each of a cell's pixels as a channel
SIDES = ("h", "w")


def _dots() -> np.ndarray:
    """A dot on a ground of its own in each cell of 8x8 pixels, (192, 256, 3) uint8."""
    rng = np.random.default_rng(0)
    grey = cv2.resize(rng.uniform(20, 120, (48, 64)), (256, 192), interpolation=cv2.INTER_CUBIC)
    for y in range(0, 192, 8):
        for x in range(0, 256, 8):
            grey[y + rng.integers(2, 6), x + rng.integers(2, 6)] = 255
    return np.repeat(grey.clip(0, 255).astype(np.uint8)[..., None], 3, 2)


def _grid_model(path: Path, *, reliability: bool = False) -> Path:
    """Logits are 20 times the pixels of a cell, and 15 for none; descriptors are the pixels."""
    weights = {
        "logit": np.concatenate([20 * CUT, np.zeros((1, 1, 8, 8), np.float32)]),
        "bias": np.append(np.zeros(64), 15).astype(np.float32),
        "cut": CUT,
        "mean": np.full((1, 1, 8, 8), 1 / 64, np.float32),
    }
    by_cell = {"strides": [8, 8]}
    nodes = [
        ("Conv", ["image", "logit", "bias"], "logits", by_cell),
        ("Conv", ["image", "cut"], "descriptors", by_cell),
    ]
    outputs = {"logits": (1, 65, *SIDES), "descriptors": (1, 64, *SIDES)}
    if reliability:
        nodes.append(("Conv", ["image", "mean"], "reliability", by_cell))
        outputs["reliability"] = (1, 1, *SIDES)
    return tiny_onnx.write_model(path, nodes, weights, {"image": (1, 1, *SIDES)}, outputs)


def _points_model(path: Path) -> Path:
    """The same three key points in every image."""
    weights = {
        "points": np.array([[10, 20], [30, 40], [50, 45]], np.float32),
        "words": np.eye(3, dtype=np.float32),
        "nothing": np.zeros(1, np.float32),
    }
    nodes = [
        ("ReduceMean", ["image"], "mean", {}),
        ("Mul", ["mean", "nothing"], "zero", {}),
        ("Squeeze", ["zero"], "scalar", {}),
        ("Add", ["points", "scalar"], "keypoints", {}),
        ("Add", ["words", "scalar"], "descriptors", {}),
    ]
    outputs = {"keypoints": (3, 2), "descriptors": (3, 3)}
    return tiny_onnx.write_model(path, nodes, weights, {"image": (1, 3, 64, 96)}, outputs)


DOTS = _dots()
IMAGES = Image(DOTS), Image(np.roll(DOTS, (SHIFT[1], SHIFT[0]), (0, 1)))


@pytest.mark.parametrize("reliability", [False, True])
def test_dots_are_found_where_they_are(tmp_path, reliability) -> None:
    matcher = load_matcher(_grid_model(tmp_path / "dots.onnx", reliability=reliability))
    matches = matcher.match(*IMAGES).matches
    assert matcher.name == "dots" and len(matcher.fingerprint) == 16
    assert matches.key_points and matches.error_px == 1.0
    assert len(matches) > 300 and (matches.confidence > 0.5).all()
    right = (matches.points2 - matches.points1 == SHIFT).all(1)
    assert right.mean() > 0.95  # those at the edge, rolled in, have no partner
    x, y = matches.points1.astype(int).T
    assert (IMAGES[0].pixels[y, x] == 255).all()


def test_a_larger_image_is_shrunk_and_its_points_are_in_its_own_pixels(tmp_path) -> None:
    large = [Image(np.kron(image.pixels, np.ones((8, 8, 1), np.uint8))) for image in IMAGES]
    matches = load_matcher(_grid_model(tmp_path / "dots.onnx")).match(*large).matches
    assert matches.error_px == 2.0 and len(matches) > 100
    off = matches.points2 - matches.points1 - np.multiply(8, SHIFT)
    assert np.median(np.abs(off)) <= 2


def test_points_as_they_are_in_the_image_s_pixels(tmp_path) -> None:
    matches = load_matcher(_points_model(tmp_path / "three.onnx")).match(*IMAGES).matches
    scale = np.divide((256, 192), (96, 64))
    expected = (np.array([[10, 20], [30, 40], [50, 45]]) + 0.5) * scale - 0.5
    np.testing.assert_allclose(matches.points1, expected)
    np.testing.assert_allclose(matches.points2, expected)


def test_other_layouts_are_refused_with_what_they_are(tmp_path) -> None:
    by_cell = {"strides": [8, 8]}
    nodes = [("Conv", ["image", "cut"], "features", by_cell)]
    image, features = {"image": (1, 1, *SIDES)}, {"features": (1, 64, *SIDES)}
    path = tiny_onnx.write_model(tmp_path / "m.onnx", nodes, {"cut": CUT}, image, features)
    with pytest.raises(
        InputError, match=r"inputs image .* and outputs features \(1, 64, h, w\); expected an image"
    ):
        load_matcher(path)
    flat = {"image": (1, 1, "h")}
    path = tiny_onnx.write_model(
        tmp_path / "m.onnx", [("Relu", ["image"], "out", {})], {}, flat, {"out": (1, 1, "h")}
    )
    with pytest.raises(InputError, match=r"inputs image \(1, 1, h\) and outputs"):
        load_matcher(path)
    path.write_bytes(b"no model")
    with pytest.raises(WeightsError, match="m.onnx"):
        load_matcher(path)
    with pytest.raises(WeightsError, match="gone.onnx is not a file, and no weights"):
        load_matcher(tmp_path / "gone.onnx")
