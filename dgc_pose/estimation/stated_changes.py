"""Other cameras that two images may have than those that their K state, for the rows of
`camera_model`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from dgc_pose.cameras.camera import Camera, image_size
from dgc_pose.cameras.prior import (
    FAR_OFF,
    from_middle,
    has_picture,
    improbability,
    is_inner,
    picture_camera,
)
from dgc_pose.estimation.camera_changes import (
    LOG_ODDS_OF_TWO,
    OPEN_CENTRE_STD,
    OPEN_FOCAL_STD,
    OPEN_LENS_STD,
    OTHER_FOCAL,
    Cameras,
    Change,
    Variant,
    are_stated,
    have_one_focal,
    loosened,
)

# Distance of K's principal point from the middle, over the longer side, from which it is off it.
_OFF = 0.01
LOG_ODDS_OF_CUT = -0.5  # prior log-odds of the middle if K is far from it
# Deviations of ln f of a scaled copy of the photograph of K, and of the principal point from the
# middle of a part of it, over the longer side.
_CUT_FOCAL_STD = 0.2
_CUT_CENTRE_STD = 0.2
# Deviation of the principal point over the longer side, of corrected verticals, which are cut too,
# or of a shift lens.
_SHIFT_CENTRE_STD = 0.1


def in_place_of_K(change: Callable[[Cameras], Cameras]) -> Change:
    """Of a model that changes two cameras whose K is stated."""

    def variants(stated: Cameras, log_odds: float) -> Iterator[Variant]:
        if are_stated(stated):
            cameras = change(stated)
            if cameras[0] is not stated[0] or cameras[1] is not stated[1]:
                yield Variant(cameras, log_odds)

    return variants


def _lensed(cameras: Cameras) -> Cameras:
    """A radial lens that differs from the stated one."""
    if not any(camera.has_radial_lens for camera in cameras):
        return cameras
    return loosened(cameras, lens=OPEN_LENS_STD)


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
    is_same = np.allclose(first.K, second.K, rtol=OTHER_FOCAL)
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


def _shifted(stated: Cameras, log_odds: float) -> Iterator[Variant]:
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
    yield Variant((shifted1, second), log_odds)
    yield Variant((first, shifted2), log_odds)
    yield Variant((shifted1, shifted2), log_odds)


def centre(stated: Cameras, log_odds: float) -> Iterator[Variant]:
    """A principal point near that of K; far from it, as of corrected verticals; or anywhere, as of
    a part of the photograph of K."""
    yield from _near_centre(stated, log_odds)
    if _have_K_and_pictures(stated):
        yield from _shifted(stated, log_odds)
    if _may_be_cut(stated):
        loose = loosened((_centred(stated[0]), _centred(stated[1])), one=False)
        first, second = (
            replace(camera, centre_std=_CUT_CENTRE_STD * max(image_size(camera)))
            if from_middle(before) > FAR_OFF
            else camera
            for before, camera in zip(stated, loose, strict=True)
        )
        yield Variant((first, second), LOG_ODDS_OF_CUT)


def middle(stated: Cameras, log_odds: float) -> Iterator[Variant]:
    """The principal point in the middle, as of a frame cut from the photograph of K, or scaled."""
    if _have_K_and_pictures(stated) and max(map(from_middle, stated)) >= _OFF:
        cameras = loosened((_centred(stated[0]), _centred(stated[1])), focal=_CUT_FOCAL_STD)
        yield Variant(cameras, LOG_ODDS_OF_CUT if _may_be_cut(stated) else log_odds)


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


def picture(stated: Cameras, log_odds: float) -> Iterator[Variant]:
    """The cameras as without K: one camera, or one for each image. log_odds: for a usual K, whose
    picture would be as probable without it."""
    if not _have_K_and_pictures(stated):
        return
    first, second = map(picture_camera, stated)
    odds = log_odds + max(map(improbability, stated))
    have_one = have_one_focal(stated)
    if first.identity == second.identity:
        yield Variant((first, second), odds + (0.0 if have_one else 2 * LOG_ODDS_OF_TWO))
    separate = replace(first, identity=None), replace(second, identity=None)
    yield Variant(separate, odds + (LOG_ODDS_OF_TWO if have_one else 0.0))


focal = in_place_of_K(partial(loosened, focal=OPEN_FOCAL_STD, one=True))
focals = in_place_of_K(partial(loosened, focal=OPEN_FOCAL_STD, one=False))
lens = in_place_of_K(_lensed)
_near_centre = in_place_of_K(partial(loosened, centre=OPEN_CENTRE_STD))
unlensed = in_place_of_K(_unlensed)
swapped = in_place_of_K(_swapped)
