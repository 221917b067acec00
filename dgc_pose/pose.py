"""The pipeline on one page: images, matches, essential matrix, pose; and its whole result."""

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
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.options import Effort
from dgc_pose.estimation.scale import ScaleSource, with_length
from dgc_pose.estimation.status import percent_text
from dgc_pose.geometry.epipolar import depths, homogeneous
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.image import Image, flipped, load_pair
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import DEFAULT_WEIGHTS, CorrespondenceMap, Matcher, MatchResult
from dgc_pose.metrics import epipolar_residuals_px
from dgc_pose.system.options import check_type
from dgc_pose.system.parallel import one_blas_thread

if TYPE_CHECKING:
    from dgc_pose.images.image import ImageSource, MaskSource

    CameraSource = ArrayLike | Camera | Path | None
    MatcherSource = Matcher | str | Path | None

# What is done for a pose, in this order, as far as the matcher has the step:
# - coarse: a pass over small images, which is enough for an easy pair
# - refine: more accurate matches by the map of the coarse step, for a pose that is certain
# - full: all that `Matcher.match` does
# - guided: matches of squeezed images and near epipolar lines, pooled with those that are there
Step = Literal["coarse", "refine", "full", "guided"]
STEPS: Mapping[Effort, Sequence[Step]] = {
    "fast": ("coarse", "full"),
    "auto": ("coarse", "refine", "full", "guided"),
    "thorough": ("full", "guided"),
}
# Probabilities that a pose or an alternative is right beyond which no more is searched, and the
# share of the pose that this needs.
_MIN_SEARCHED, _MAX_SEARCHED, _CLEAR_SHARE = 0.005, 0.99, 0.95
# Image 2 is mirrored if its mirror image has a pose that is so probable, and no less than its own.
_LIKELY = 0.9
_DOUBT = -1.0  # log-odds of another camera by the matches, which more of them confirm or not
_ACCURATE_DEG = 1.0  # expected errors below which the pose of a coarse pass is kept
_LOOSE_DEG = 5.0  # and above which a pose that is certain is searched too


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
    """The pose of two images, with the matches that it is of.

    cameras: of image 1 and of image 2, as `pair_cameras` gives them. The steps of `options.effort`
    are done in turn, as long as they may change the answer, and a pose is estimated after each.
    `seconds` of the pose has those that changed the matches. start: by `time.perf_counter()`, from
    which on "load" is counted among them. Raises InputError for an argument of another type, and
    for a depth map that cannot be read.
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
    maps, markers = scale.maps((image1, image2)), scale.markers((image1, image2))
    pose: RelativePose | None = None
    found: MatchResult | None = None
    seconds = {} if start is None else {"load": begun - start}
    estimating = 0.0
    # Those that refine what is found follow a step that finds: each effort has the full one.
    matching: dict[Step, Callable[[], MatchResult | None]] = {
        "coarse": lambda: matcher.coarse(image1, image2),
        "refine": lambda: found and matcher.refined(image1, image2, found),
        "full": lambda: matcher.match(image1, image2),
        "guided": lambda: found and matcher.guided(image1, image2, found, _views(pose, cameras)),
    }
    for step in STEPS[options.effort]:
        if not may_change(step, pose, options.effort):
            continue
        before = time.perf_counter()
        result = matching[step]()
        if result is None:
            continue
        matched = time.perf_counter()
        found = result
        pose = estimate_pose(found.matches, *cameras, options, map_matches=found.map_matches)
        seconds[step] = matched - before
        estimating += time.perf_counter() - matched
    assert pose is not None and found is not None
    pose = _mirrored(image1, image2, cameras, matcher, pose, options) or pose
    pose = with_length(pose, found.matches, scale, maps, markers)
    pose = replace(pose, seconds={**seconds, "estimate": estimating})
    return PairResult(image1, image2, *cameras, found.matches, found.correspondence_map, pose)


def _views(pose: RelativePose | None, cameras: tuple[Camera, Camera]) -> list[TwoViews]:
    """The hypotheses of a pose."""
    assert pose is not None
    return [TwoViews(*(pose.cameras or cameras), h.R, h.t) for h in pose.hypotheses]


def may_change(step: Step, pose: RelativePose | None, effort: Effort) -> bool:
    """Whether a step may change the answer. pose: after the steps before it, if there is one.

    A coarse pass has few matches, which distinguish a wrong camera from a right one less than many
    do: they are refined if the pose hangs on it.
    """
    if pose is None:
        return step in ("coarse", "full")
    is_certain = pose.success and _is_clear(pose)
    if step == "refine":
        return is_certain and not (_is_accurate(pose, _ACCURATE_DEG) and _agrees_on_cameras(pose))
    if step == "full":
        return effort != "fast" and not is_certain
    limit_deg = _ACCURATE_DEG if effort == "thorough" else _LOOSE_DEG
    return in_doubt(pose) or (pose.success and not _is_accurate(pose, limit_deg))


def _is_clear(pose: RelativePose) -> bool:
    """Whether a hypothesis is nearly certain to be right, and which one."""
    likely = (pose.any_probability or 0.0) >= _MAX_SEARCHED
    return likely and pose.hypotheses[0].share >= _CLEAR_SHARE


def _is_accurate(pose: RelativePose, limit_deg: float) -> bool:
    """Whether the expected errors of the pose are known, and below a limit."""
    errors = pose.rotation_error_90_deg, pose.translation_error_90_deg
    return all(error is not None and error < limit_deg for error in errors)


def _agrees_on_cameras(pose: RelativePose) -> bool:
    """Whether the pose hardly depends on whether other cameras than the assumed ones are right."""
    evidence = pose.evidence
    if evidence is None or evidence.camera_model != "assumed":
        return False
    return evidence.camera_agreement >= _MAX_SEARCHED and evidence.camera_doubt < _DOUBT


def in_doubt(pose: RelativePose) -> bool:
    """Whether more matches may change the answer: it is neither certain nor hopeless."""
    likely = pose.any_probability
    if likely is None or not pose.hypotheses:
        return False
    share = pose.hypotheses[0].share
    of_others = likely * (1 - share) if pose.status == "rotation_only" else likely
    return of_others > _MIN_SEARCHED and not _is_clear(pose)


def mirror_image(image: Image, camera: Camera, axis: int = 1) -> tuple[Image, Camera] | None:
    """The mirror image, see `flipped`, and its camera; None for a lens that is not turned."""
    try:
        return flipped(image, axis), camera.turned(exif_turn(2 if axis else 4), image.size)
    except InputError:
        return None


def _mirrored(
    image1: Image,
    image2: Image,
    cameras: tuple[Camera, Camera],
    matcher: Matcher,
    pose: RelativePose,
    options: EstimationOptions,
) -> RelativePose | None:
    """The refusal of image 2 as a mirror image, if its own pose fails, and its mirror image has a
    likely pose by a coarse pass, no less probable than its own; None if it has none.

    The mirror image is flipped left to right, or top to bottom if the pose is upside down.
    """
    if pose.success or pose.any_probability is None:
        return None
    if pose.contradicts_K:
        return None
    if pose.status in ("rotation_only", "same_picture"):
        return None
    flips = bool(pose.hypotheses) and pose.hypotheses[0].R[1, 1] < 0
    mirror = mirror_image(image2, cameras[1], 0 if flips else 1)
    if mirror is None:
        return None
    result = matcher.coarse(image1, mirror[0])
    matcher.cache.forget(mirror[0])  # no other pair has it
    if result is None:
        return None
    of_mirror_image = estimate_pose(
        result.matches, cameras[0], mirror[1], options, map_matches=result.map_matches
    )
    probability = (of_mirror_image.one_place_probability or 0.0) if of_mirror_image.success else 0.0
    if probability < max(_LIKELY, pose.any_probability):
        return None
    reason = (
        f"the mirror image of image 2 has a pose with probability {percent_text(probability)}, "
        "image 2 has none as likely"
    )
    inliers = np.zeros_like(pose.inliers)
    return RelativePose("mirrored", reason, inliers, pose.num_matches, warnings=pose.warnings)


@dataclass(frozen=True, eq=False)
class PairResult:
    """A pose with everything that it was computed from, by `solve_pair`.

    Attributes:
        image1: Image 1.
        image2: Image 2.
        prior1: Camera of image 1 before the estimation: of the K stated or of EXIF data.
        prior2: Camera of image 2, likewise.
        matches: The N matches that the pose was estimated from.
        correspondence_map: The dense map; None for a matcher that makes none.
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
        """Camera of image 1 that the pose is of; without a pose, `prior1`."""
        return self.pose.camera1 or self.prior1

    @property
    def camera2(self) -> Camera:
        """Camera of image 2, likewise."""
        return self.pose.camera2 or self.prior2

    @property
    def points3d(self) -> np.ndarray:
        """The matches' points (N, 3) float64 in camera 1's frame (OpenCV axes), in metres if the
        length of t is known, else in units of the distance between the cameras; on the rays of
        camera 1 where the two rays come nearest.

        NaN where a match is no inlier or its point is not in front of both cameras, and without R
        and t.
        """
        points = np.full((len(self.matches), 3), np.nan)
        R, t, inliers = self.pose.R, self.pose.t, self.pose.inliers
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
        """Colours (N, 3) uint8 RGB of image 1 at the matches, of the nearest pixels; black where
        the match is not finite."""
        points = self.matches.points1
        finite = np.isfinite(points).all(1)
        last = np.array(self.image1.size) - 1
        x, y = np.rint(np.clip(np.where(finite[:, None], points, 0), 0, last)).astype(np.intp).T
        return self.image1.pixels[y, x] * finite[:, None].astype(np.uint8)

    @property
    def residuals_px(self) -> np.ndarray:
        """Symmetric epipolar distances (N,) of the matches, in pixels without lens distortion: the
        mean of the distances of each point to the epipolar line of the other.

        NaN without R and t, and where the distortion cannot be undone.
        """
        if self.pose.E is None:
            return np.full(len(self.matches), np.nan)
        points = self.matches.points1, self.matches.points2
        return epipolar_residuals_px(*points, self.camera1, self.camera2, self.pose.E)
