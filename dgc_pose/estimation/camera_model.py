"""The cameras that two images may have: the stated or assumed ones, and others.

An assumed camera has a lens of two radial coefficients, square pixels and its principal point near
the middle, the same in all of its images.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from dgc_pose.cameras.camera import Camera, Part
from dgc_pose.cameras.colmap_camera import CYLINDER, FISHEYE, Distortion
from dgc_pose.cameras.prior import CENTRE_STD, OTHER_STD, of_part
from dgc_pose.estimation.camera_fit import JointPose
from dgc_pose.estimation.intrinsics_prior import may_be_crop
from dgc_pose.estimation.problem import image_size

# The cameras that the matches agree with. Without K, others than assumed have an unusual focal
# length (tail), one for each image (two), pixels that are not square (squeezed) and so on. In place
# of K, they have another focal length, one for each image (focals), a lens, another principal point
# (centre), no lens (unlensed), the principal point in the middle, or the other's K (swapped).
ModelName = Literal[
    "assumed",
    "tail",
    "two",
    "squeezed",
    "off_centre",
    "fisheye",
    "cylinder",
    "focal",
    "focals",
    "lens",
    "centre",
    "unlensed",
    "middle",
    "swapped",
]
# Prior log-odds of another model: for a picture with EXIF data; without, for a wide lens, and for
# an edited picture of a sensor's shape; and for a picture of no sensor's shape, which was cut,
# squeezed or joined.
_LOG_ODDS_OF_EXIF, _LOG_ODDS, _LOG_ODDS_OF_EDITED, _LOG_ODDS_OF_SHAPE = -12.0, -6.0, -7.0, -3.0
# Prior log-odds of two cameras if the images have one size: without EXIF data, or with the same.
_TWO, _TWO_OF_EXIF = -2.2, -25.0
_TWO_LENS_STD = 0.02  # deviation of each lens: one camera's zoom hardly changes its lens
# Prior log-odds of other cameras than K states; and of the middle if K is far from it.
_STATED: Mapping[ModelName, float] = {
    "focal": -8.0,
    "focals": -9.0,
    "lens": -8.0,
    "centre": -11.0,
    "unlensed": -9.0,
    "middle": -10.0,
    "swapped": -12.0,
}
_FAR_FROM_MIDDLE = -0.5
_SHAPES = (5 / 4, 4 / 3, 3 / 2, 8 / 5, 16 / 9)  # of sensors: the longer side over the shorter
_SAME_SHAPE = 0.015  # difference of two shapes' logarithms
_ASPECT_STD = 0.3  # of ln fy / fx of squeezed pixels
_CENTRE_STD = 0.02  # of the principal point of a crop, over the longer side
# Deviations of other cameras than K states: ln f; principal point over the longer side; lens.
_STATED_STD, _STATED_CENTRE_STD, _STATED_LENS_STD = 0.5, 0.05, 0.15
# Distances of K's principal point from the middle, over the longer side: off it, and far off it.
_OFF, _FAR_OFF = 0.01, 0.04
STATED_K_MODELS = tuple(_STATED)
_OTHER_FOCAL = 0.02  # least difference of ln f of two K that may be swapped
_MIN_FOCAL_ERROR = 0.08  # least error of ln f that is worth a warning
_UNCERTAIN_STD = 0.1  # deviation of ln f beyond which there is a warning
# Projections; focal lengths without EXIF data, over the longer side; deviations of ln f.
WIDE = {"fisheye": (FISHEYE, 0.55, 0.35), "cylinder": (CYLINDER, 0.6, 0.4)}


@dataclass(frozen=True, eq=False)
class CameraModel:
    """One model of the two cameras, and their pose."""

    name: ModelName
    cameras: tuple[Camera, Camera]  # before the fit
    log_odds: float = 0.0  # prior, against the assumed model
    pose: JointPose | None = None  # the fit; None if it failed
    log_evidence: float = -math.inf
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))  # of the pose, rad^2
    stds: float = math.inf  # largest deviation from K, in standard deviations of the fit
    focal_std: float = 0.0  # of ln f of the less certain camera, by the fit
    # Only of the likeliest model: the covariance (6, 6), rad^2, that the other models' poses within
    # 10 degrees of its pose add; and the probability that the right pose is within 10 degrees.
    pose_covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))
    agreement: float = 1.0
    doubt: float = -math.inf  # log-odds of the likeliest other model, from the matches only


def other_models(stated: tuple[Camera, Camera]) -> Iterator[CameraModel]:
    """The models other than the cameras as stated or assumed."""
    first, second = stated
    if any(map(_is_open, stated)):
        names: tuple[ModelName, ...] = ("squeezed", "off_centre", "fisheye", "cylinder")
        for name in names:
            odds = max(_log_odds(first, name), _log_odds(second, name))
            yield CameraModel(name, (with_model(first, name), with_model(second, name)), odds)
        yield from _other_focals(stated)
    elif all(camera.focal_source == "given" for camera in stated):
        yield from _alternatives_to_K(stated)


def _other_focals(stated: tuple[Camera, Camera]) -> Iterator[CameraModel]:
    """Models with the less likely part of a focal length's prior; and with one for each image."""
    first, second = stated
    focal_priors = [camera.focal_prior for camera in stated if camera.focal_prior is not None]
    if first.identity is None or first.identity != second.identity:
        for number, camera in enumerate(stated):
            if camera.focal_prior is not None:
                usual, tail = _parts(camera, [camera.focal_prior.lines])
                other = of_part(camera, tail)
                cameras = (first, other) if number else (other, second)
                yield CameraModel("tail", cameras, tail.log_weight - usual.log_weight)
        return
    if len(focal_priors) < 2:
        return
    usual, tail = _parts(first, [focal_prior.lines for focal_prior in focal_priors])
    odds = tail.log_weight - usual.log_weight
    yield CameraModel("tail", (of_part(first, tail), of_part(second, tail)), odds)
    exif = first.focal_source == "exif"
    own = [
        focal_prior.tail.given(focal_prior.lines)
        if exif
        else focal_prior.parts([focal_prior.lines])[0]
        for focal_prior in focal_priors
    ]
    odds = (_TWO_OF_EXIF if exif else _TWO) - usual.log_weight
    odds += sum(part.log_weight for part in own)
    first, second = (
        replace(of_part(c, p), identity=None, lens_std=min(c.lens_std, _TWO_LENS_STD))
        for c, p in zip(stated, own, strict=True)
    )
    yield CameraModel("two", (first, second), odds)


