"""Whether a fixed camera has moved between two pictures, and by how much."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from dgc_pose.cameras.by_image import NO_DETAILS, KDetails
from dgc_pose.cameras.calibration import single_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.covariance import NORMAL_90
from dgc_pose.estimation.picture_motion import (
    FAR_MORE,
    FORWARD,
    SHIFT,
    TURN,
    ZOOM,
    FixedMatches,
    Minimum,
    MotionFit,
    at_rest,
    fitted,
    how_far_px,
    quantile,
)
from dgc_pose.geometry.epipolar import unit_rays
from dgc_pose.geometry.rotation import aligning_rotation, rotation_angle_deg
from dgc_pose.images.image import load_image
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import DEFAULT_WEIGHTS, Matcher
from dgc_pose.system.options import check_type
from dgc_pose.system.parallel import one_blas_thread

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource, ImageSource, MatcherSource

STILL_DEG = 0.05  # the camera is still if the motion of the picture plus its error is less
ZOOMED = 0.02  # relative scale from which a camera has zoomed; a focus that breathes has less
# The camera has moved if the motion of the picture exceeds this and this many times its error.
_LEAST_DEG = 0.01
_SIGNIFICANT = 2.0
_MOST = 0.9  # quantile of the motion over the picture that these limits apply to
_CELLS = 16  # along the longer side of the picture
_MIN_MATCHES = 50
_COVERED = 0.1  # least share of the picture that agrees
# Shares of the matched cells: the least that agree on a motion; the least that stay although the
# motion would move them, so only objects moved; the most that stay if the camera moved.
_AGREE = 0.4
_STAY = 0.15
_NOTHING = 0.1
# A larger part that moves together, or one far larger than the part that stays, may be the scene
# behind a still lens hood.
_MAJORITY = 0.6
_MIRRORED = 0.3  # share of random triangles that are mirrored: real motions mirror up to 0.21
_PARALLAX = 25.0  # a shift that lowers the loss by more is no zoom
_STAYS = 3.0  # largest error of a match that stays, in standard deviations
_LENS_STD = 0.15  # of the first radial coefficient, for a K without a lens
# Random triples; their threshold; the first standard deviation of a match, over its expected error.
_SAMPLES = 200
_LOOSE = 0.02
_WIDE = 8.0


@dataclass(frozen=True)
class CameraMotion:
    """The motion of a camera since the reference picture.

    Nine in ten errors stay below the stated ones, if the scene has depth: before a flat wall, a
    shift appears as a rotation or a zoom. How far the picture moves holds for points at the median
    depth of the matched scene.

    Attributes:
        verdict: "still": beside a zoom below 2 %, the picture moves by less than 0.05 degrees.
            "moved": it moves significantly. "zoomed": the camera did not move, and zoomed by 2 % or
            more. "cannot say": `reason` states why.
        reason: One line for people.
        middle_px: How far the middle of the picture moves, pixels; None if the matches show no
            single motion.
        middle_error_90_px: Its expected error.
        worst_px: How far the part that moves most of the matched picture moves, pixels.
        worst_error_90_px: Its expected error.
        zoom: Growth of the picture about the principal point: 0.01 is larger by 1 %.
        zoom_error_90: Its expected error.
        angle_deg: Angle of the rotation, degrees.
        angle_error_90_deg: Its expected error.
        shift: Distance between the camera centres over the median depth.
        shift_error_90: Its expected error, in the same unit.
        num_matches: Number of matches.
        num_inliers: Number of matches that agree with the motion.
        warnings: Sentences about what makes the result uncertain, for people.
        seconds: Time spent on "load" (of the later picture), "match" and "estimate".
    """

    verdict: Literal["still", "moved", "zoomed", "cannot say"]
    reason: str
    middle_px: float | None = None
    middle_error_90_px: float | None = None
    worst_px: float | None = None
    worst_error_90_px: float | None = None
    zoom: float | None = None
    zoom_error_90: float | None = None
    angle_deg: float | None = None
    angle_error_90_deg: float | None = None
    shift: float | None = None
    shift_error_90: float | None = None
    num_matches: int = 0
    num_inliers: int = 0
    warnings: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The values for JSON."""
        return asdict(self)


