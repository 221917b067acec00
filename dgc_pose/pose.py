"""The pipeline on one page: images, matches, essential matrix, pose; and its result."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.options import Effort
from dgc_pose.estimation.scale import ScaleSource, with_length
from dgc_pose.geometry.epipolar import depths, homogeneous
from dgc_pose.images.image import Image, load_pair
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import DEFAULT_WEIGHTS, CorrespondenceMap, Matcher, MatchResult
from dgc_pose.metrics import epipolar_residuals_px
from dgc_pose.mirror import if_mirrored
from dgc_pose.system.options import check_type
from dgc_pose.system.parallel import one_blas_thread

if TYPE_CHECKING:
    from dgc_pose.images.image import ImageSource, MaskSource

    CameraSource = ArrayLike | Camera | Path | None
    MatcherSource = Matcher | str | Path | None

# The steps of each effort, in order. A step that the matcher lacks is skipped.
# - coarse: a pass over small images, which is enough for an easy pair
# - refine: more accurate matches from the map of the coarse step, for a pose that is certain
# - full: `Matcher.match`
# - guided: matches of squeezed images and near epipolar lines, pooled with the matches so far
# - second: the matches of a second matcher, pooled as well; the likelier pose stays
Step = Literal["coarse", "refine", "full", "guided", "second"]
STEPS: Mapping[Effort, Sequence[Step]] = {
    "fast": ("coarse", "full"),
    "auto": ("coarse", "refine", "full", "guided", "second"),
    "thorough": ("full", "guided", "second"),
}
# The search for matches ends if all hypotheses together are less probable than the first number;
# or if they are at least as probable as the second and the likeliest has the third as its share.
_MIN_SEARCHED = 0.005
_MAX_SEARCHED = 0.99
_CLEAR_SHARE = 0.95
# Statuses without a pose that further matches hardly change.
_FINAL = ("rotation_only", "mirrored", "same_picture", "panorama")
_DOUBT = -1.0  # log-odds of another camera given the matches, above which they are refined
_ACCURATE_DEG = 1.0  # expected errors below which the pose of a coarse pass is kept
_LOOSE_DEG = 5.0  # expected errors above which `auto` runs "guided" even for a certain pose


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
    """The pose of camera 2 relative to camera 1: x2 = R x1 + t, translation up to scale. It holds
    for the upright images: an EXIF orientation is applied.

    image1, image2: paths, arrays (H, W[, 3]) in RGB order, or tensors. K1, K2: 3x3 matrices in
    pixels of these images, with (0, 0) at the centre of the top-left pixel; fx, fy, cx, cy;
    `Camera`s, which may have lens distortion; or any text or file that --K takes. Without K2, K1
    serves for both. fov: in place of a K, the horizontal field of view of both images, degrees.
    matcher: by default `load_matcher()`, the shipped network with refinement; a matcher given by
    name is loaded for each call. scale: determines the length of t. Without a pose, `success` is
    False and `reason` states why. `solve_pair` also returns the map and the matches.

    mask1, mask2: paths, or arrays (H, W), of the stored pixels. Pixels that are 0, black or of
    alpha 0 are not matched. A mask of another size is scaled if it has the image's aspect ratio.

    An unknown K is None or "auto"; an unknown K2 beside a known K1 is "auto". The matches then
    determine the focal length: see `K1`, `K2`, `focal_std1` and `focal_std2` of the pose. One
    camera took both images if sizes and EXIF data agree; "auto:shared" or "auto:two" overrides it.

    Raises ImageError if an image cannot be read, InputError (a ValueError) if another argument is
    unusable, WeightsError if the network's weights cannot be loaded.

    >>> pose = estimate_relative_pose("1.jpg", "2.jpg", K)  # doctest: +SKIP
    >>> pose.success, pose.R, pose.t  # doctest: +SKIP
    """
    start = time.perf_counter()
    first, second = load_pair((image1, image2), (mask1, mask2))
    K, name = (K1, "K1") if K2 is None else (K2, "K2")
    cameras = pair_cameras(K1, K, first, second, ("K1", name), fov=fov)
    check_type(matcher, Matcher | str | Path | None, "matcher")
    matcher = DEFAULT_WEIGHTS if matcher is None else matcher
    matcher = load_matcher(matcher) if isinstance(matcher, str | Path) else matcher
    return solve_pair(first, second, cameras, matcher, options, scale, start=start).pose


@one_blas_thread()
def solve_pair(
    image1: Image,
    image2: Image,
    cameras: tuple[Camera, Camera],
    matcher: Matcher,
    options: EstimationOptions | None = None,
    scale: ScaleSource | None = None,
    *,
    start: float | None = None,
) -> PairResult:
    """The pose of two images, with its matches.

    cameras: of images 1 and 2, from `pair_cameras`. Each step of `options.effort` runs if it may
    change the answer; a pose is estimated after each. `pose.seconds` contains the steps that gave
    matches, the search of a second matcher, and "load" if `start` is given: the
    `time.perf_counter()` at which loading began. Raises InputError for an argument of the wrong
    type, for a depth map that cannot be read, and if the images have no marker in common.
    """
    begun = time.perf_counter()
    options = EstimationOptions() if options is None else options
    scale = ScaleSource() if scale is None else scale
    for value, kind, name in (
        *((image1, Image, "image1"), (image2, Image, "image2"), (matcher, Matcher, "matcher")),
        *((cameras, tuple[Camera, Camera], "cameras"), (scale, ScaleSource, "scale")),
        (options, EstimationOptions, "options"),
    ):
        check_type(value, kind, name)
    maps = scale.maps((image1, image2))
    markers = scale.markers((image1, image2))
    pose: RelativePose | None = None
    coarse: RelativePose | None = None
    found: MatchResult | None = None
    seconds = {} if start is None else {"load": begun - start}
    estimating = 0.0
    # Steps that need the matches of an earlier one come after it. Each effort has the step "full".
    matching: dict[Step, Callable[[], MatchResult | None]] = {
        "coarse": lambda: matcher.coarse(image1, image2),
        "refine": lambda: found and matcher.refined(image1, image2, found),
        "full": lambda: matcher.match(image1, image2),
        "guided": lambda: found and matcher.guided(image1, image2, found, _views(pose, cameras)),
        "second": lambda: found and matcher.second(image1, image2, found),
    }
    for step in STEPS[options.effort]:
        if not may_change(step, pose, options):
            continue
        before = time.perf_counter()
        result = matching[step]()
        if result is None:
            continue
        matched = time.perf_counter()
        seconds[step] = matched - before
        if result is found:  # nothing was added
            continue
        again = estimate_pose(result.matches, *cameras, options, map_matches=result.map_matches)
        estimating += time.perf_counter() - matched
        if step == "second" and _is_likelier(pose, again):
            continue
        found = result
        pose = again
        if step == "coarse":
            coarse = pose
    assert pose is not None and found is not None
    verdict = if_mirrored(image1, image2, cameras, matcher, options, found.matches, pose, coarse)
    pose = pose if verdict is None else verdict
    pose = with_length(pose, found.matches, scale, maps, markers)
    pose = replace(pose, seconds={**seconds, "estimate": estimating})
    return PairResult(image1, image2, *cameras, found.matches, found.correspondence_map, pose)


def _views(pose: RelativePose | None, cameras: tuple[Camera, Camera]) -> list[TwoViews]:
    assert pose is not None
    return [TwoViews(*(pose.cameras or cameras), h.R, h.t) for h in pose.hypotheses]


def may_change(step: Step, pose: RelativePose | None, options: EstimationOptions) -> bool:
    """Whether a step may change the answer. pose: after the steps before it; None if there is none.

    The few matches of a coarse pass hardly distinguish a wrong camera from the right one: they are
    refined if the pose depends on the camera.
    """
    if pose is None:
        return step in ("coarse", "full")
    is_certain = pose.success and _is_clear(pose)
    if step == "refine":
        return is_certain and not (_is_accurate(pose, _ACCURATE_DEG) and _agrees_on_cameras(pose))
    if step == "full":
        return options.effort != "fast" and not is_certain
    if step == "second":
        return wants_second(options) and (in_doubt(pose) or is_open(pose))
    limit_deg = _ACCURATE_DEG if options.effort == "thorough" else _LOOSE_DEG
    return in_doubt(pose) or (pose.success and not _is_accurate(pose, limit_deg))


def _is_clear(pose: RelativePose) -> bool:
    """Whether some hypothesis is nearly certainly right, and this is clearly the first one."""
    likely = (pose.any_probability or 0.0) >= _MAX_SEARCHED
    return likely and pose.hypotheses[0].share >= _CLEAR_SHARE


def _is_accurate(pose: RelativePose, limit_deg: float) -> bool:
    """Whether the expected errors of the pose are known and below a limit."""
    errors = pose.rotation_error_90_deg, pose.translation_error_90_deg
    return all(error is not None and error < limit_deg for error in errors)


def _agrees_on_cameras(pose: RelativePose) -> bool:
    """Whether the assumed cameras fit best, and other likely cameras give nearly the same pose."""
    evidence = pose.evidence
    if evidence is None or evidence.camera_model != "assumed":
        return False
    return evidence.camera_agreement >= _MAX_SEARCHED and evidence.camera_doubt < _DOUBT


def in_doubt(pose: RelativePose) -> bool:
    """Whether more matches may change the answer: the pose is neither certain nor hopeless."""
    likely = pose.any_probability
    if likely is None or not pose.hypotheses:
        return False
    share = pose.hypotheses[0].share
    likely_others = likely * (1 - share) if pose.status == "rotation_only" else likely
    return likely_others > _MIN_SEARCHED and not _is_clear(pose)


def _is_likelier(pose: RelativePose | None, other: RelativePose) -> bool:
    """Whether a pose is more probable than another; unknown probabilities count as 0."""
    return pose is not None and (pose.probability or 0.0) > (other.probability or 0.0)


def wants_second(options: EstimationOptions) -> bool:
    """Whether the steps of a pair include a second matcher."""
    return options.second == "auto" and "second" in STEPS[options.effort]


def is_open(pose: RelativePose) -> bool:
    """Whether there is no pose, and a second matcher may find one."""
    return not (pose.success or pose.status in _FINAL)


def is_hopeless(pose: RelativePose) -> bool:
    """Whether the matches hardly leave a chance of a right pose, as those of unrelated images."""
    return pose.any_probability is not None and pose.any_probability <= _MIN_SEARCHED


@dataclass(frozen=True, eq=False)
class PairResult:
    """The result of `solve_pair`: a pose with everything that it was computed from.

    Attributes:
        image1: Image 1.
        image2: Image 2.
        prior1: Camera of image 1 before the estimation: as stated, from EXIF data or assumed.
        prior2: Camera of image 2 before the estimation.
        matches: The N matches that the pose was estimated from.
        correspondence_map: The dense map; None for a matcher without one.
        pose: The pose, or why there is none.
    """

    image1: Image
    image2: Image
    prior1: Camera
    prior2: Camera
    matches: Matches
    correspondence_map: CorrespondenceMap | None
    pose: RelativePose

    def __repr__(self) -> str:
        return f"PairResult: {self.image1}, {self.image2}\n{self.matches}\n{self.pose}"

    @property
    def camera1(self) -> Camera:
        """Camera of image 1 that belongs to the pose; without a pose, `prior1`."""
        return self.pose.camera1 or self.prior1

    @property
    def camera2(self) -> Camera:
        """Camera of image 2 that belongs to the pose; without a pose, `prior2`."""
        return self.pose.camera2 or self.prior2

    @property
    def points3d(self) -> np.ndarray:
        """The points (N, 3) float64 of the matches in camera 1's frame (OpenCV axes), in metres if
        the length of t is known, else in units of the distance between the cameras. A point lies on
        the ray of camera 1, where the ray of camera 2 comes nearest.

        NaN for outliers and for points not in front of both cameras; all NaN without R and t.
        """
        points = np.full((len(self.matches), 3), np.nan)
        R = self.pose.R
        t = self.pose.t
        inliers = self.pose.inliers
        if R is None or t is None:
            return points
        x1 = self.camera1.normalise(self.matches.points1[inliers])
        x2 = self.camera2.normalise(self.matches.points2[inliers])
        depth1, depth2 = depths(x1, x2, R, t * (self.pose.length or 1.0))
        ahead = (depth1 > 0) & (depth2 > 0) & np.isfinite(depth1)
        points[inliers] = homogeneous(x1) * np.where(ahead, depth1, np.nan)[:, None]
        return points

    @property
    def colours(self) -> np.ndarray:
        """Colours (N, 3) uint8 RGB of the pixels of image 1 nearest to the matches; black where the
        match is not finite."""
        points = self.matches.points1
        finite = np.isfinite(points).all(1)
        last = np.array(self.image1.size) - 1
        x, y = np.rint(np.clip(np.where(finite[:, None], points, 0), 0, last)).astype(np.intp).T
        return self.image1.pixels[y, x] * finite[:, None].astype(np.uint8)

    @property
    def residuals_px(self) -> np.ndarray:
        """Symmetric epipolar distances (N,) of the matches, in pixels without lens distortion: the
        mean distance of the two points of a match to their epipolar lines.

        NaN without R and t, and where the distortion cannot be undone.
        """
        if self.pose.E is None:
            return np.full(len(self.matches), np.nan)
        points = self.matches.points1, self.matches.points2
        return epipolar_residuals_px(*points, self.camera1, self.camera2, self.pose.E)