def _parts(camera: Camera, lines: Sequence[np.ndarray]) -> tuple[Part, Part]:
    """The part of the prior that the camera's focal length is from, and the other part."""
    assert camera.focal_prior is not None

    def distance(part: Part) -> float:
        return abs(math.log(of_part(camera, part).focal / camera.focal))

    one, other = sorted(camera.focal_prior.parts(lines), key=distance)
    return one, other


def _alternatives_to_K(stated: tuple[Camera, Camera]) -> Iterator[CameraModel]:
    """Models with other cameras than K states."""
    first, second = stated
    same_size, ratio = first.size == second.size, abs(math.log(first.focal / second.focal))
    one = same_size and ratio < _OTHER_FOCAL  # one camera: K lacks the same lens in both
    for name, odds in _STATED.items():
        other1, other2 = with_model(first, name), with_model(second, name)
        if name == "lens" and one:
            other1, other2 = replace(other1, identity="both"), replace(other2, identity="both")
        if name == "middle" and max(map(_from_middle, stated)) > _FAR_OFF:
            odds = _FAR_FROM_MIDDLE
        if other1 is not first or other2 is not second:
            yield CameraModel(name, (other1, other2), odds)
    if same_size and not one:
        yield CameraModel("swapped", (second, first), _STATED["swapped"])


def _from_middle(camera: Camera) -> float:
    """How far the principal point is from the middle of the image, over the longer side."""
    size = np.array(image_size(camera))
    return float(np.abs(camera.K[:2, 2] - (size - 1) / 2).max() / size.max())


def camera_warnings(
    name: ModelName, stated: tuple[Camera, Camera], fitted: tuple[Camera, Camera]
) -> tuple[str, ...]:
    """Warnings about unusual or uncertain fitted cameras, a line each. stated: before the fit."""
    lines, loose = dict[str, None](), dict[str, None]()
    for before, camera in zip(stated, fitted, strict=True):
        source = {"given": "K", "exif": "EXIF"}.get(before.focal_source)
        focal = f"f = {camera.focal:.0f} +- {camera.focal_std * camera.focal:.0f} px"
        off = abs(math.log(camera.focal / before.focal))
        (x, y), (cx, cy) = camera.K[:2, 2], before.K[:2, 2]
        lens, was, line = camera.distortion, before.distortion, ""
        if name in ("assumed", "tail") and source and before.focal_std:
            if is_contradicted(before, camera):
                line = f"{focal}, and {source} states {before.focal:.0f}"
        elif name in ("focal", "focals") and off > 2 * camera.focal_std:
            line = f"{focal}, and K states {before.focal:.0f}"
        elif name == "lens" and lens is not None:
            k1 = f"k1 = {lens.radial[0]:.3f} +- {camera.lens_std:.3f}"
            line = f"a lens of {k1}, and K states {'none' if was is None else was.model}"
        elif name == "unlensed" and was is not None:
            line = f"no lens, and K states {was.model}"
        elif name in ("centre", "middle"):
            centre = f"({x:.0f}, {y:.0f}) +- {camera.centre_std:.0f} px"
            line = f"a principal point of {centre}, and K states ({cx:.0f}, {cy:.0f})"
        elif name == "swapped":
            line = f"f = {camera.focal:.0f} px, as the K of the other image"
        elif name == "squeezed" and _is_open(before):
            ratio = f"fy / fx = {camera.K[1, 1] / camera.K[0, 0]:.3f} +- {camera.aspect_std:.3f}"
            line = f"pixels that are not square, {ratio}"
        elif name == "off_centre" and _is_open(before):
            line = f"a principal point of its own, ({x:.0f}, {y:.0f}) +- {camera.centre_std:.0f} px"
        elif name == "fisheye" and _is_open(before):
            line = f"a fisheye, f = {camera.focal:.0f} px"
        elif name == "two" and _is_open(before):
            line = f"a different focal length for each image, {focal}"
        if line:
            lines[line] = None
        elif camera.focal_std > _UNCERTAIN_STD:
            loose[f"f = {camera.focal:.0f} px within {100 * camera.focal_std:.0f} %"] = None
    agree = (f"the matches agree with {line}" for line in lines)
    return (*agree, *(f"the focal length is uncertain: {line}" for line in loose))