def camera_motion(
    reference: ImageSource,
    now: ImageSource,
    K: CameraSource = None,
    *,
    matcher: MatcherSource = None,
) -> CameraMotion:
    """Whether a fixed camera has moved since the reference picture, and how far the picture moves.

    `FixedCamera` has the arguments and the errors; for many pictures, it is the faster one.

    >>> camera_motion("installed.jpg", "today.jpg", K).verdict  # doctest: +SKIP
    """
    return FixedCamera(reference, K, matcher=matcher).motion(now)


class FixedCamera:
    """A camera that should stand still, by a reference picture.

    reference: a path, an array (H, W[, 3]) in RGB order, or a tensor. K: as for
    `estimate_relative_pose`, in pixels of the stored reference. Without K the focal length is
    assumed; without K or a lens in it, so is a lens without distortion. The matches of a motion
    adjust both, and their uncertainty is part of the errors. matcher: by default `load_matcher()`;
    or a name. details: the size that K refers to, and its deviations.

    Raises ImageError if the reference cannot be read, InputError (a ValueError) if another argument
    is unusable, WeightsError if the network's weights cannot be loaded.

    >>> FixedCamera("installed.jpg", K).motion("today.jpg").verdict  # doctest: +SKIP

    Attributes:
        reference: The upright reference picture.
        camera: Its camera, also of all later pictures.
    """

    def __init__(
        self,
        reference: ImageSource,
        K: CameraSource = None,
        *,
        matcher: MatcherSource = None,
        details: KDetails = NO_DETAILS,
    ) -> None:
        self.reference = load_image(reference, "reference")
        check_type(matcher, Matcher | str | Path | None, "matcher")
        check_type(details, KDetails, "details")
        self.camera = single_camera(K, self.reference, details=details)
        matcher = DEFAULT_WEIGHTS if matcher is None else matcher
        self._matcher = load_matcher(matcher) if isinstance(matcher, str | Path) else matcher

    def motion(self, now: ImageSource) -> CameraMotion:
        """The motion until a later picture, of the kinds and the size of the reference.

        Raises ImageError if it cannot be read, InputError if its size differs.
        """
        start = time.perf_counter()
        picture = load_image(now, "now")
        if picture.size != self.reference.size:
            sizes = (
                f"{image.name} has {image.size[0]} x {image.size[1]}"
                for image in (picture, self.reference)
            )
            raise InputError(ArgumentName("now"), "has another size: " + ", ".join(sizes))
        loaded = time.perf_counter()
        matches = self._matcher.match(self.reference, picture).matches
        matched = time.perf_counter()
        motion = _motion(matches, opened(self.camera), picture.size)
        seconds = {
            "load": loaded - start,
            "match": matched - loaded,
            "estimate": time.perf_counter() - matched,
        }
        return replace(motion, warnings=self.camera.warnings, seconds=seconds)


def opened(camera: Camera) -> Camera:
    """The camera with a lens that the motion fits, if none is stated."""
    if camera.distortion is not None:
        return camera
    return replace(camera, lens_std=max(camera.lens_std, _LENS_STD))


@one_blas_thread()
def _motion(matches: Matches, camera: Camera, size: tuple[int, int]) -> CameraMotion:
    """The motion from the matches of two pictures. size: (width, height) of both."""
    pixels = np.stack([matches.points1, matches.points2])
    pixels = pixels[:, np.isfinite(pixels).all((0, 2))]
    normalised = camera.normalise(pixels[0]) + camera.normalise(pixels[1])
    points1, points2 = pixels[:, np.isfinite(normalised).all(1)]
    number = len(points1)
    if number < _MIN_MATCHES:
        return CameraMotion("cannot say", f"only {number} matches", num_matches=number)
    cell = max(size) / _CELLS
    cells = np.floor(points1 / cell) @ (1, _CELLS + 1)
    _, index, count = np.unique(cells, return_inverse=True, return_counts=True)
    matched = FixedMatches(points1, points2, 1 / count[index], matches.error_px, camera)
    fit, has_changed, doubt = _decided(matched)
    share = fit.agree.sum() / len(count)
    covers = fit.agree.sum() * cell**2 / (size[0] * size[1])
    if share < (_AGREE if has_changed else _STAY) or covers < _COVERED:
        parts = f"{100 * share:.0f} % of the matched picture, {100 * covers:.0f} % of all,"
        doubt = f"only {parts} agrees on one motion"
    elif has_changed and not doubt and _mirrored(matched, fit) > _MIRRORED:
        doubt = "the matches fit a mirror image"
    motion = CameraMotion("cannot say", doubt)
    if not doubt:
        motion = _measured(matched, fit, size, has_changed)
    return replace(motion, num_matches=number, num_inliers=int(np.count_nonzero(fit.agree)))


