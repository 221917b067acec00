"""The pipeline on one page: images, matches, essential matrix, pose."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.scale import ScaleSource, with_length
from dgc_pose.estimation.status import percent_text
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.image import Image, flipped, load_image
from dgc_pose.images.maps import masked
from dgc_pose.matchers import load_matcher
from dgc_pose.matching import DEFAULT_WEIGHTS, Matcher, MatchResult
from dgc_pose.pair_result import PairResult
from dgc_pose.schedule import LIKELY, STEPS, may_change
from dgc_pose.system.options import check_type
from dgc_pose.system.parallel import in_threads, one_blas_thread

if TYPE_CHECKING:
    import torch

    ImageSource = str | Path | np.ndarray | torch.Tensor | Image
    MaskSource = str | Path | ArrayLike | None
    CameraSource = ArrayLike | Camera | Path | None
    MatcherSource = Matcher | str | Path | None


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
) -> RelativePose:
    """The pose of camera 2 relative to camera 1: x2 = R x1 + t, translation up to scale. It is of
    the upright images: an EXIF orientation is applied.

    image1, image2: paths, arrays (H, W[, 3]) in RGB order, or tensors. K1, K2: 3x3 matrices in
    pixels of those images, (0, 0) the centre of the top-left pixel, or fx, fy, cx, cy; or
    `Camera`s, which may have lens distortion; or texts and files as of --K. Without K2, K1 serves
    for both. fov: in place of a K, the horizontal field of view of both images, degrees.
    matcher: by default `load_matcher()`, the shipped network with refinement; a name is loaded for
    this pair. scale: what determines the length of t. Without a pose, `success` is False and
    `reason` says why. `solve_pair` returns the map and the matches too.

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
    cameras = pair_cameras(K1, K, first, second, ("K1", name), fov=fov)
    check_type(matcher, Matcher | str | Path | None, "matcher")
    matcher = DEFAULT_WEIGHTS if matcher is None else matcher
    matcher = load_matcher(matcher) if isinstance(matcher, str | Path) else matcher
    load_seconds = time.perf_counter() - start
    pose = solve_pair(first, second, cameras, matcher, options, scale).pose
    return replace(pose, seconds={"load": load_seconds, **pose.seconds})


@one_blas_thread()
def solve_pair(
    image1: Image,
    image2: Image,
    cameras: tuple[Camera, Camera],
    matcher: Matcher,
    options: EstimationOptions | None = None,
    scale: ScaleSource | None = None,
) -> PairResult:
    """The pose of two images, with the matches that it is of.

    cameras: of image 1 and of image 2, as `pair_cameras` gives them. The steps of `options.effort`
    (`schedule.py`) are done in turn, as long as they may change the answer, and a pose is estimated
    after each. `seconds` of the pose has those that changed the matches. Raises InputError for an
    argument of another type, and for a depth map that cannot be read.
    """
    options = EstimationOptions() if options is None else options
    scale = ScaleSource() if scale is None else scale
    for value, kind, name in (
        *((image1, Image, "image1"), (image2, Image, "image2"), (matcher, Matcher, "matcher")),
        *((cameras, tuple[Camera, Camera], "cameras"), (scale, ScaleSource, "scale")),
        (options, EstimationOptions, "options"),
    ):
        check_type(value, kind, name)
    depths, markers = scale.maps((image1, image2)), scale.markers((image1, image2))
    pose, found = None, None
    seconds: dict[str, float] = {}
    estimating = 0.0
    for step in STEPS[options.effort]:
        if not may_change(step, pose, options.effort):
            continue
        start = time.perf_counter()
        if step == "full":
            result: MatchResult | None = matcher.match(image1, image2)
        elif step == "coarse":
            result = matcher.coarse(image1, image2)
        else:  # all others follow one of these
            assert pose is not None and found is not None
            if step == "mirrored":
                mirrored = _mirrored(image1, image2, cameras, matcher, pose, options)
                if mirrored is None:
                    continue
                pose = mirrored
                break
            if step == "refine":
                result = matcher.refined(image1, image2, found)
            else:
                of_pose = pose.cameras or cameras
                hypotheses = [TwoViews(*of_pose, h.R, h.t) for h in pose.hypotheses]
                result = matcher.guided(image1, image2, found, hypotheses)
        if result is None:
            continue
        matched = time.perf_counter()
        found = result
        pose = estimate_pose(found.matches, *cameras, options, map_matches=found.map_matches)
        seconds[step] = matched - start
        estimating += time.perf_counter() - matched
    assert pose is not None and found is not None  # each effort has the full step
    pose = with_length(pose, found.matches, scale, depths, markers)
    pose = replace(pose, seconds={**seconds, "estimate": estimating})
    return PairResult(image1, image2, *cameras, found.matches, found.correspondence_map, pose)


def _mirrored(
    image1: Image,
    image2: Image,
    cameras: tuple[Camera, Camera],
    matcher: Matcher,
    pose: RelativePose,
    options: EstimationOptions,
) -> RelativePose | None:
    """The refusal of image 2 as a mirror image, if its mirror image has a likely pose by a coarse
    pass, no less probable than its own; None if it has none.

    The mirror image is flipped left to right, or top to bottom if the pose is upside down.
    """
    flips = bool(pose.hypotheses) and pose.hypotheses[0].R[1, 1] < 0
    mirror_image = flipped(image2, 0 if flips else 1)
    result = matcher.coarse(image1, mirror_image)
    matcher.forget(mirror_image)  # no other pair has it
    if result is None:
        return None
    try:
        second = cameras[1].turned(exif_turn(4 if flips else 2), image2.size)
    except InputError:  # a lens that is not turned
        return None
    of_mirror_image = estimate_pose(
        result.matches, cameras[0], second, options, map_matches=result.map_matches
    )
    probability = (of_mirror_image.one_place_probability or 0.0) if of_mirror_image.success else 0.0
    if probability < max(LIKELY, pose.any_probability or 0.0):
        return None
    reason = (
        f"the mirror image of image 2 has a pose, {percent_text(probability)} probable, "
        "and image 2 has none that is as likely"
    )
    inliers = np.zeros_like(pose.inliers)
    return RelativePose("mirrored", reason, inliers, pose.num_matches, warnings=pose.warnings)
