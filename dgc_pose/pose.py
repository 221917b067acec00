"""The pipeline on one page: images, matches, essential matrix, pose."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.focal_check import AGREEING_LOG_FOCAL
from dgc_pose.estimation.options import Effort
from dgc_pose.estimation.scale import ScaleSource, with_length
from dgc_pose.estimation.status import percent_text
from dgc_pose.images.image import Image, flipped, load_image
from dgc_pose.images.mask import masked
from dgc_pose.matchers import load_matcher
from dgc_pose.matching import DEFAULT_WEIGHTS, Matcher, MatchResult, PairSearch
from dgc_pose.system.options import check_type
from dgc_pose.system.threads import in_threads
from dgc_pose.trace import Trace

if TYPE_CHECKING:
    import torch

    ImageSource = str | Path | np.ndarray | torch.Tensor | Image
    MaskSource = str | Path | ArrayLike | None
    CameraSource = ArrayLike | Camera | Path | None
    MatcherSource = Matcher | str | Path | None

# What is done for a pose, in this order, see `pose_of_pair`:
# - quick: a pass over small images, which is enough for an easy pair
# - fine: more accurate matches by the map of the quick pass, for a pose that is certain
# - match: all that `Matcher.match` does
# - mirrored: a quick pass over image 1 and the mirror image of image 2, which may end the search
# - more: matches of squeezed images and near epipolar lines, pooled with those that are there
Step = Literal["quick", "fine", "match", "mirrored", "more"]
_STEPS: Mapping[Effort, Sequence[Step]] = {
    "fast": ("quick", "match", "mirrored"),
    "auto": ("quick", "fine", "match", "mirrored", "more"),
    "thorough": ("match", "mirrored", "more"),
}
# Probabilities that a pose or an alternative is right beyond which no more is searched, and the
# share of the pose that this needs.
_MIN_SEARCHED, _MAX_SEARCHED, _CLEAR_SHARE = 0.005, 0.99, 0.95
# Image 2 is mirrored if its mirror image has a pose that is so probable, and no less than its own.
_LIKELY = 0.9
# It is not if its own is so probable, and the median epipolar error below this share of the
# threshold: a scene that is nearly its mirror image does not fit as closely.
_CLOSE = 0.1
_FOCAL_AGREES_STD = 1.0  # standard deviations between the focal lengths of K and of the matches
_ACCURATE_DEG = 1.0  # expected errors below which the pose of a quick pass is kept
_LOOSE_DEG = 5.0  # and above which a pose that is certain is searched too


@overload
def estimate_relative_pose(
    image1: ImageSource,
    image2: ImageSource,
    K1: CameraSource = None,
    K2: CameraSource = None,
    *,
    fov: float | None = None,
    matcher: MatcherSource = None,
    options: EstimationOptions | None = None,
    mask1: MaskSource = None,
    mask2: MaskSource = None,
    scale: ScaleSource | None = None,
    trace: Literal[False] = False,
) -> RelativePose: ...


@overload
def estimate_relative_pose(
    image1: ImageSource,
    image2: ImageSource,
    K1: CameraSource = None,
    K2: CameraSource = None,
    *,
    fov: float | None = None,
    matcher: MatcherSource = None,
    options: EstimationOptions | None = None,
    mask1: MaskSource = None,
    mask2: MaskSource = None,
    scale: ScaleSource | None = None,
    trace: Literal[True],
) -> Trace: ...


def estimate_relative_pose(
    image1: ImageSource,
    image2: ImageSource,
    K1: CameraSource = None,
    K2: CameraSource = None,
    *,
    fov: float | None = None,
    matcher: MatcherSource = None,
    options: EstimationOptions | None = None,
    mask1: MaskSource = None,
    mask2: MaskSource = None,
    scale: ScaleSource | None = None,
    trace: bool = False,
) -> RelativePose | Trace:
    """The pose of camera 2 relative to camera 1: x2 = R x1 + t, translation up to scale. It is of
    the upright images: an EXIF orientation is applied.

    image1, image2: paths, arrays (H, W[, 3]) in RGB order, or tensors. K1, K2: 3x3 matrices in
    pixels of those images, (0, 0) the centre of the top-left pixel, or fx, fy, cx, cy; or
    `Camera`s, which may have lens distortion; or texts and files as of --K. Without K2, K1 serves
    for both. fov: in place of a K, the horizontal field of view of both images, degrees.
    matcher: by default `load_matcher()`, the shipped network with refinement; a name is loaded for
    this pair. trace: whether to return a `Trace`, which has images, map and matches too. scale:
    what determines the length of t. Without a pose, `success` is False and `reason` says why.

    mask1, mask2: paths, or arrays (H, W), of the stored pixels: where 0, black or of alpha 0,
    nothing is matched. A mask of another size is scaled, if its aspect ratio is that of the image.

    A K that is not known is None or "auto"; for K2 alone "auto". The matches determine the focal
    length then: see `K1`, `K2`, `focal_std1` and `focal_std2` of the pose. One camera took both
    images if their sizes and EXIF data agree; "auto:shared" and "auto:two" state it instead.

    Raises ImageError if an image cannot be read, InputError (a ValueError) if another argument is
    unusable, WeightsError if the network's weights cannot be loaded.

    >>> pose = estimate_relative_pose("1.jpg", "2.jpg", K)  # doctest: +SKIP
    >>> pose.success, pose.R, pose.t  # doctest: +SKIP
    """
    start = time.perf_counter()
    named = (image1, "image1"), (image2, "image2")
    first, second = in_threads(lambda image: load_image(*image), named)
    first, second = masked(first, mask1, "mask1"), masked(second, mask2, "mask2")
    K, name = (K1, "K1") if K2 is None else (K2, "K2")
    prior1, prior2 = pair_cameras(K1, K, first, second, ("K1", name), fov=fov)
    options = EstimationOptions() if options is None else options
    check_type(options, EstimationOptions, "options")
    check_type(matcher, Matcher | str | Path | None, "matcher")
    matcher = DEFAULT_WEIGHTS if matcher is None else matcher
    matcher = load_matcher(matcher) if isinstance(matcher, str | Path) else matcher
    scale = ScaleSource() if scale is None else scale
    check_type(scale, ScaleSource, "scale")
    maps = scale.maps((first, second))
    load_seconds = time.perf_counter() - start

    search = matcher.search(first, second)
    pose = pose_of_pair(search, prior1, prior2, options)
    pose = with_length(pose, search.last.matches, scale, maps)
    pose = replace(pose, seconds={"load": load_seconds, **pose.seconds})
    return Trace.of(search, prior1, prior2, pose) if trace else pose


def pose_of_pair(
    search: PairSearch, camera1: Camera, camera2: Camera, options: EstimationOptions
) -> RelativePose:
    """The pose of the two images of a search, of the matches in `search.last`.

    The steps of `options.effort` are done in turn, as long as they may change the answer, and a
    pose is estimated after each. `seconds` of the pose has those that changed the matches.
    """
    pose: RelativePose | None = None
    seconds: dict[str, float] = {}
    estimating = 0.0
    for step in _STEPS[options.effort]:
        if not _may_change(step, pose, camera1, camera2, options.effort):
            continue
        start = time.perf_counter()
        if step == "mirrored":
            assert pose is not None  # a step before has one
            probability = _mirror_image_probability(search, pose, camera1, camera2, options)
            if probability < max(_LIKELY, pose.any_probability or 0.0):
                continue
            reason = (
                f"the mirror image of image 2 has a pose, {percent_text(probability)} probable, "
                "and image 2 has none that is as likely"
            )
            inliers = np.zeros_like(pose.inliers)
            pose = RelativePose(
                "mirrored", reason, inliers, pose.num_matches, warnings=pose.warnings
            )
            break
        result = _matches_of(step, search, pose, camera1, camera2)
        if result is None:
            continue
        matched = time.perf_counter()
        pose = estimate_pose(
            result.matches, camera1, camera2, options, map_matches=result.map_matches
        )
        seconds[step] = matched - start
        estimating += time.perf_counter() - matched
    assert pose is not None  # each effort has the step that always matches
    return replace(pose, seconds={**seconds, "estimate": estimating})


def _matches_of(
    step: Step, search: PairSearch, pose: RelativePose | None, camera1: Camera, camera2: Camera
) -> MatchResult | None:
    """The matches of a step; None if it has no others than those that are there."""
    if step == "quick":
        return search.quick()
    if step == "fine":
        return search.fine()
    if step == "match" or pose is None:
        return search.whole()
    return search.more([TwoViews(camera1, camera2, h.R, h.t) for h in pose.hypotheses])


def _mirror_image_probability(
    search: PairSearch,
    pose: RelativePose,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions,
) -> float:
    """The probability of the pose of image 1 and image 2 flipped left to right, or top to bottom if
    its pose is upside down, by a quick pass; 0 without one."""
    flips = bool(pose.hypotheses) and pose.hypotheses[0].R[1, 1] < 0
    image2 = flipped(search.image2, 0 if flips else 1)
    result = search.matcher.search(search.image1, image2).quick()
    search.matcher.forget(image2)  # no other pair has it
    if result is None:
        return 0.0
    K = camera2.K.copy()
    if flips:
        K[:2, 1:] = [[-K[0, 1], K[0, 2]], [K[1, 1], image2.size[1] - 1 - K[1, 2]]]
    else:
        K[0, 1:] = -K[0, 1], image2.size[0] - 1 - K[0, 2]
    cameras = camera1, replace(camera2, K=K)
    pose = estimate_pose(result.matches, *cameras, options, map_matches=result.map_matches)
    return (pose.probability or 0.0) if pose.success else 0.0


def _may_change(
    step: Step, pose: RelativePose | None, camera1: Camera, camera2: Camera, effort: Effort
) -> bool:
    """Whether a step may change the answer. pose: after the steps before it, if there is one.

    Cameras that are not exact skip all but the whole: few matches determine a focal length less
    than many do, and epipolar lines that depend on it narrow nothing down.
    """
    exact = camera1.exact and camera2.exact
    if step == "quick":
        return exact
    if pose is None:
        return step == "match"
    if step == "fine":
        return certain(pose) and not (accurate(pose) and focal_agrees(pose))
    if step == "match":
        return effort != "fast" and not certain(pose)
    if step == "mirrored":
        likely = pose.any_probability
        if likely is None or pose.status in ("rotation_only", "same_picture"):
            return False
        return likely < _LIKELY or pose.evidence is None or pose.evidence.residual >= _CLOSE
    limit_deg = _ACCURATE_DEG if effort == "thorough" else _LOOSE_DEG
    return exact and (in_doubt(pose) or (pose.success and not accurate(pose, limit_deg)))


def certain(pose: RelativePose) -> bool:
    """Whether it is nearly certain that the pose is right."""
    return pose.success and _is_clear(pose)


def _is_clear(pose: RelativePose) -> bool:
    """Whether a hypothesis is nearly certain to be right, and which one."""
    likely = (pose.any_probability or 0.0) >= _MAX_SEARCHED
    return likely and pose.hypotheses[0].share >= _CLEAR_SHARE


def accurate(pose: RelativePose, limit_deg: float = _ACCURATE_DEG) -> bool:
    """Whether the expected errors of the pose are known, and below a limit."""
    errors = pose.rotation_error_90_deg, pose.translation_error_90_deg
    return all(error is not None and error < limit_deg for error in errors)


def focal_agrees(pose: RelativePose) -> bool:
    """Whether the matches suggest roughly the focal lengths that the cameras have. If they do not,
    it takes many matches to distinguish a wrong K from a right one."""
    if pose.evidence is None:
        return False
    check = pose.evidence.focal_check
    most = 0.0 if check is None else max(AGREEING_LOG_FOCAL, _FOCAL_AGREES_STD * check.std)
    return check is None or abs(math.log(check.factor)) < most


def in_doubt(pose: RelativePose) -> bool:
    """Whether more matches may change the answer: it is neither certain nor hopeless."""
    likely = pose.any_probability
    if likely is None or not pose.hypotheses:
        return False
    share = pose.hypotheses[0].share
    of_others = likely * (1 - share) if pose.status == "rotation_only" else likely
    return of_others > _MIN_SEARCHED and not _is_clear(pose)
