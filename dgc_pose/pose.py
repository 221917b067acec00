"""The pipeline on one page: images, matches, essential matrix, pose."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.camera import Camera, as_camera, check_size
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.image import Image, load_image
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap, DenseMatcher, Matcher, load_matcher
from dgc_pose.refinement import Refiner

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class Trace:
    """A pose with everything that it was made from."""

    image1: Image
    image2: Image
    camera1: Camera
    camera2: Camera
    correspondences: CorrespondenceMap | None  # None for a matcher that makes no dense map
    matches: Matches
    pose: RelativePose


def estimate_relative_pose(
    image1: str | Path | np.ndarray | torch.Tensor | Image,
    image2: str | Path | np.ndarray | torch.Tensor | Image,
    K1: ArrayLike | Camera,
    K2: ArrayLike | Camera | None = None,
    *,
    matcher: Matcher | None = None,
    options: EstimationOptions | None = None,
) -> RelativePose:
    """The pose of camera 2 relative to camera 1: x2 = R x1 + t, translation up to scale.

    image1, image2: paths, arrays (H, W[, 3]) in RGB order, or tensors. K1, K2: 3x3 matrices in
    pixels of those images, (0, 0) the centre of the top-left pixel, or `Camera`s (with lens
    distortion, where there is one); without K2, K1 serves for both. matcher: by default the
    shipped network, refined on the original photographs. The result says plainly where there is no
    pose (`success`, `reason`).

    Raises ImageError where an image cannot be read, InputError (a ValueError) where an argument is
    of no use, WeightsError where the network's weights cannot be had.

    >>> pose = estimate_relative_pose("1.jpg", "2.jpg", K)  # doctest: +SKIP
    >>> pose.success, pose.R, pose.t  # doctest: +SKIP
    """
    return trace_relative_pose(image1, image2, K1, K2, matcher=matcher, options=options).pose


def trace_relative_pose(
    image1: str | Path | np.ndarray | torch.Tensor | Image,
    image2: str | Path | np.ndarray | torch.Tensor | Image,
    K1: ArrayLike | Camera,
    K2: ArrayLike | Camera | None = None,
    *,
    matcher: Matcher | None = None,
    options: EstimationOptions | None = None,
) -> Trace:
    """As `estimate_relative_pose`, with the images, the map and the matches beside the pose."""
    start = time.perf_counter()
    first, second = load_image(image1, "image1"), load_image(image2, "image2")
    camera1 = as_camera(K1, "K1")
    camera2 = camera1 if K2 is None else as_camera(K2, "K2")
    fits1 = check_size(camera1, first.size, "K1")
    fits2 = check_size(camera2, second.size, "K1" if K2 is None else "K2")
    matcher = matcher or Refiner(load_matcher())
    loaded = time.perf_counter()

    correspondences, matches = match_images(matcher, first, second)
    matched = time.perf_counter()

    pose = estimate_pose(matches, camera1, camera2, options or EstimationOptions())
    estimated = time.perf_counter()

    read = first.warnings + second.warnings + camera1.warnings + camera2.warnings
    warnings = tuple(dict.fromkeys(read + fits1 + fits2 + pose.warnings))
    seconds = {
        "load": loaded - start,
        "match": matched - loaded,
        "estimate": estimated - matched,
    }
    pose = replace(pose, warnings=warnings, seconds=seconds)
    return Trace(first, second, camera1, camera2, correspondences, matches, pose)


def match_images(
    matcher: Matcher, image1: Image, image2: Image
) -> tuple[CorrespondenceMap | None, Matches]:
    """What a matcher finds, with the dense map where it makes one."""
    if isinstance(matcher, DenseMatcher | Refiner):
        return matcher.trace(image1, image2)
    return None, matcher.match(image1, image2)
