"""The whole pipeline, from paths, arrays and tensors to a pose and its verdict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import dense_scene
import numpy as np
import pytest
import torch

from dgc_pose import (
    Camera,
    EstimationOptions,
    Image,
    ImageError,
    InputError,
    estimate_pose,
    estimate_relative_pose,
    load_matcher,
    pair_cameras,
    solve_pair,
)
from dgc_pose.matching.key_points import SiftMatcher
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

SIFT = SiftMatcher()
K1 = dense_scene.K
WIDE = (400, 240)  # of image 2
K2 = Camera(K1, dense_scene.SIZE).resized(WIDE).K


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray]:
    first, second = dense_scene.pictures()
    return first, cv2.resize(second, WIDE)


def test_pictures_and_cameras_in_any_form_give_the_same_pose(
    pair: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    paths = [tmp_path / "1.png", tmp_path / "2.png"]
    for path, image in zip(paths, pair, strict=True):
        cv2.imwrite(str(path), image[..., ::-1])
    tensors = [torch.from_numpy(image).permute(2, 0, 1).float() / 255 for image in pair]
    numbers = [K[(0, 1, 0, 1), (0, 1, 2, 2)].tolist() for K in (K1, K2)]
    poses = [
        estimate_relative_pose(*pair, K1, K2, matcher=SIFT),
        estimate_relative_pose(*paths, *numbers, matcher="sift"),
        estimate_relative_pose(*tensors, K1, K2, matcher=SIFT),
    ]
    for pose in poses:
        assert pose.success and pose.status == "ok"
        assert rotation_error_deg(pose.R, dense_scene.R) < 0.5
        assert translation_error_deg(pose.t, dense_scene.T) < 2.0
        assert np.array_equal(pose.R, poses[0].R) and np.array_equal(pose.t, poses[0].t)
        assert set(pose.seconds) == {"load", "full", "estimate"}
    fov = 2 * np.degrees(np.arctan(dense_scene.SIZE[0] / 2 / K1[0, 0]))
    seen = estimate_relative_pose(*dense_scene.pictures(), fov=fov, matcher="sift")
    np.testing.assert_allclose([seen.K1, seen.K2], [K1, K1])
    assert rotation_error_deg(seen.R, dense_scene.R) < 0.5


def test_what_is_masked_takes_no_part(pair: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> None:
    """A thing that moved over both images. One mask is an array, the other a file of half the
    size."""
    images = [image.copy() for image in pair]
    masks = []
    noise = np.random.default_rng(0).integers(0, 256, (30, 20, 3), np.uint8)
    thing = cv2.resize(noise, (120, 180), interpolation=cv2.INTER_CUBIC)
    for image, x in zip(images, (30, 190), strict=True):
        image[40:220, x : x + 120] = thing
        masks.append(np.ones(image.shape[:2], bool))
        masks[-1][40:220, x : x + 120] = False
    path = tmp_path / "mask.png"
    cv2.imwrite(str(path), masks[1][::2, ::2] * np.uint8(255))
    given = (*images, K1, K2)
    without = estimate_relative_pose(*given, matcher=SIFT)
    pose = estimate_relative_pose(*given, matcher=SIFT, mask1=masks[0], mask2=path)
    assert pose.num_matches < 0.7 * without.num_matches
    assert pose.success and rotation_error_deg(pose.R, dense_scene.R) < 0.5
    assert translation_error_deg(pose.t, dense_scene.T) < 3
    with pytest.raises(InputError, match="mask2 is 320 x 240 and the image 400 x 240"):
        estimate_relative_pose(*given, matcher=SIFT, mask2=masks[0])


@pytest.mark.parametrize(
    "values", [(None, None), ("auto:two", "auto:two"), ("auto", dense_scene.K)]
)
def test_the_matches_tell_the_focal_length_that_is_not_known(values: tuple[Any, ...]) -> None:
    images = [*dense_scene.images()]
    matcher = dense_scene.MapMatcher(dense_scene.true_map(error_px=0.2))
    result = solve_pair(*images, pair_cameras(*values, *images), matcher)
    pose, truth = result.pose, dense_scene.K[0, 0]
    assert pose.success
    cameras = (result.camera1, result.camera2), (result.prior1, result.prior2)
    for camera, prior in zip(*cameras, strict=True):
        if prior.focal_std == 0:
            np.testing.assert_array_equal(camera.K, dense_scene.K)
            continue
        assert prior.focal_std > 0.2 and prior.focal_source in ("size", "lines")
        error = abs(camera.focal / truth - 1)
        assert error < 0.01 and error < 2 * camera.focal_std < 0.2
        assert camera.focal_source == "matches"
    error_90 = pose.rotation_error_90_deg
    assert error_90 is not None and rotation_error_deg(pose.R, dense_scene.R) < error_90 < 3


IMAGE = np.zeros((40, 50, 3), np.uint8)
K = np.array([[50.0, 0, 24.5], [0, 50, 19.5], [0, 0, 1]])


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: estimate_relative_pose(IMAGE, IMAGE, K, matcher=5), "matcher"),
        (lambda: estimate_relative_pose(IMAGE, IMAGE, K, matcher=SIFT, options={}), "options"),
        (lambda: estimate_relative_pose(None, IMAGE, K, matcher=SIFT), "image1"),
        (lambda: estimate_relative_pose(IMAGE, np.zeros(7), K, matcher=SIFT), "image2"),
        (lambda: estimate_relative_pose(IMAGE, IMAGE, K, 5 * K, matcher=SIFT), "K2"),
        (lambda: estimate_pose(IMAGE, Camera(K), Camera(K)), "matches"),
        (lambda: solve_pair("1.jpg", Image(IMAGE), (Camera(K), Camera(K)), SIFT), "image1"),
        (lambda: solve_pair(Image(IMAGE), Image(IMAGE), (K, K), SIFT), "cameras"),
        (lambda: load_matcher(5), "name"),
        (lambda: load_matcher("sift", cache=2**31), "cache"),
        (lambda: EstimationOptions(runs="5"), "runs"),
    ],
)
def test_a_wrong_argument_is_named(call: Callable[[], object], named: str) -> None:
    with pytest.raises((InputError, ImageError), match=rf"^{named}\b"):
        call()
