"""Other cameras that two images may have than the stated or assumed ones, with prior log-odds.

An assumed camera has a lens of two radial coefficients, square pixels and its principal point near
the middle, the same in all of its images.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from dgc_pose.cameras.camera import Camera, Part, image_size
from dgc_pose.cameras.colmap_camera import CYLINDER, FISHEYE, Distortion
from dgc_pose.cameras.prior import (
    CENTRE_STD,
    FAR_OFF,
    USUAL_K,
    from_middle,
    has_picture,
    improbability,
    is_inner,
    picture_camera,
    with_part,
)
from dgc_pose.estimation.intrinsics_prior import may_be_crop

Cameras = tuple[Camera, Camera]
# Prior log-odds of another model without a K: for a picture with EXIF data; for a wide lens; for
# an edited picture of a sensor's shape; and for a picture of no sensor's shape, which was cut,
# squeezed or joined.
_LOG_ODDS_OF_EXIF = -12.0
_LOG_ODDS_OF_WIDE = -6.0
_LOG_ODDS_OF_EDITED = -7.0
_LOG_ODDS_OF_SHAPE = -3.0
_SHAPES = (5 / 4, 4 / 3, 3 / 2, 8 / 5, 16 / 9)  # of sensors: the longer side over the shorter
_SAME_SHAPE = 0.015  # difference of two shapes' logarithms
# Prior log-odds of two cameras if the images have one size: without EXIF data, or with the same,
# where an unknown lens and centre may pass for a zoom.
_TWO = -2.2
_TWO_OF_EXIF = -20.0
_TWO_LENS_STD = 0.02  # deviation of each lens: one camera's zoom hardly changes its lens
# Deviations of ln f, of the principal point over the longer side, of the lens and of ln fy / fx: of
# what a model opens, and of the rest of a K that is contradicted in a part, which is not exact.
_FOCAL_STD = 0.5
_CENTRE_STD = 0.05
_LENS_STD = 0.15
_ASPECT_STD = 0.3
_LOOSE_FOCAL_STD = 0.02
_LOOSE_LENS_STD = 0.02
# Of a camera that only turned
_TURNED_FOCAL_STD = 0.2
_TURNED_LENS_STD = 0.2
_TURNED_OPEN_LENS_STD = 0.08  # the same without a K: a plane that moves is no turn
_CROP_CENTRE_STD = 0.02  # of the principal point of a crop, over the longer side
# Distance of K's principal point from the middle, over the longer side, from which it is off it.
_OFF = 0.01
_LOG_ODDS_OF_CUT = -0.5  # prior log-odds of the middle if K is far from it
# Deviations of ln f of a scaled copy of the photograph of K, and of the principal point from the
# middle of a part of it, over the longer side.
_CUT_FOCAL_STD = 0.2
_CUT_CENTRE_STD = 0.2
# Corrected verticals, which are cut too, or a shift lens: prior log-odds, and the deviation of the
# principal point over the longer side.
_LOG_ODDS_OF_SHIFT = -11.0
_SHIFT_CENTRE_STD = 0.1
_LOG_ODDS_OF_PICTURE = -9.0  # of a usual K that says nothing of its picture
_OTHER_FOCAL = 0.02  # least relative difference of two K, or of two focal lengths


class Variant(NamedTuple):
    """The cameras of a model before their fit, and its prior log-odds."""

    cameras: Cameras
    log_odds: float


def are_stated(cameras: Cameras) -> bool:
    """Whether both images have a K."""
    return all(camera.focal_source == "given" for camera in cameras)


def nothing(stated: Cameras) -> Iterator[Variant]:
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
                focal_std=_FOCAL_STD,
                centre_std=_CENTRE_STD * max(image_size(camera)),
                lens_std=_LENS_STD if base.has_radial_lens else 0.0,
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


def without_K(
    change: Callable[[Camera], Camera], usual_log_odds: float
) -> Callable[[Cameras], Iterator[Variant]]:
    """The variants of a model that changes each camera without a K in the same way."""

    def log_odds(camera: Camera) -> float:
        if not has_sensor_shape(camera):
            return _LOG_ODDS_OF_SHAPE
        return _LOG_ODDS_OF_EXIF if camera.focal_source == "exif" else usual_log_odds

    def variants(stated: Cameras) -> Iterator[Variant]:
        first, second = (change(camera) if is_open(camera) else camera for camera in stated)
        odds = [
            log_odds(before)
            for before, changed in zip(stated, (first, second), strict=True)
            if changed is not before
        ]
        if odds:
            yield Variant((first, second), max(odds))

    return variants


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


def tail(stated: Cameras) -> Iterator[Variant]:
    """The less likely part of a focal length's prior: of one camera, or of each of two."""
    if _is_one(stated):
        priors = [camera.focal_prior for camera in stated if camera.focal_prior is not None]
        if len(priors) == 2:
            usual, tail = _parts(stated[0], [prior.lines for prior in priors])
            first, second = (with_part(camera, tail) for camera in stated)
            yield Variant((first, second), tail.log_weight - usual.log_weight)
        return
    for number, camera in enumerate(stated):
        if camera.focal_prior is not None:
            usual, tail = _parts(camera, [camera.focal_prior.lines])
            other = with_part(camera, tail)
            cameras = (stated[0], other) if number else (other, stated[1])
            yield Variant(cameras, tail.log_weight - usual.log_weight)