def _measured(
    matched: FixedMatches, fit: MotionFit, size: tuple[int, int], has_changed: bool
) -> CameraMotion:
    middle = (np.array([size]) - 1) / 2
    (middle_px,), (middle_error,) = _moves(fit, middle, matched.camera)
    moves, errors = _moves(fit, matched.points1[fit.agree > 0], matched.camera)
    worst = int(np.argmax(moves))
    variances = fit.covariance.diagonal()
    zoom = math.expm1(fit.motion.log_zoom)
    zoom_error = NORMAL_90 * (1 + zoom) * math.sqrt(variances[ZOOM])
    how_far = (
        f"the middle moves by {middle_px:.1f} +- {middle_error:.1f} px, the worst place by "
        f"{moves[worst]:.1f} +- {errors[worst]:.1f} px"
    )
    zoomed = ""
    if abs(zoom) > _SIGNIFICANT * zoom_error:
        zoomed = f"zoomed by {100 * zoom:.2f} +- {100 * zoom_error:.2f} %"
    beside = _beside_zoom(matched, fit)
    verdict: Literal["still", "moved", "zoomed", "cannot say"] = "cannot say"
    reason = f"{how_far}, {zoomed}" if zoomed else how_far
    if has_changed and beside.exceeds and beside.bound_deg >= STILL_DEG:
        verdict = "moved"
    elif zoomed and abs(zoom) >= ZOOMED:
        verdict = "zoomed"
        reason = f"{zoomed}, {how_far}"
    elif beside.bound_deg < STILL_DEG:
        verdict = "still"
        less = f"the picture moves by less than {beside.bound_deg + 5e-4:.3f} deg"
        reason = f"{zoomed}; beside the zoom {less}" if zoomed else less
    elif has_changed:
        reason = f"{reason}, by the camera or by a zoom"
    return CameraMotion(
        verdict,
        reason,
        middle_px=float(middle_px),
        middle_error_90_px=float(middle_error),
        worst_px=float(moves[worst]),
        worst_error_90_px=float(errors[worst]),
        zoom=zoom,
        zoom_error_90=zoom_error,
        angle_deg=rotation_angle_deg(fit.motion.R),
        angle_error_90_deg=math.degrees(NORMAL_90 * math.sqrt(variances[TURN].sum())),
        shift=float(np.linalg.norm(fit.motion.t)),
        shift_error_90=NORMAL_90 * math.sqrt(variances[SHIFT].sum()),
    )


class _Beside(NamedTuple):
    """How far the picture moves beside a zoom."""

    exceeds: bool  # whether it exceeds its error, or no zoom explains the motion
    bound_deg: float  # of most of the picture, its error included


def _beside_zoom(matched: FixedMatches, fit: MotionFit) -> _Beside:
    """How far the rotation and the shift move the picture."""
    moves, errors = _degrees(matched, fit, zooms=False)
    all_moves, all_errors = _degrees(matched, fit)
    exceeds = _exceeds(fit, moves, errors) or not _exceeds(fit, all_moves, all_errors)
    exceeds |= fit.gain > _PARALLAX
    bound = quantile(moves + errors, fit.agree, _MOST)
    return _Beside(exceeds, min(bound, quantile(all_moves + all_errors, fit.agree, _MOST)))


def _decided(matched: FixedMatches) -> tuple[MotionFit, bool, str]:
    """The motion; whether the picture changed by more than noise; and why that is open, or "". Fits
    start at rest and at a rotation that most of the picture agrees with. If only people or objects
    moved, the matches that stay decide."""
    weights = matched.weights
    rest = at_rest(matched.camera)
    common = at_rest(matched.camera, _common_rotation(matched))
    wide = _WIDE * matched.error_px
    fit = fitted(matched, [(rest, 0.0), (rest, wide), (common, wide)])
    moves, errors = _degrees(matched, fit)
    stay = _stay(matched, fit)
    stays = float(weights @ stay / weights.sum())
    against, _ = _against(matched, fit, stay)
    has_changed = _exceeds(fit, moves, errors)
    has_changed |= quantile(moves, fit.agree, _MOST) > STILL_DEG and stays < _NOTHING
    doubt = _hood(matched, fit, stay) if has_changed else ""
    doubt = doubt or _hood(matched, fit.widest, stay)
    if doubt:
        return fit, has_changed, doubt
    if against > _STAY if has_changed else stays > _AGREE:
        staying = replace(matched, weights=weights * stay)
        return fitted(staying, [(rest, 0.0)]), False, ""
    return fit, has_changed, ""


