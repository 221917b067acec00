"""The camera of an image without a K: a focal length with its deviation, by EXIF data or the size,
and by the image's lines.

The principal point is the middle of the image, and the lens is not known.
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

from dgc_pose.cameras.camera import LOG_FOCALS, Camera, FocalBelief, FocalSource, Part
from dgc_pose.images.decoding import Exif
from dgc_pose.system.files import scratch_folder
from dgc_pose.system.parallel import in_threads, one_blas_thread

if TYPE_CHECKING:
    from dgc_pose.images.decoding import Header
    from dgc_pose.images.image import Image

Sharing = Literal["files", "shared", "two"]
SHARED = "shared"  # the identity of a camera that took all images, as stated
# Geometric middle of the focal lengths of photographs, over the longer side, and the deviation of
# their logarithm; the share, middle and deviation of those that are zoomed in or of long lenses.
SIZE_FOCAL, SIZE_STD = 0.9, 0.35
_LONG_SHARE, _LONG_FOCAL, _LONG_STD = 0.15, 2.0, 0.7
OTHER_STD = 0.55  # of all together, around `SIZE_FOCAL`
_OTHER_SHARE = 0.03  # of files whose EXIF data are of another crop or lens
_BY_LINES = 0.8  # of the deviation before, below which the lines determine the focal length
# Deviations of the first radial coefficient of a lens: of photographs as cameras wrote them, of
# action cameras, and of pictures without EXIF data, which have mostly been corrected.
LENS_STD, _ACTION_LENS_STD, _SIZE_LENS_STD = 0.1, 0.3, 0.05
_ACTION = re.compile(r"gopro|hero\d|action|insta360", re.IGNORECASE)  # make and model
CENTRE_STD = 0.005  # of the principal point from the middle, over the longer side

_FILM_DIAGONAL_MM = 43.27  # of 36 mm x 24 mm
_BLANK_WIDTH = 1000  # of the image that COLMAP reads, pixels

# Deviations of the logarithm of the focal length in pixels. That on 35 mm film: EXIF leaves open
# which side of the images it holds for; cameras' makers agreed on the diagonal (CIPA DCG-001), and
# by the width it would be 4 % less at 4:3. Pixels that the correction of distortion and shake
# leaves out are a few per cent too. A telephone of 2011 has 5 to 14 % less, a Kodak 1 to 4 % more.
_FILM_FOCAL_STD = 0.08
_ROUNDING_STD_MM = 0.29  # deviation of a number that is rounded to an integer
# The lens and the resolution of the sensor are nominal; the focus changes the focal length.
_SENSOR_RESOLUTION_STD = 0.06
# As before; and the table's width may be of another part of the sensor than the image's.
_SENSOR_TABLE_STD = 0.08
# More for a digital zoom, which some telephones write of one of two steps, and for an image that
# was cut out of another.
_ZOOM_STD, _CUT_STD = 0.1, 0.05

_PLAUSIBLE_FOCALS = (0.2, 20.0)  # over the longer side: fields of view of 136 to 3 degrees
_SENSOR_RANGE_MM = (1.5, 80.0)  # widths and diagonals
_MAX_WIDTH_DIFFERENCE = 0.1  # of the logarithms of two widths of one sensor
# Sensors are 5:4 to 3:2; images of another shape are mostly parts of one of 4:3.
_SENSOR_ASPECT_RANGE, _USUAL_ASPECT = (1.24, 1.52), 4 / 3


class _Whole(NamedTuple):
    """The image that the camera wrote, of which there may be a part, at the part's scale."""

    width: float
    height: float
    scale: float = 1.0  # to this from the pixels that the camera wrote
    std: float = 0.0  # of the logarithm of the scale