def two(stated: Cameras) -> Iterator[Variant]:
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
        odds_of_two = _TWO_OF_EXIF
    else:
        first, second = (prior.parts([prior.lines])[0] for prior in priors)
        choices = [(first, second)]
        odds_of_two = _TWO
    for part1, part2 in choices:
        odds = odds_of_two + part1.log_weight + part2.log_weight - before.log_weight
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


# Models in place of a K


def in_place_of_K(
    change: Callable[[Cameras], Cameras], log_odds: float
) -> Callable[[Cameras], Iterator[Variant]]:
    """The variants of a model that changes two cameras whose K is stated."""

    def variants(stated: Cameras) -> Iterator[Variant]:
        if are_stated(stated):
            cameras = change(stated)
            if cameras[0] is not stated[0] or cameras[1] is not stated[1]:
                yield Variant(cameras, log_odds)

    return variants


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
    one = _have_one_focal(cameras) if one is None else one
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


def _have_one_focal(cameras: Cameras) -> bool:
    ratio = abs(math.log(cameras[0].focal / cameras[1].focal))
    return cameras[0].size == cameras[1].size and ratio < _OTHER_FOCAL


def _lensed(cameras: Cameras) -> Cameras:
    """A radial lens that differs from the stated one."""
    if not any(camera.has_radial_lens for camera in cameras):
        return cameras
    return loosened(cameras, lens=_LENS_STD)


def _unlensed(cameras: Cameras) -> Cameras:
    """Images that are undistorted already."""
    if all(camera.distortion is None for camera in cameras):
        return cameras
    loose = loosened(cameras)
    first, second = (replace(camera, distortion=None, lens_std=0.0) for camera in loose)
    return first, second


def _swapped(cameras: Cameras) -> Cameras:
    """Each image with the K and lens of the other."""
    first, second = cameras
    is_same = np.allclose(first.K, second.K, rtol=_OTHER_FOCAL)
    if first.size != second.size or (is_same and first.distortion == second.distortion):
        return cameras
    return _with_K_of(first, second), _with_K_of(second, first)


def _with_K_of(camera: Camera, other: Camera) -> Camera:
    return replace(
        camera,
        K=other.K,
        distortion=other.distortion,
        focal_std=other.focal_std,
        centre_std=other.centre_std,
        lens_std=other.lens_std,
        aspect_std=other.aspect_std,
    )


