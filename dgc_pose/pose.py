"""The pipeline on one page: images, matches, essential matrix, pose."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import with_orientation
from dgc_pose.cameras.two_views import TwoViews
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.options import Effort
from dgc_pose.estimation.result import percent_text
from dgc_pose.images.image import Image, load_image
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher, MatchResult
from dgc_pose.system.options import check_type
from dgc_pose.system.threads import in_threads
from dgc_pose.trace import Trace

if TYPE_CHECKING:
    import torch


# What is done for a pose, in this order, see `pose_of_pair`:
# - quick: a pass over small images, which is enough for an easy pair
# - fine: more accurate matches by the map of the quick pass, for a pose that is certain
# - match: all that `Matcher.match` does
# - mirrored: a quick pass over image 1 and the mirror image of image 2, which may end the search
# - squeezed: matches of images that are squeezed, pooled with those that are there
# - near: those near the epipolar lines of all hypotheses, likewise
Step = Literal["quick", "fine", "match", "mirrored", "squeezed", "near"]
_STEPS: Mapping[Effort, Sequence[Step]] = {
    "fast": ("quick", "match", "mirrored"),
    "auto": ("quick", "fine", "match", "mirrored", "squeezed", "near"),
    "thorough": ("match", "mirrored", "squeezed", "near"),
}
_HOPELESS, _CERTAIN = 0.005, 0.99  # probabilities beyond which no more is searched
_LIKELY = 0.95  # probability of a pose of the mirror image that counts
_ROUGHLY = 1.5  # standard deviations of a focal length that the matches suggest
_ACCURATE_DEG = 0.5  # expected errors below which the pose of a quick pass is kept
_LOOSE_DEG = 5.0  # and above which a pose that is certain is searched too


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
    named = (image1, "image1"), (image2, "image2")
    first, second = in_threads(lambda image: load_image(*image), named)
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

    load_seconds: what loading took, for `seconds` of the pose. matched: see `pose_of_pair`.
    """
    options = EstimationOptions() if options is None else options
    check_type(options, EstimationOptions, "options")
    check_type(matcher, Matcher, "matcher")
    camera1, camera2 = with_orientation(camera1, image1), with_orientation(camera2, image2)
    pose, result = pose_of_pair(matcher, image1, image2, camera1, camera2, options, matched=matched)
    pose = replace(pose, seconds={"load": load_seconds, **pose.seconds})
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


def pose_of_pair(
    matcher: Matcher,
    image1: Image,
    image2: Image,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions,
    *,
    whole: Callable[[], MatchResult] | None = None,
    matched: Callable[[Matches], None] = lambda matches: None,
) -> tuple[RelativePose, MatchResult]:
    """The pose of two images, and the matcher's result that it is of.

    The matcher does the steps of `options.effort` in turn, as long as they may change the answer,
    and a pose is estimated after each. `seconds` of the pose has those that changed the matches.

    whole: what does the step "match"; by default `matcher.match`. matched: called with the matches
    before each pose is estimated.
    """
    pose: RelativePose | None = None
    result: MatchResult | None = None
    seconds: dict[str, float] = {}
    estimating, start = 0.0, time.perf_counter()
    for step in _STEPS[options.effort]:
        if not _may_gain(step, pose, camera1, camera2, options.effort):
            continue
        more: MatchResult | None
        if step == "quick":
            more = matcher.match_quickly(image1, image2)
        elif step == "fine" and result is not None:
            more = matcher.match_finely(image1, image2, result)
        elif step == "match" or pose is None or result is None:
            more = whole() if whole else matcher.match(image1, image2)
        elif step == "mirrored":
            flipped = _of_mirror_image(matcher, image1, image2, camera1, camera2, options)
            if flipped is None or (flipped.probability or 0.0) < _LIKELY:
                continue
            pose = _mirrored(pose, flipped)
            break
        elif step == "squeezed":
            more = matcher.match_squeezed(image1, image2, result)
        else:
            models = [hypothesis.model for hypothesis in pose.hypotheses]
            views = [TwoViews(camera1, camera2, model.R, model.t) for model in models]
            more = matcher.match_near(image1, image2, result, views)
        if more is None or more is result:
            continue
        result = more
        end = time.perf_counter()
        seconds[step] = end - start
        matched(result.matches)
        pose = pose_of_matches(
            result.matches, camera1, camera2, options, map_matches=result.map_matches
        )
        start = time.perf_counter()
        estimating += start - end
    assert pose is not None and result is not None  # each effort has the step that always matches
    return replace(pose, seconds={**seconds, "estimate": estimating}), result


