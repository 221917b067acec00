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
from rendered import RenderedPair, render_scene_pair

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


@pytest.fixture(scope="module")
def pair() -> RenderedPair:
    return render_scene_pair(5, size1=(640, 480), size2=(560, 520), rotation_deg=12)


def test_arrays_tensors_and_paths_give_the_same_pose(pair: RenderedPair, tmp_path: Path) -> None:
    paths = []
    for index, image in enumerate((pair.image1, pair.image2)):
        paths.append(tmp_path / f"{index}.png")
        cv2.imwrite(str(paths[-1]), image[..., ::-1])
    tensors = [
        torch.from_numpy(i).permute(2, 0, 1).float() / 255 for i in (pair.image1, pair.image2)
    ]
    poses = [
        estimate_relative_pose(a, b, pair.K1, pair.K2, matcher=SiftMatcher())
        for a, b in ((pair.image1, pair.image2), paths, tensors)
    ]
    for pose in poses:
        assert pose.success and pose.status == "ok"
        assert rotation_error_deg(pose.R, pair.R) < 0.5
        assert translation_error_deg(pose.t, pair.t) < 2.0
        assert np.array_equal(pose.R, poses[0].R) and np.array_equal(pose.t, poses[0].t)
        assert set(pose.seconds) == {"load", "full", "estimate"}


def test_a_matcher_by_its_name_and_cameras_by_four_numbers_or_a_field_of_view() -> None:
    pictures, K = dense_scene.pictures(), dense_scene.K
    fov = 2 * np.degrees(np.arctan(dense_scene.SIZE[0] / 2 / K[0, 0]))
    poses = [
        estimate_relative_pose(*pictures, K, matcher=SiftMatcher()),
        estimate_relative_pose(*pictures, K[(0, 1, 0, 1), (0, 1, 2, 2)].tolist(), matcher="sift"),
        estimate_relative_pose(*pictures, fov=fov, matcher="sift"),
    ]
    assert poses[0].success
    for pose in poses[1:]:
        np.testing.assert_allclose(pose.R, poses[0].R, atol=1e-6)
        np.testing.assert_allclose(pose.t, poses[0].t, atol=1e-6)


def test_what_is_masked_takes_no_part(pair: RenderedPair, tmp_path: Path) -> None:
    """A thing that moved over both images, which has a third of the matches without masks. One mask
    is an array, the other a file of half the size."""
    images, masks = [pair.image1.copy(), pair.image2.copy()], []
    thing = np.random.default_rng(0).integers(0, 256, (60, 40, 3), np.uint8)
    thing = cv2.resize(thing, (240, 360), interpolation=cv2.INTER_CUBIC)
    for image, x in zip(images, (60, 280), strict=True):
        image[100:460, x : x + 240] = thing
        masks.append(np.ones(image.shape[:2], bool))
        masks[-1][100:460, x : x + 240] = False
    path = tmp_path / "mask.png"
    cv2.imwrite(str(path), masks[1][::2, ::2] * np.uint8(255))
    given = (*images, pair.K1, pair.K2)
    without = estimate_relative_pose(*given, matcher="sift")
    pose = estimate_relative_pose(*given, matcher="sift", mask1=masks[0], mask2=path)
    assert pose.num_matches < 0.7 * without.num_matches
    assert pose.success and rotation_error_deg(pose.R, pair.R) < 0.5
    assert translation_error_deg(pose.t, pair.t) < 3
    with pytest.raises(InputError, match="mask2 is 640 x 480 and the image 560 x 520"):
        estimate_relative_pose(*given, matcher="sift", mask2=masks[0])


@pytest.mark.parametrize(
    "values", [(None, None), ("auto:two", "auto:two"), ("auto", dense_scene.K)]
)
def test_the_matches_tell_the_focal_length_that_is_not_known(values: tuple[Any, ...]) -> None:
    images, (K1, K2) = [Image(pixels) for pixels in dense_scene.pictures()], values
    matcher = dense_scene.MapMatcher(dense_scene.true_map(error_px=0.2))
    result = solve_pair(*images, pair_cameras(K1, K2, *images), matcher)
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
SIFT = SiftMatcher()


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
