"""Other cameras that two images may have than the assumed ones, for the rows of `camera_model`; and
wide cameras around what is stated or assumed. `stated_changes` has those in place of a K.

An assumed camera has a lens of two radial coefficients, square pixels and its principal point near
the middle, the same in all of its images.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dgc_pose.cameras.camera import Camera, Part, image_size
from dgc_pose.cameras.colmap_camera import CYLINDER, FISHEYE, Distortion
from dgc_pose.cameras.prior import (
    CENTRE_STD,
    USUAL_K,
    has_picture,
    improbability,
    picture_camera,
    with_part,
)
from dgc_pose.estimation.intrinsics_prior import may_be_crop

Cameras = tuple[Camera, Camera]
# Prior log-odds of another model without a K, in place of the model's own: for a picture with EXIF
# data; and for a picture of no sensor's shape, which was cut, squeezed or joined.
LOG_ODDS_OF_EXIF = -12.0
LOG_ODDS_OF_SHAPE = -3.0
_SHAPES = (5 / 4, 4 / 3, 3 / 2, 8 / 5, 16 / 9)  # of sensors: the longer side over the shorter
_SAME_SHAPE = 0.015  # difference of two shapes' logarithms
# Prior log-odds of two cameras if the images have one size: without EXIF data, or with the same,
# where an unknown lens and centre may pass for a zoom.
LOG_ODDS_OF_TWO = -2.2
LOG_ODDS_OF_TWO_WITH_EXIF = -20.0
_TWO_LENS_STD = 0.02  # deviation of each lens: one camera's zoom hardly changes its lens
# Deviations of ln f, of the principal point over the longer side, of the lens and of ln fy / fx: of
# what a model opens, and of the rest of a K that is contradicted in a part, which is not exact.
OPEN_FOCAL_STD = 0.5
OPEN_CENTRE_STD = 0.05
OPEN_LENS_STD = 0.15
_ASPECT_STD = 0.3
_LOOSE_FOCAL_STD = 0.02
_LOOSE_LENS_STD = 0.02
# Of a camera that only turned
_TURNED_FOCAL_STD = 0.2
_TURNED_LENS_STD = 0.2
_TURNED_OPEN_LENS_STD = 0.08  # the same without a K: a plane that moves is no turn
_CROP_CENTRE_STD = 0.02  # of the principal point of a crop, over the longer side
OTHER_FOCAL = 0.02  # least relative difference of two K, or of two focal lengths


class Variant(NamedTuple):
    """The cameras of a model before their fit, and its prior log-odds."""

    cameras: Cameras
    log_odds: float


# From the stated or assumed cameras, and the log-odds of a model, to its variants; none that leaves
# the cameras as they are.
Change = Callable[[Cameras, float], Iterator[Variant]]


def are_stated(cameras: Cameras) -> bool:
    """Whether both images have a K."""
    return all(camera.focal_source == "given" for camera in cameras)


def nothing(stated: Cameras, log_odds: float) -> Iterator[Variant]:
    """No other cameras."""
    return iter(())


def opened(stated: Cameras) -> Cameras:
    """Two cameras with everything open: around their K, or around what pictures have if a K is
    unusual. A K beside a camera without one stays."""
    changed = []
    for camera in stated:
        if camera.focal_source == "given" and not are_stated(stated):
            changed.append(camera)
            continue
        is_usual = not are_stated(stated) or improbability(camera) < USUAL_K
        base = camera if is_usual else _as_pictured(camera)
        changed.append(
            replace(
                base,
                focal_std=OPEN_FOCAL_STD,
                centre_std=OPEN_CENTRE_STD * max(image_size(camera)),
                lens_std=OPEN_LENS_STD if base.has_radial_lens else 0.0,
                aspect_std=_ASPECT_STD,
                identity=None,
            )
        )
    return changed[0], changed[1]


def turning(stated: Cameras) -> Cameras:
    """Both cameras with what a camera that only turned may have: a K that is off by one factor, and
    another lens. A K that is unusual is as none."""
    if are_stated(stated):
        if max(map(improbability, stated)) < USUAL_K:
            return loosened(stated, focal=_TURNED_FOCAL_STD, lens=_TURNED_LENS_STD, one=True)
        stated = _as_pictured(stated[0]), _as_pictured(stated[1])
    first, second = (
        replace(camera, lens_std=max(camera.lens_std, _TURNED_OPEN_LENS_STD))
        if camera.lens_std
        else camera
        for camera in stated
    )
    return first, second


def loosened(
    cameras: Cameras,
    *,
    focal: float = 0.0,
    centre: float = 0.0,
    lens: float = 0.0,
    one: bool | None = None,
) -> Cameras:
    """K with these deviations, and small ones of the rest. one: whether both cameras are off by
    the same; by default, if their focal lengths and sizes are the same."""
    one = have_one_focal(cameras) if one is None else one
    changed = []
    for camera in cameras:
        centre_std = max(centre, CENTRE_STD) * max(image_size(camera))
        lens_std = max(camera.lens_std, lens, _LOOSE_LENS_STD)
        changed.append(
            replace(
                camera,
                focal_std=max(camera.focal_std, focal, _LOOSE_FOCAL_STD),
                centre_std=max(camera.centre_std, centre_std),
                lens_std=lens_std if camera.has_radial_lens else 0.0,
                identity="both" if one else None,
            )
        )
    return changed[0], changed[1]


def have_one_focal(cameras: Cameras) -> bool:
    ratio = abs(math.log(cameras[0].focal / cameras[1].focal))
    return cameras[0].size == cameras[1].size and ratio < OTHER_FOCAL


def _as_pictured(camera: Camera) -> Camera:
    """The camera as without its K, if anything is known of its picture."""
    return picture_camera(camera) if has_picture(camera) else camera


def is_open(camera: Camera) -> bool:
    """Whether neither K nor a lens is stated."""
    return camera.focal_source != "given" and camera.distortion is None


def is_edited(camera: Camera) -> bool:
    """Whether the picture may be squeezed or cropped: no EXIF data show that a camera wrote it."""
    by_picture = camera.focal_source in ("size", "lines")
    return is_open(camera) and (by_picture or may_be_crop(camera))


def has_sensor_shape(camera: Camera) -> bool:
    """Whether the image has the shape of a sensor: a cut or squeezed picture hardly ever has."""
    shape = abs(math.log(camera.size[0] / camera.size[1])) if camera.size else 0.0
    return any(abs(shape - math.log(usual)) <= _SAME_SHAPE for usual in _SHAPES)


# Models without a K


def without_K(change: Callable[[Camera], Camera]) -> Change:
    """Of a model that changes each camera without a K in the same way."""

    def variants(stated: Cameras, log_odds: float) -> Iterator[Variant]:
        first, second = (change(camera) if is_open(camera) else camera for camera in stated)
        odds = [
            _odds_without_K(before, log_odds)
            for before, changed in zip(stated, (first, second), strict=True)
            if changed is not before
        ]
        if odds:
            yield Variant((first, second), max(odds))

    return variants


def _odds_without_K(camera: Camera, log_odds: float) -> float:
    if not has_sensor_shape(camera):
        return LOG_ODDS_OF_SHAPE
    return LOG_ODDS_OF_EXIF if camera.focal_source == "exif" else log_odds


def _squeezed(camera: Camera) -> Camera:
    return replace(camera, aspect_std=_ASPECT_STD) if is_edited(camera) else camera


def _off_centre(camera: Camera) -> Camera:
    """A crop has its own principal point."""
    std = _CROP_CENTRE_STD * max(image_size(camera))
    is_changed = is_edited(camera) and std > camera.centre_std
    return replace(camera, centre_std=std) if is_changed else camera


def _wide(distortion: Distortion, over_side: float, focal_std: float) -> Callable[[Camera], Camera]:
    """Another projection. over_side: the focal length over the longer side, without EXIF data."""

    def change(camera: Camera) -> Camera:
        if camera.focal_source in ("size", "lines"):
            camera = camera.with_focal(over_side * max(image_size(camera)))
            camera = replace(camera, focal_std=focal_std)
        lens_std = 0.0 if distortion.model == CYLINDER else camera.lens_std
        return replace(camera, distortion=distortion, lens_std=lens_std)

    return change


def tail(stated: Cameras, log_odds: float) -> Iterator[Variant]:
    """The less likely part of a focal length's prior: of one camera, or of each of two."""
    if _is_one(stated):
        priors = [camera.focal_prior for camera in stated if camera.focal_prior is not None]
        if len(priors) == 2:
            usual, tail = _parts(stated[0], [prior.lines for prior in priors])
            first, second = (with_part(camera, tail) for camera in stated)
            yield Variant((first, second), log_odds + tail.log_weight - usual.log_weight)
        return
    for number, camera in enumerate(stated):
        if camera.focal_prior is not None:
            usual, tail = _parts(camera, [camera.focal_prior.lines])
            other = with_part(camera, tail)
            cameras = (stated[0], other) if number else (other, stated[1])
            yield Variant(cameras, log_odds + tail.log_weight - usual.log_weight)