def _against(matched: FixedMatches, minimum: Minimum, stay: np.ndarray) -> tuple[float, np.ndarray]:
    """The share of the matched picture that stays (N,) although a motion would move it; and how far
    it would move the matches, pixels (N,)."""
    moves, _ = how_far_px(minimum.motion, matched.points1, matched.camera)
    against = stay & (moves > 2 * _STAYS * minimum.std)
    return float(matched.weights @ against / matched.weights.sum()), moves


def _hood(matched: FixedMatches, minimum: Minimum, stay: np.ndarray) -> str:
    """Why a camera may have moved behind a lens hood that stays (N,), or ""."""
    against, moves = _against(matched, minimum, stay)
    share = float(minimum.agree.sum() / matched.weights.sum())
    if against <= _STAY or share <= min(_MAJORITY, FAR_MORE * against):
        return ""
    angle = math.degrees(quantile(moves, minimum.agree, _MOST) / matched.camera.focal)
    both = f"moves by {angle:.3g} deg, and {100 * against:.0f} % stays"
    return f"{100 * share:.0f} % of the matched picture {both}"


def _exceeds(fit: MotionFit, moves: np.ndarray, errors: np.ndarray) -> bool:
    """Whether motions (N,) of the picture, degrees, exceed their errors (N,)."""
    return quantile(moves - _SIGNIFICANT * errors, fit.agree, _MOST) > _LEAST_DEG


def _stay(matched: FixedMatches, fit: MotionFit) -> np.ndarray:
    """The matches (N,) bool that stay at their pixels."""
    stay: np.ndarray = np.linalg.norm(matched.points2 - matched.points1, axis=1) < _STAYS * fit.std
    return stay


def _degrees(
    matched: FixedMatches, fit: MotionFit, *, zooms: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """How far the picture moves at the matches (N,), and the errors (N,), degrees."""
    per_px = math.degrees(1 / matched.camera.focal)
    moves, errors = _moves(fit, matched.points1, matched.camera, zooms=zooms)
    return per_px * moves, per_px * errors


def _moves(
    fit: MotionFit, points: np.ndarray, camera: Camera, *, zooms: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """How far points of the picture (N, 2) move at the median depth (N,), and the bounds of the
    errors in nine cases of ten (N,), pixels; without `zooms` by the rotation and the shift alone.
    """
    motion = fit.motion if zooms else replace(fit.motion, log_zoom=0.0)
    moves, slopes = how_far_px(motion, points, camera)
    if not zooms:
        slopes[..., ZOOM] = 0.0
        if not motion.t.any():  # a shift forward without parallax counts as the zoom it looks like
            slopes[..., FORWARD] = 0.0
    errors = NORMAL_90 * np.sqrt(np.einsum("nki,ij,nkj->n", slopes, fit.covariance, slopes))
    return moves, np.nan_to_num(errors)


def _common_rotation(matched: FixedMatches) -> np.ndarray:
    """The rotation (3, 3), from random triples of matches, that most of the picture agrees with."""
    rays1, rays2 = _rays(matched)
    weights = matched.weights / matched.weights.sum()
    triples = np.random.default_rng(0).choice(len(weights), (_SAMPLES, 3), p=weights)
    rotations = [aligning_rotation(rays1[triple], rays2[triple]) for triple in triples]
    squared = [np.square(rays1 @ R.T - rays2).sum(1) for R in rotations]
    best = np.argmax([weights @ (1 / (1 + part / _LOOSE**2)) for part in squared])
    return rotations[best]


def _mirrored(matched: FixedMatches, fit: MotionFit) -> float:
    """The share of random triangles of the matches that agree that are mirrored."""
    rays1, rays2 = _rays(matched)
    weights = fit.agree / fit.agree.sum()
    triples = np.random.default_rng(0).choice(len(weights), (_SAMPLES, 3), p=weights)
    mirrored = np.linalg.det(rays1[triples]) * np.linalg.det(rays2[triples]) < 0
    return float(mirrored.mean())


def _rays(matched: FixedMatches) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) of the matches in both pictures."""
    camera = matched.camera
    rays1 = unit_rays(camera.normalise(matched.points1))
    return rays1, unit_rays(camera.normalise(matched.points2))
