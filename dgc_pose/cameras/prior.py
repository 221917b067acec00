"""The camera of an image without a K: a focal length and its deviation, from EXIF data or the image
size, and from the lines of the image.

The principal point is the middle of the image, and the lens is unknown.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import PIL.Image
from PIL.ExifTags import IFD, Base
from PIL.TiffImagePlugin import IFDRational

from dgc_pose.cameras.camera import (
    LOG_FOCALS,
    LOGS,
    Camera,
    FocalPrior,
    FocalSource,
    Part,
    image_size,
)
from dgc_pose.images.decoding import Exif, Header
from dgc_pose.system.files import scratch_folder
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

_FILM_DIAGONAL_MM = 43.27  # 36 mm x 24 mm
_BLANK_WIDTH = 1000  # of the image that COLMAP reads, pixels

# Standard deviations of ln(f in pixels). EXIF does not define which side of the image the focal
# length on 35 mm film refers to. Makers agreed on the diagonal (CIPA DCG-001); by the width, f
# would be 4 % less at 4:3. The correction of distortion and shake crops a few per cent too. A phone
# of 2011 has 5 to 14 % less, a Kodak 1 to 4 % more.
_FILM_FOCAL_STD = 0.08
_ROUNDING_STD_MM = 0.29  # of a number rounded to an integer
# The lens and the resolution of the sensor are nominal; the focus changes the focal length.
_SENSOR_RESOLUTION_STD = 0.06
# As above; and the table may have the width of another part of the sensor.
_SENSOR_TABLE_STD = 0.08
# Added for a digital zoom, which some phones write for only one of two steps, and for a crop.
_ZOOM_STD = 0.1
_CUT_STD = 0.05

_PLAUSIBLE_FOCALS = (0.2, 20.0)  # over the longer side: fields of view of 136 to 3 degrees
_SENSOR_RANGE_MM = (1.5, 80.0)  # widths and diagonals
_MAX_WIDTH_DIFFERENCE = 0.1  # between the logarithms of two widths of one sensor
# Sensors are 5:4 to 3:2; most images of another shape are crops of a 4:3 image.
_SENSOR_ASPECT_RANGE = (1.24, 1.52)
_USUAL_ASPECT = 4 / 3


class _Whole(NamedTuple):
    """Size of the image that the camera wrote, at the scale of the image, which may be a crop."""

    width: float
    height: float
    scale: float = 1.0  # pixels of the image per pixel that the camera wrote
    std: float = 0.0  # of the logarithm of the scale


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
    if by_exif := _exif_focal(exif, square):
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
        words = " and ".join(f"{mm:g} mm {of}" for of, mm in lengths.items() if mm is not None)
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
    """If all have a K, update the cameras with what their images say of it: by size and EXIF data,
    and by lines if a K is unusual."""
    if any(camera.focal_source != "given" for camera in cameras):
        return list(cameras)
    pictures = [auto_camera(image) for image in images]
    told = [replace(c, picture=p) for c, p in zip(cameras, pictures, strict=True)]
    if all(improbability(camera) < USUAL_K for camera in told):
        return told
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
    found = of_part(camera, part)
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


def of_part(camera: Camera, part: Part) -> Camera:
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
    return of_part(camera, max(parts, key=lambda part: part.log_density(log_focal)))


def _exif_focal(exif: Exif, size: tuple[float, float]) -> tuple[float, float, float] | None:
    """The EXIF focal length of an image of `size` (width, height), pixels; the standard deviation
    of its logarithm; and by how many pixels the image that the camera wrote is larger. None if EXIF
    has no plausible focal length."""
    if (whole := _whole(exif, size)) is None:
        return None
    for focal, std in _exif_focals(exif, whole):
        if _PLAUSIBLE_FOCALS[0] <= focal / max(size) <= _PLAUSIBLE_FOCALS[1]:
            margin = max(whole.width - size[0], whole.height - size[1])
            return focal, math.hypot(std, whole.std), margin
    return None


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


def _whole(exif: Exif, size: tuple[float, float]) -> _Whole | None:
    """The image that the camera wrote, from its size in EXIF data; None if the image is neither a
    scaled copy nor a crop of it.

    The scale of a crop lies between 1 and the smallest possible scale: the geometric mean is used.
    """
    if exif.size is None:
        return _Whole(*size)
    width, height = size
    sides = exif.size
    scale = max(size) / max(sides)
    if abs(scale * min(sides) - min(size)) <= 1 + 0.005 * min(size):
        return _Whole(width, height, scale)
    for whole in (sides, sides[::-1]):  # a rotated image may have the sides of the other
        least = max(width / whole[0], height / whole[1])
        if least <= 1:
            scale = math.sqrt(least)
            std = math.hypot(_CUT_STD, math.log(least) / 2)
            return _Whole(whole[0] * scale, whole[1] * scale, scale, std)
    return None


def _exif_focals(exif: Exif, whole: _Whole) -> Iterator[tuple[float, float]]:
    """Yield (focal length, deviation): from the focal length on film; from that of the lens with
    the sensor's resolution, then with its width in COLMAP's table. A resolution that the table
    contradicts is skipped: editors that shrink an image keep the old resolution."""
    film = exif.focal_35mm
    lens = exif.focal_mm
    zoom = exif.digital_zoom
    zoom_std = _ZOOM_STD if zoom > 1 else 0.0
    longer = max(whole.width, whole.height)
    shorter = min(whole.width, whole.height)
    sensor = 0.0 if lens is None or film is None else _FILM_DIAGONAL_MM * lens / film
    if film is not None and (lens is None or _is_sensor(sensor) or _is_sensor(sensor * zoom)):
        # No sensor has this shape: take the mean of this diagonal and that of a 4:3 image
        diagonal = math.hypot(longer, shorter)
        shape_std = 0.0
        if not _SENSOR_ASPECT_RANGE[0] <= longer / shorter <= _SENSOR_ASPECT_RANGE[1]:
            whole_diagonal = max(longer, _USUAL_ASPECT * shorter) * math.hypot(1, 1 / _USUAL_ASPECT)
            shape_std = math.log(whole_diagonal / diagonal) / 2
            diagonal = math.sqrt(diagonal * whole_diagonal)
        # Some makers include the zoom in the focal length on film; EXIF does not define it.
        std = math.hypot(
            *(_FILM_FOCAL_STD, _ROUNDING_STD_MM / film, shape_std, zoom_std, math.log(zoom) / 2)
        )
        yield math.sqrt(zoom) * film / _FILM_DIAGONAL_MM * diagonal, std
    if lens is None:
        return
    in_table = _sensor_width_mm(exif.make, exif.model)
    if exif.pixels_per_mm is not None:
        width = longer / whole.scale / exif.pixels_per_mm
        same = in_table is None or abs(math.log(width / in_table)) <= _MAX_WIDTH_DIFFERENCE
        if _is_sensor(width) and same:
            yield lens * zoom / width * longer, math.hypot(_SENSOR_RESOLUTION_STD, zoom_std)
    if in_table is not None:
        yield lens * zoom / in_table * longer, math.hypot(_SENSOR_TABLE_STD, zoom_std)


@lru_cache(maxsize=256)
def _sensor_width_mm(make: str, model: str) -> float | None:
    """The longer side of a camera's sensor, mm, from COLMAP's table; None if it is not there."""
    if not (make and model):
        return None
    from dgc_pose.system.colmap_library import pycolmap

    # COLMAP's table is not accessible: have COLMAP compute the focal length of an image file.
    exif = PIL.Image.Exif()
    exif[Base.Make] = make
    exif[Base.Model] = model
    exif.get_ifd(IFD.Exif)[Base.FocalLength] = IFDRational(1, 1)
    with scratch_folder() as folder:
        path = folder / "blank.jpg"
        PIL.Image.new("L", (_BLANK_WIDTH, 8)).save(path, exif=exif)
        camera = pycolmap.infer_camera_from_image(path)
    return _BLANK_WIDTH / camera.focal_length if camera.has_prior_focal_length else None


def _is_sensor(mm: float) -> bool:
    return _SENSOR_RANGE_MM[0] <= mm <= _SENSOR_RANGE_MM[1]