def two(stated: Cameras, log_odds: float) -> Iterator[Variant]:
    """A focal length for each image: another zoom; or, with EXIF data, a crop or a zoom of one of
    the images that they do not show."""
    priors = [camera.focal_prior for camera in stated if camera.focal_prior is not None]
    if not _is_one(stated) or len(priors) < 2:
        return
    before, _ = _parts(stated[0], [prior.lines for prior in priors])
    if stated[0].focal_source == "exif":
        usual1, usual2 = (prior.usual.given(prior.lines) for prior in priors)
        tail1, tail2 = (prior.tail.given(prior.lines) for prior in priors)
        choices = [(tail1, usual2), (usual1, tail2)]
        log_odds = LOG_ODDS_OF_TWO_WITH_EXIF
    else:
        first, second = (prior.parts([prior.lines])[0] for prior in priors)
        choices = [(first, second)]
    for part1, part2 in choices:
        odds = log_odds + part1.log_weight + part2.log_weight - before.log_weight
        yield Variant((_zoomed(stated[0], part1), _zoomed(stated[1], part2)), odds)


def _zoomed(camera: Camera, part: Part) -> Camera:
    lens_std = min(camera.lens_std, _TWO_LENS_STD)
    return replace(with_part(camera, part), identity=None, lens_std=lens_std)


def _is_one(stated: Cameras) -> bool:
    """Whether one camera took both images."""
    return stated[0].identity is not None and stated[0].identity == stated[1].identity


def _parts(camera: Camera, lines: Sequence[np.ndarray]) -> tuple[Part, Part]:
    """The part of the prior that the camera's focal length is from, and the other part."""
    assert camera.focal_prior is not None

    def distance(part: Part) -> float:
        return abs(math.log(with_part(camera, part).focal / camera.focal))

    one, other = sorted(camera.focal_prior.parts(lines), key=distance)
    return one, other


squeezed = without_K(_squeezed)
off_centre = without_K(_off_centre)
fisheye = without_K(_wide(Distortion(FISHEYE, (0.0,) * 4), 0.55, 0.35))
cylinder = without_K(_wide(Distortion(CYLINDER), 0.6, 0.4))