def is_contradicted(stated: Camera, fitted: Camera) -> bool:
    """Whether a fit contradicts a focal length that is stated with a deviation."""
    off = abs(math.log(fitted.focal / stated.focal))
    return off >= max(_MIN_FOCAL_ERROR, 3 * stated.focal_std)


def _log_odds(camera: Camera, name: ModelName) -> float:
    """The prior log-odds of another model."""
    shape = abs(math.log(camera.size[0] / camera.size[1])) if camera.size else 0.0
    if all(abs(shape - math.log(usual)) > _SAME_SHAPE for usual in _SHAPES):
        return _LOG_ODDS_OF_SHAPE
    if camera.focal_source == "exif":
        return _LOG_ODDS_OF_EXIF
    return _LOG_ODDS if name in WIDE else _LOG_ODDS_OF_EDITED


def _is_open(camera: Camera) -> bool:
    """Whether neither K nor a lens is stated."""
    return camera.focal_source != "given" and camera.distortion is None


def is_edited(camera: Camera) -> bool:
    """Whether the picture may be squeezed or cropped: no EXIF data show that a camera wrote it."""
    by_picture = camera.focal_source in ("size", "lines")
    return _is_open(camera) and (by_picture or may_be_crop(camera))


def with_model(camera: Camera, name: ModelName) -> Camera:
    """A camera before the fit, by another model; unchanged if this model does not apply to it."""
    width, height = image_size(camera)
    longer, lens = max(width, height), camera.distortion
    if name in ("focal", "focals"):
        identity = "both" if name == "focal" else None
        std = max(camera.focal_std, _STATED_STD)
        centre_std = max(camera.centre_std, CENTRE_STD * longer)
        return replace(camera, focal_std=std, centre_std=centre_std, identity=identity)
    if name == "lens":
        radial = lens is None or lens.projection in ("plane", "angles")
        return replace(camera, lens_std=_STATED_LENS_STD) if radial else camera
    if name == "unlensed":
        return camera if lens is None else replace(camera, distortion=None, lens_std=0.0)
    if name == "centre":
        return replace(camera, centre_std=max(camera.centre_std, _STATED_CENTRE_STD * longer))
    if name == "middle":
        if _from_middle(camera) < _OFF:
            return camera
        K = camera.K.copy()
        K[:2, 2] = (width - 1) / 2, (height - 1) / 2
        return replace(camera, K=K, centre_std=max(camera.centre_std, CENTRE_STD * longer))
    if not (is_edited(camera) if name in ("squeezed", "off_centre") else _is_open(camera)):
        return camera
    if name == "squeezed":
        return replace(camera, aspect_std=_ASPECT_STD)
    if name == "off_centre":  # a crop has its own principal point
        return replace(camera, centre_std=max(camera.centre_std, _CENTRE_STD * longer))
    if name == "tail" and camera.focal_prior is not None:
        return of_part(camera, _parts(camera, [camera.focal_prior.lines])[1])
    if name == "two":  # another zoom, or a crop of one image that EXIF data do not show
        return replace(camera, focal_std=OTHER_STD, identity=None)
    if name not in WIDE:
        return camera
    projection, over_side, std = WIDE[name]
    if camera.focal_source in ("size", "lines"):
        camera = replace(camera.with_focal(over_side * longer), focal_std=std)
    if projection == CYLINDER:
        return replace(camera, distortion=Distortion(projection), lens_std=0.0)
    return replace(camera, distortion=Distortion(projection, (0.0,) * 4))