def _of_mirror_image(
    matcher: Matcher,
    image1: Image,
    image2: Image,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions,
) -> RelativePose | None:
    """The pose of image 1 and image 2 flipped left to right, by a quick pass; None without one."""
    flipped = replace(image2, pixels=np.ascontiguousarray(image2.pixels[:, ::-1]))
    result = matcher.match_quickly(image1, flipped)
    if result is None:
        return None
    K = camera2.K.copy()
    K[0, 1:] = -K[0, 1], image2.size[0] - 1 - K[0, 2]
    cameras = camera1, replace(camera2, K=K)
    return estimate_pose(result.matches, *cameras, options, map_matches=result.map_matches)


def _mirrored(pose: RelativePose, flipped: RelativePose) -> RelativePose:
    """That there is no pose, since the mirror image of image 2 has a likely one."""
    reason = (
        f"the mirror image of image 2 has a pose, {percent_text(flipped.probability or 0.0)} "
        "probable, and image 2 has none that is as likely"
    )
    inliers = np.zeros_like(pose.inliers)
    return RelativePose("mirrored", reason, inliers, pose.num_matches, warnings=pose.warnings)


def _may_gain(
    step: Step, pose: RelativePose | None, camera1: Camera, camera2: Camera, effort: Effort
) -> bool:
    """Whether a step may change the answer. pose: after the steps before it, if there is one.

    Cameras that are not exact skip all but the whole: what a few matches tell of a focal length is
    less than what many tell, and lines that depend on it say little.
    """
    exact = not camera1.focal_std and not camera2.focal_std
    if step == "quick":
        return exact
    if pose is None:
        return step == "match"
    if step == "fine":
        return certain(pose) and not (accurate(pose) and right_cameras(pose))
    if step == "match":
        return effort != "fast" and not certain(pose)
    if step == "mirrored":
        return (pose.probability or 0.0) < _LIKELY and pose.status != "rotation_only"
    limit_deg = _ACCURATE_DEG if effort == "thorough" else _LOOSE_DEG
    return exact and (in_doubt(pose) or (pose.success and not accurate(pose, limit_deg)))


def certain(pose: RelativePose) -> bool:
    """Whether it is nearly certain that the pose is right."""
    return pose.success and (pose.probability or 0.0) >= _CERTAIN


def accurate(pose: RelativePose, limit_deg: float = _ACCURATE_DEG) -> bool:
    """Whether the expected errors of the pose are known, and below a limit."""
    errors = pose.rotation_error_90_deg, pose.translation_error_90_deg
    return all(error is not None and error < limit_deg for error in errors)


def right_cameras(pose: RelativePose) -> bool:
    """Whether the matches suggest the focal lengths that the cameras have, roughly. If they do not,
    it takes many matches to tell a wrong K from a right one."""
    evidence = pose.evidence
    if evidence is None or evidence.focal_ratio is None or evidence.focal_ratio_std is None:
        return evidence is not None
    return abs(math.log(evidence.focal_ratio)) < _ROUGHLY * evidence.focal_ratio_std


def in_doubt(pose: RelativePose) -> bool:
    """Whether more matches may change the answer: it is neither certain nor hopeless."""
    probability = pose.any_probability
    if probability is not None and pose.status == "rotation_only":
        probability *= 1 - pose.hypotheses[0].share  # of another motion than that
    return probability is not None and _HOPELESS < probability < _CERTAIN


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