def auto_camera(image: Image | Header, sharing: Sharing = "files") -> Camera:
    """The camera of an image without a K: its focal length by its EXIF data, else by its size.

    EXIF's focal length on 35 mm film comes first; then that of the lens, with the resolution on the
    sensor or the sensor's width in COLMAP's table. Where they contradict each other, or give the
    field of view of no photograph, the size is taken, with a warning. fx is fy / `pixel_aspect`.

    sharing: of "files" the `identity` is equal for images that one camera may have taken: of the
    same size and pixels, in either orientation, whose EXIF data name the same camera, lens, focal
    length and zoom, or none. Of two images of which one has lost its EXIF data it is not known that
    one camera took both. "shared": one for all; "two": None.
    """
    width, height = image.size
    exif = image.exif
    names = (exif.make, exif.model, exif.lens, exif.focal_mm, exif.focal_35mm)
    identity, aspect = f"auto {max(image.size)} x {min(image.size)}", image.pixel_aspect
    identity += "" if aspect == 1 else f", pixels of {aspect ** (1 if width >= height else -1):.4g}"
    square = (width * aspect, float(height))  # the size with square pixels
    mean = (1 + 1 / aspect) / 2  # of the focal lengths along x and y, over the latter
    if any(names):
        identity += "".join(f", {name or '-'}" for name in (*names, exif.digital_zoom))
    source: FocalSource = "size"
    focal, std, margin, warnings = SIZE_FOCAL * max(square), SIZE_STD, 0.0, list[str]()
    usual = Part(math.log(1 - _LONG_SHARE), math.log(SIZE_FOCAL), SIZE_STD)
    tail = Part(math.log(_LONG_SHARE), math.log(_LONG_FOCAL), _LONG_STD)
    if by_exif := _exif_focal(exif, square):
        source, (focal, std, margin) = "exif", by_exif
        identity += f", {mean * focal:.1f} px"  # parts of several sizes differ in nothing else
        usual = Part(math.log(1 - _OTHER_SHARE), math.log(focal / max(square)), std)
        tail = Part(math.log(_OTHER_SHARE), math.log(SIZE_FOCAL), OTHER_STD)
        if exif.size is not None and margin:
            warnings.append(
                f"{width}x{height} pixels are a part of the {exif.size[0]}x{exif.size[1]} of the "
                "EXIF data, or squeezed: focal length and principal point are less certain"
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
        belief=FocalBelief(usual, tail, np.zeros(len(LOG_FOCALS))),
    )


@one_blas_thread()
def with_lines(cameras: Sequence[Camera], images: Sequence[Image]) -> list[Camera]:
    """Cameras by the lines of their images, see `by_lines`; a camera that is stated stays."""
    from dgc_pose.cameras.lines import log_likelihoods

    open_ = [image for c, image in zip(cameras, images, strict=True) if c.belief is not None]
    found = iter(in_threads(log_likelihoods, open_))
    return by_lines(cameras, [None if camera.belief is None else next(found) for camera in cameras])


def by_lines(cameras: Sequence[Camera], lines: Sequence[np.ndarray | None]) -> list[Camera]:
    """Cameras with the lines of their images, those of one `identity` together: by the likelier
    part of their belief.

    lines: (G,) of each image, see `log_likelihoods`; None where they are not known. A camera
    without a belief stays. EXIF data that the lines contradict are of another camera: there is a
    warning.
    """
    keys = [camera.identity or number for number, camera in enumerate(cameras)]
    together = defaultdict[object, list[np.ndarray]](list)
    for key, own in zip(keys, lines, strict=True):
        if own is not None and own.any():
            together[key].append(own)
    return [
        _by_lines(camera, camera.belief, own, together[key])
        if camera.belief and together[key]
        else camera
        for key, camera, own in zip(keys, cameras, lines, strict=True)
    ]


def _by_lines(
    camera: Camera, belief: FocalBelief, own: np.ndarray | None, lines: Sequence[np.ndarray]
) -> Camera:
    """own, lines: (G,) of the camera's image, and of all images of the camera."""
    part, _ = belief.parts(lines)
    found, before = of_part(camera, part), belief.usual
    if own is not None:
        found = replace(found, belief=replace(belief, lines=own))
    if camera.focal_source != "exif":
        by_lines = part.std < _BY_LINES * before.std
        return replace(found, focal_source="lines") if by_lines else found
    if abs(part.log_focal - before.log_focal) <= 3 * math.hypot(before.std, part.std):
        return found
    warning = (
        f"the lines of the image agree with f = {found.focal:.0f} px +- {100 * part.std:.0f} %, "
        f"and EXIF says {camera.focal:.0f}"
    )
    return replace(found, focal_source="lines", warnings=(*camera.warnings, warning))


