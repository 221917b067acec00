"""The pipeline on one page: images, matches, essential matrix, pose."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import with_orientation
from dgc_pose.cameras.two_views import TwoViews
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.images.image import Image, load_image
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap, Matcher, MatchResult
from dgc_pose.system.options import check_type

if TYPE_CHECKING:
    import torch


_HOPELESS, _CERTAIN = 0.005, 0.99  # probabilities beyond which matches are not searched again


@dataclass(frozen=True)
class Trace:
    """A pose with everything that it was computed from."""

    image1: Image
    image2: Image
    camera1: Camera  # those that the pose is of, as in `pose`; without a pose, the priors
    camera2: Camera
    prior1: Camera  # those before the estimation: of the K given, or of what the image says
    prior2: Camera
    correspondence_map: CorrespondenceMap | None  # None for a matcher that makes no dense map
    matches: Matches
    pose: RelativePose


def estimate_relative_pose(
    image1: str | Path | np.ndarray | torch.Tensor | Image,
    image2: str | Path | np.ndarray | torch.Tensor | Image,
    K1: ArrayLike | Camera | Path | None = None,
    K2: ArrayLike | Camera | Path | None = None,
    *,
    matcher: Matcher | None = None,
    options: EstimationOptions | None = None,
) -> RelativePose:
    """The pose of camera 2 relative to camera 1: x2 = R x1 + t, translation up to scale.

    image1, image2: paths, arrays (H, W[, 3]) in RGB order, or tensors. K1, K2: 3x3 matrices in
    pixels of those images, (0, 0) the centre of the top-left pixel; or `Camera`s, which may have
    lens distortion; or texts and files as of --K. Without K2, K1 serves for both. matcher: by
    default `load_matcher()`, the shipped network with refinement. Without a pose, `success` is
    False and `reason` says why.

    A K that is not known is None or "auto"; for K2 alone "auto". The matches tell the focal length
    then: see `K1`, `K2`, `focal_std1` and `focal_std2` of the pose. One camera took both images if
    their sizes and EXIF data agree; "auto:shared" and "auto:two" say it instead.

    Raises ImageError if an image cannot be read, InputError (a ValueError) if another argument is
    unusable, WeightsError if the network's weights cannot be loaded.

    >>> pose = estimate_relative_pose("1.jpg", "2.jpg", K)  # doctest: +SKIP
    >>> pose.success, pose.R, pose.t  # doctest: +SKIP
    """
    return trace_relative_pose(image1, image2, K1, K2, matcher=matcher, options=options).pose


def trace_relative_pose(
    image1: str | Path | np.ndarray | torch.Tensor | Image,
    image2: str | Path | np.ndarray | torch.Tensor | Image,
    K1: ArrayLike | Camera | Path | None = None,
    K2: ArrayLike | Camera | Path | None = None,
    *,
    matcher: Matcher | None = None,
    options: EstimationOptions | None = None,
) -> Trace:
    """As `estimate_relative_pose`, with the images, the map and the matches besides the pose."""
    start = time.perf_counter()
    first, second = load_image(image1, "image1"), load_image(image2, "image2")
    K, name = (K1, "K1") if K2 is None else (K2, "K2")
    camera1, camera2 = pair_cameras(K1, K, first, second, ("K1", name))
    matcher = load_matcher() if matcher is None else matcher
    load_seconds = time.perf_counter() - start
    return match_and_estimate(first, second, camera1, camera2, matcher, options, load_seconds)


def match_and_estimate(
    image1: Image,
    image2: Image,
    camera1: Camera,
    camera2: Camera,
    matcher: Matcher,
    options: EstimationOptions | None = None,
    load_seconds: float = 0.0,
    matched: Callable[[Matches], None] = lambda matches: None,
) -> Trace:
    """From images and cameras that are checked to the pose; the pose carries all warnings.

    load_seconds: what loading took, for `seconds` of the pose. matched: called with the matches
    before the pose is estimated.
    """
    options = EstimationOptions() if options is None else options
    check_type(options, EstimationOptions, "options")
    check_type(matcher, Matcher, "matcher")
    start = time.perf_counter()
    result = matcher.match(image1, image2)
    match_seconds = time.perf_counter() - start
    matched(result.matches)
    start = time.perf_counter()
    camera1, camera2 = with_orientation(camera1, image1), with_orientation(camera2, image2)
    pose, result = pose_of_result(matcher, image1, image2, result, camera1, camera2, options)
    seconds = {
        "load": load_seconds,
        "match": match_seconds,
        "estimate": time.perf_counter() - start,
    }
    pose = replace(pose, seconds=seconds)
    return Trace(
        image1,
        image2,
        pose.camera1 or camera1,
        pose.camera2 or camera2,
        camera1,
        camera2,
        result.correspondence_map,
        result.matches,
        pose,
    )


def pose_of_result(
    matcher: Matcher,
    image1: Image,
    image2: Image,
    result: MatchResult,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions,
) -> tuple[RelativePose, MatchResult]:
    """The pose of what a matcher made of two images, and the matches that it is of."""
    pose = pose_of_matches(
        result.matches, camera1, camera2, options, map_matches=result.map_matches
    )
    return search_again(matcher, image1, image2, result, pose, camera1, camera2, options)


def search_again(
    matcher: Matcher,
    image1: Image,
    image2: Image,
    result: MatchResult,
    pose: RelativePose,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions,
) -> tuple[RelativePose, MatchResult]:
    """A pose and a matcher's result that it is of, with more matches as long as it is in doubt.

    First those of images that are squeezed, then those near the epipolar lines of all hypotheses.
    They are pooled with those that are there, and the estimation begins anew.
    """

    def squeezed(result: MatchResult) -> MatchResult:
        return matcher.match_squeezed(image1, image2, result)

    def near_lines(result: MatchResult) -> MatchResult:
        models = [hypothesis.model for hypothesis in pose.hypotheses]
        views = [TwoViews(camera1, camera2, model.R, model.t) for model in models]
        return matcher.match_near(image1, image2, result, views)

    for search in (squeezed, near_lines):
        if in_doubt(pose, camera1, camera2) and (more := search(result)) is not result:
            result = more
            pose = pose_of_matches(
                result.matches, camera1, camera2, options, map_matches=result.map_matches
            )
    return pose, result


def in_doubt(pose: RelativePose, camera1: Camera, camera2: Camera) -> bool:
    """Whether more matches may change the answer: it is neither certain nor hopeless, and the lines
    on which they lie do not depend on a focal length that is itself a guess."""
    probability = pose.any_probability
    exact = not camera1.focal_std and not camera2.focal_std
    return exact and probability is not None and _HOPELESS < probability < _CERTAIN


def pose_of_matches(
    matches: Matches,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions,
    *,
    map_matches: Matches | None,
    fit_cameras: bool = True,
) -> RelativePose:
    """`estimate_pose` of what a matcher made of two images; the pose carries the warnings of the
    cameras too."""
    pose = estimate_pose(
        matches, camera1, camera2, options, map_matches=map_matches, fit_cameras=fit_cameras
    )
    warnings = (*camera1.warnings, *camera2.warnings, *pose.warnings)
    return replace(pose, warnings=tuple(dict.fromkeys(warnings)))