def _shifted(stated: Cameras) -> Iterator[Variant]:
    """The principal point of one image, or of both, far from that of K."""
    first, second = loosened(stated, one=False)
    shifted1, shifted2 = (
        replace(
            camera,
            focal_std=max(camera.focal_std, _CUT_FOCAL_STD),
            centre_std=max(camera.centre_std, _SHIFT_CENTRE_STD * max(image_size(camera))),
        )
        for camera in (first, second)
    )
    yield Variant((shifted1, second), _LOG_ODDS_OF_SHIFT)
    yield Variant((first, shifted2), _LOG_ODDS_OF_SHIFT)
    yield Variant((shifted1, shifted2), _LOG_ODDS_OF_SHIFT)


def centre(stated: Cameras) -> Iterator[Variant]:
    """A principal point near that of K; far from it, as of corrected verticals; or anywhere, as of
    a part of the photograph of K."""
    yield from _near_centre(stated)
    if _have_K_and_pictures(stated):
        yield from _shifted(stated)
    if _may_be_cut(stated):
        loose = loosened((_centred(stated[0]), _centred(stated[1])), one=False)
        first, second = (
            replace(camera, centre_std=_CUT_CENTRE_STD * max(image_size(camera)))
            if from_middle(before) > FAR_OFF
            else camera
            for before, camera in zip(stated, loose, strict=True)
        )
        yield Variant((first, second), _LOG_ODDS_OF_CUT)


def middle(stated: Cameras) -> Iterator[Variant]:
    """The principal point in the middle, as of a frame cut from the photograph of K, or scaled."""
    if _have_K_and_pictures(stated) and max(map(from_middle, stated)) >= _OFF:
        cameras = loosened((_centred(stated[0]), _centred(stated[1])), focal=_CUT_FOCAL_STD)
        yield Variant(cameras, _LOG_ODDS_OF_CUT if _may_be_cut(stated) else -10.0)


def _may_be_cut(stated: Cameras) -> bool:
    """Whether a K may be that of a larger photograph, or of one of another scale."""
    if not _have_K_and_pictures(stated):
        return False
    return max(map(from_middle, stated)) > FAR_OFF and all(map(is_inner, stated))


def _have_K_and_pictures(stated: Cameras) -> bool:
    return are_stated(stated) and all(map(has_picture, stated))


def _centred(camera: Camera) -> Camera:
    if from_middle(camera) < _OFF:
        return camera
    K = camera.K.copy()
    K[:2, 2] = (np.array(image_size(camera)) - 1) / 2
    return replace(camera, K=K)


def picture(stated: Cameras) -> Iterator[Variant]:
    """The cameras as without K: one camera, or one for each image."""
    if not _have_K_and_pictures(stated):
        return
    first, second = map(picture_camera, stated)
    odds = _LOG_ODDS_OF_PICTURE + max(map(improbability, stated))
    of_one, of_two = (0.0, _TWO) if _have_one_focal(stated) else (2 * _TWO, 0.0)
    if first.identity == second.identity:
        yield Variant((first, second), odds + of_one)
    separate = replace(first, identity=None), replace(second, identity=None)
    yield Variant(separate, odds + of_two)


squeezed = without_K(_squeezed, _LOG_ODDS_OF_EDITED)
off_centre = without_K(_off_centre, _LOG_ODDS_OF_EDITED)
fisheye = without_K(_wide(Distortion(FISHEYE, (0.0,) * 4), 0.55, 0.35), _LOG_ODDS_OF_WIDE)
cylinder = without_K(_wide(Distortion(CYLINDER), 0.6, 0.4), _LOG_ODDS_OF_WIDE)
focal = in_place_of_K(partial(loosened, focal=_FOCAL_STD, one=True), -5.5)
focals = in_place_of_K(partial(loosened, focal=_FOCAL_STD, one=False), -8.0)
lens = in_place_of_K(_lensed, -5.5)
_near_centre = in_place_of_K(partial(loosened, centre=_CENTRE_STD), -11.0)
unlensed = in_place_of_K(_unlensed, -9.0)
swapped = in_place_of_K(_swapped, -12.0)
