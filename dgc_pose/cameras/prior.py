"""The camera of an image without a K: a focal length and its deviation, from EXIF data or the image
size, and from the lines of the image.

The principal point is the middle of the image, and the lens is unknown.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from dgc_pose.cameras.camera import (
    LOG_FOCALS,
    LOGS,
    Camera,
    FocalPrior,
    FocalSource,
    Part,
    image_size,
)
from dgc_pose.cameras.exif_focal import exif_focal
from dgc_pose.images.decoding import Header
from dgc_pose.system.parallel import in_threads, one_blas_thread

if TYPE_CHECKING:
    from dgc_pose.images.image import Image

Sharing = Literal["files", "shared", "two"]
SHARED = "shared"  # the identity of a camera that is stated to have taken all images
# Geometric mean of the focal lengths of photographs over the longer side, and the standard
# deviation of their logarithm; then the share, mean and deviation of zoomed-in or long lenses.
SIZE_FOCAL = 0.9
SIZE_STD = 0.35
_LONG_SHARE = 0.15
_LONG_FOCAL = 2.0
_LONG_STD = 0.7
OTHER_STD = 0.55  # of all photographs together, around `SIZE_FOCAL`
_OTHER_SHARE = 0.03  # files with EXIF data of another crop or lens
# A K that hardly any photograph has: f over the longer side, fx / fy over that of the pixels, the
# distance of the principal point from the middle over the side; and the log-odds against each.
_USUAL_FOCALS = (0.3, 4.0)
_USUAL_RATIO = 1.3
_INNER = 0.25
_EXTREME = 20.0
MOUNTED_STD = 0.02  # of the principal point of a whole photograph, by the mounting of its lens
FAR_OFF = 0.04  # distance of the principal point from the middle, over the longer side, of a part
_LEAST_SIDE = 32  # of an image whose size follows from the principal point, pixels
USUAL_K = 2.0  # improbability of a stated K up to which it is usual
_LINES_STD_RATIO = 0.8  # the lines determine f if they reduce its deviation below this share
# Standard deviations of the first radial coefficient: photographs as cameras wrote them, action
# cameras, and images without EXIF data, most of which have been corrected.
LENS_STD = 0.1
_ACTION_LENS_STD = 0.3
_SIZE_LENS_STD = 0.05
_ACTION = re.compile(r"gopro|hero\d|action|insta360", re.IGNORECASE)  # make and model
CENTRE_STD = 0.005  # of the principal point from the middle, over the longer side


def auto_camera(image: Image | Header, sharing: Sharing = "files") -> Camera:
    """The camera of an image without a K: the focal length from EXIF data, else from the size.

    The focal length on 35 mm film comes first; then the focal length of the lens, with the
    resolution on the sensor or with the sensor's width in COLMAP's table. If the two contradict
    each other or give an impossible field of view, the size decides, with a warning. fx is fy /
    `pixel_aspect`.

    sharing: determines the `identity`. "files": equal for images that one camera may have taken:
    same size in either orientation, same pixel aspect, and same camera, lens, focal length and zoom
    in EXIF data, or no EXIF data. "shared": equal for all images. "two": None.
    """
    width, height = image.size
    exif = image.exif
    names = (exif.make, exif.model, exif.lens, exif.focal_mm, exif.focal_35mm)
    identity = f"auto {max(image.size)} x {min(image.size)}"
    aspect = image.pixel_aspect
    identity += "" if aspect == 1 else f", pixels of {aspect ** (1 if width >= height else -1):.4g}"
    square = (width * aspect, float(height))  # the size with square pixels
    mean = (1 + 1 / aspect) / 2  # of the focal lengths along x and y, over fy
    if any(names):
        identity += "".join(f", {name or '-'}" for name in (*names, exif.digital_zoom))
    source: FocalSource = "size"
    focal = SIZE_FOCAL * max(square)
    std = SIZE_STD
    margin = 0.0
    warnings = list[str]()
    usual = Part(math.log(1 - _LONG_SHARE), math.log(SIZE_FOCAL), SIZE_STD)
    tail = Part(math.log(_LONG_SHARE), math.log(_LONG_FOCAL), _LONG_STD)
    if by_exif := exif_focal(exif, square):
        source = "exif"
        focal, std, margin = by_exif
        identity += f", {mean * focal:.1f} px"  # separates crops of different scale
        usual = Part(math.log(1 - _OTHER_SHARE), math.log(focal / max(square)), std)
        tail = Part(math.log(_OTHER_SHARE), math.log(SIZE_FOCAL), OTHER_STD)
        if exif.size is not None and margin:
            warnings.append(
                f"{width}x{height} pixels, cropped or squeezed from the "
                f"{exif.size[0]}x{exif.size[1]} of the EXIF data: focal length and "
                "principal point are less certain"
            )
    elif exif.focal_35mm is not None or (exif.focal_mm and exif.pixels_per_mm):
        lengths = {"on 35 mm film": exif.focal_35mm, "of the lens": exif.focal_mm}
        words = " and ".join(f"{mm:g} mm {kind}" for kind, mm in lengths.items() if mm is not None)
        warnings.append(
            f"EXIF focal length {words} is impossible for {width}x{height} pixels: the size is "
            "used instead"
        )
    lens_std = LENS_STD if any(names) else _SIZE_LENS_STD
    if _ACTION.search(f"{exif.make} {exif.model}"):
        lens_std = _ACTION_LENS_STD
    return Camera(
        np.array([[focal / aspect, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]),
        image.size,
        warnings=tuple(warnings),
        focal_std=std,
        centre_std=mean * math.hypot(CENTRE_STD * max(square), margin / math.sqrt(12)),
        lens_std=lens_std,
        focal_source=source,
        identity={"files": identity, "shared": SHARED, "two": None}[sharing],
        projection=image.projection,
        focal_prior=FocalPrior(usual, tail, np.zeros(len(LOG_FOCALS))),
    )


def picture_camera(stated: Camera) -> Camera:
    """The camera of an image as without the K that is stated for it; by the size if no image is
    known."""
    width, height = image_size(stated)
    return stated.picture or auto_camera(Header("", (round(width), round(height))))


def has_picture(stated: Camera) -> bool:
    """Whether the size of the image is known, or follows from a principal point in its middle."""
    return stated.size is not None or min(image_size(stated)) > _LEAST_SIDE


def improbability(stated: Camera) -> float:
    """By how much a stated K is less probable than the likeliest one, in log-odds: by the focal
    length that its picture has, and by what no photograph has. 0 if no picture is known."""
    if not has_picture(stated):
        return 0.0
    picture = picture_camera(stated)
    assert picture.focal_prior is not None
    longer = max(image_size(stated))
    density = picture.focal_prior.log_density(LOGS)
    own = picture.focal_prior.log_density(np.log([stated.focal / longer]))
    usual = picture.focal_prior.usual
    as_usual = abs(math.log(stated.focal / longer) - usual.log_focal) < 3 * usual.std
    extreme = (
        not (as_usual or _USUAL_FOCALS[0] <= stated.focal / longer <= _USUAL_FOCALS[1]),
        not is_inner(stated),
        not has_usual_pixels(stated),
    )
    is_off = from_middle(stated) > FAR_OFF
    return float(density.max() - own[0]) + USUAL_K * is_off + _EXTREME * sum(extreme)


def has_usual_pixels(stated: Camera) -> bool:
    """Whether fx / fy is near that of the picture."""
    picture = picture_camera(stated)
    ratio = stated.K[0, 0] / stated.K[1, 1] / (picture.K[0, 0] / picture.K[1, 1])
    return abs(math.log(ratio)) <= math.log(_USUAL_RATIO)


def from_middle(camera: Camera) -> float:
    """How far the principal point is from the middle of the image, over the longer side."""
    size = np.array(image_size(camera))
    return float(np.abs(camera.K[:2, 2] - (size - 1) / 2).max() / size.max())


def is_inner(camera: Camera) -> bool:
    """Whether the principal point is in the middle half of the image."""
    size = np.array(image_size(camera))
    offset = np.abs(camera.K[:2, 2] - (size - 1) / 2) / size
    return bool((offset <= _INNER).all())


@one_blas_thread()
def with_pictures(cameras: Sequence[Camera], images: Sequence[Image]) -> list[Camera]:
    """If all have a K, add the cameras that their images have without it: by size and EXIF data,
    and by lines if a K is unusual."""
    if any(camera.focal_source != "given" for camera in cameras):
        return list(cameras)
    pictures = [auto_camera(image) for image in images]
    known = [replace(c, picture=p) for c, p in zip(cameras, pictures, strict=True)]
    if all(improbability(camera) < USUAL_K for camera in known):
        return known
    pictures = with_lines(pictures, images)
    return [replace(c, picture=p) for c, p in zip(cameras, pictures, strict=True)]


@one_blas_thread()
def with_lines(cameras: Sequence[Camera], images: Sequence[Image]) -> list[Camera]:
    """Update cameras with the lines of their images, see `by_lines`; a given K stays."""
    from dgc_pose.cameras.lines import log_likelihoods

    open_ = [image for c, image in zip(cameras, images, strict=True) if c.focal_prior is not None]
    found = iter(in_threads(log_likelihoods, open_))
    return by_lines(
        cameras, [None if camera.focal_prior is None else next(found) for camera in cameras]
    )


def by_lines(cameras: Sequence[Camera], lines: Sequence[np.ndarray | None]) -> list[Camera]:
    """Update cameras with the lines of their images; images of one `identity` share their lines.

    Each camera takes the likelier part of its prior; a camera without one stays. A camera
    whose EXIF data contradict the lines gets a warning.

    lines: log-likelihoods (G,) of each image, see `log_likelihoods`; None if unknown.
    """
    keys = [camera.identity or number for number, camera in enumerate(cameras)]
    together = defaultdict[object, list[np.ndarray]](list)
    for key, own in zip(keys, lines, strict=True):
        if own is not None and own.any():
            together[key].append(own)
    return [
        _by_lines(camera, camera.focal_prior, own, together[key])
        if camera.focal_prior and together[key]
        else camera
        for key, camera, own in zip(keys, cameras, lines, strict=True)
    ]


def _by_lines(
    camera: Camera, focal_prior: FocalPrior, own: np.ndarray | None, lines: Sequence[np.ndarray]
) -> Camera:
    """own: log-likelihoods (G,) of the camera's image; lines: of all images of the camera."""
    part, _ = focal_prior.parts(lines)
    found = with_part(camera, part)
    before = focal_prior.usual
    if own is not None:
        found = replace(found, focal_prior=replace(focal_prior, lines=own))
    if camera.focal_source != "exif":
        by_lines = part.std < _LINES_STD_RATIO * before.std
        return replace(found, focal_source="lines") if by_lines else found
    if abs(part.log_focal - before.log_focal) <= 3 * math.hypot(before.std, part.std):
        return found
    warning = (
        f"the lines of the image give f = {found.focal:.0f} px +- {100 * part.std:.0f} %, "
        f"EXIF data {camera.focal:.0f}: using the lines"
    )
    return replace(found, focal_source="lines", warnings=(*camera.warnings, warning))