def of_part(camera: Camera, part: Part) -> Camera:
    """The camera with the focal length of a part of its belief."""
    assert camera.size is not None
    (width, height), (fx, fy) = camera.size, camera.K.diagonal()[:2].tolist()
    along_y = math.exp(part.log_focal) * max(width * fy / fx, height)
    return replace(camera.with_focal(camera.focal * along_y / fy), focal_std=part.std)


def _exif_focal(exif: Exif, size: tuple[float, float]) -> tuple[float, float, float] | None:
    """The focal length of an image of `size` (width, height), pixels; the standard deviation of its
    logarithm; and how many pixels the image that the camera wrote is larger. None without one."""
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

    sharing: whether one camera took both: "files" decides by the `identity` of both. Of a "shared"
    camera the EXIF data of one image are those of the other, if that has none and is as large.
    """
    camera1, camera2 = auto_camera(image1, sharing), auto_camera(image2, sharing)
    if sharing == "two":
        return replace(camera1, identity="image1"), replace(camera2, identity="image2")
    if sharing == SHARED and sorted(image1.size) == sorted(image2.size):
        best = min(camera1, camera2, key=lambda camera: camera.focal_std)
        return _with_focal(camera1, best), _with_focal(camera2, best)
    return camera1, camera2


def _with_focal(camera: Camera, other: Camera) -> Camera:
    if camera.focal_source == "exif":
        return camera
    K, focals = camera.K.copy(), other.K.diagonal()[:2]
    K[[0, 1], [0, 1]] = focals if camera.size == other.size else focals[::-1]
    std, source, belief = other.focal_std, other.focal_source, other.belief
    return replace(camera, K=K, focal_std=std, focal_source=source, belief=belief)


def _whole(exif: Exif, size: tuple[float, float]) -> _Whole | None:
    """None if the image is neither the one that the camera wrote, at any scale, nor a part of it.

    A part is as large as it was, or as large as shows the most of the other image: the scale is the
    middle of both.
    """
    if exif.size is None:
        return _Whole(*size)
    (width, height), sides = size, exif.size
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
    """The focal lengths and their deviations: by that on film; by that of the lens with the
    sensor's resolution, and with its width in COLMAP's table. Editors leave the resolution of an
    image that they made smaller: the table overrules it."""
    film, lens, zoom = exif.focal_35mm, exif.focal_mm, exif.digital_zoom
    zoom_std = _ZOOM_STD if zoom > 1 else 0.0
    longer, shorter = max(whole.width, whole.height), min(whole.width, whole.height)
    sensor = 0.0 if lens is None or film is None else _FILM_DIAGONAL_MM * lens / film
    if film is not None and (lens is None or _is_sensor(sensor) or _is_sensor(sensor * zoom)):
        # An image of no sensor's shape: between its diagonal and that of the sensor's image.
        diagonal, shape_std = math.hypot(longer, shorter), 0.0
        if not _SENSOR_ASPECT_RANGE[0] <= longer / shorter <= _SENSOR_ASPECT_RANGE[1]:
            whole_diagonal = max(longer, _USUAL_ASPECT * shorter) * math.hypot(1, 1 / _USUAL_ASPECT)
            shape_std = math.log(whole_diagonal / diagonal) / 2
            diagonal = math.sqrt(diagonal * whole_diagonal)
        # EXIF leaves open whether the focal length on film has the zoom in it: some makers' does.
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
    """The longer side of a camera's sensor, millimetres, in COLMAP's table; None if it has no such
    camera."""
    if not (make and model):
        return None
    from dgc_pose.system.colmap_library import pycolmap

    # The table itself is out of reach: COLMAP gives the focal length of an image file in pixels.
    exif = PIL.Image.Exif()
    exif[Base.Make], exif[Base.Model] = make, model
    exif.get_ifd(IFD.Exif)[Base.FocalLength] = IFDRational(1, 1)
    with scratch_folder() as folder:
        path = folder / "blank.jpg"
        PIL.Image.new("L", (_BLANK_WIDTH, 8)).save(path, exif=exif)
        camera = pycolmap.infer_camera_from_image(path)
    return _BLANK_WIDTH / camera.focal_length if camera.has_prior_focal_length else None


def _is_sensor(mm: float) -> bool:
    return _SENSOR_RANGE_MM[0] <= mm <= _SENSOR_RANGE_MM[1]