def with_part(camera: Camera, part: Part) -> Camera:
    """The camera with the focal length and deviation of `part`, a part of its prior."""
    assert camera.size is not None
    width, height = camera.size
    fx, fy = camera.K.diagonal()[:2].tolist()
    along_y = math.exp(part.log_focal) * max(width * fy / fx, height)
    return replace(camera.with_focal(camera.focal * along_y / fy), focal_std=part.std)


def nearest_part(camera: Camera, focal: float) -> Camera:
    """The camera with the part of its prior that a focal length, pixels, is likelier of; unchanged
    without a prior."""
    prior = camera.focal_prior
    if prior is None:
        return camera
    log_focal = math.log(focal / max(image_size(camera)))
    parts = (prior.usual, prior.tail)
    return with_part(camera, max(parts, key=lambda part: part.log_density(log_focal)))


def auto_cameras(
    image1: Image | Header, image2: Image | Header, sharing: Sharing = "files"
) -> tuple[Camera, Camera]:
    """`auto_camera` of two images.

    sharing: whether one camera took both; "files": if the `identity` is equal. With "shared", an
    image without a focal length in EXIF takes that of the other image if their sizes are equal.
    """
    camera1 = auto_camera(image1, sharing)
    camera2 = auto_camera(image2, sharing)
    if sharing == "two":
        return replace(camera1, identity="image1"), replace(camera2, identity="image2")
    if sharing == SHARED and sorted(image1.size) == sorted(image2.size):
        best = min(camera1, camera2, key=lambda camera: camera.focal_std)
        return _with_focal(camera1, best), _with_focal(camera2, best)
    return camera1, camera2


def _with_focal(camera: Camera, other: Camera) -> Camera:
    if camera.focal_source == "exif":
        return camera
    K = camera.K.copy()
    focals = other.K.diagonal()[:2]
    K[[0, 1], [0, 1]] = focals if camera.size == other.size else focals[::-1]
    std = other.focal_std
    source = other.focal_source
    focal_prior = other.focal_prior
    return replace(camera, K=K, focal_std=std, focal_source=source, focal_prior=focal_prior)
