"""Cameras from the options --K, --K1 and --K2: a text, a file or a value.

- `auto`, `auto:shared` or `auto:two`: no K, see `prior.py`;
- `fx,fy,cx,cy` or nine numbers, split by commas or blanks; pixel (0, 0) is the centre of the
  top-left pixel;
- a COLMAP camera `MODEL,width,height,parameters...`, where this centre is (0.5, 0.5);
- a file in one of the formats of `formats/recognise.py`, or the folder of a COLMAP model;
- `FILE:PART`, a camera of a rig, such as `camchain.yaml:cam1`;
- any of these except `auto`, followed by `,lens`: the lens is unknown and is fitted.
"""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

from dgc_pose.cameras.by_image import NO_DETAILS, Calibration, KDetails, fitted_camera
from dgc_pose.cameras.camera import Camera, FocalSource, matrix_camera, view_camera
from dgc_pose.cameras.formats import colmap
from dgc_pose.cameras.formats.keyed import keyed_camera, numbers, numbers_camera
from dgc_pose.cameras.formats.recognise import read_file
from dgc_pose.cameras.prior import LENS_STD, Sharing, auto_cameras, with_lines, with_pictures
from dgc_pose.errors import ArgumentName, InputError, shortened
from dgc_pose.images.image import Image
from dgc_pose.system.options import check_type

_LENS = ",lens"  # follows a K with an unknown lens
_SHARING: Mapping[str, Sharing] = {"auto": "files", "auto:shared": "shared", "auto:two": "two"}


def pair_cameras(
    K1: Any,
    K2: Any,
    image1: Image,
    image2: Image,
    names: tuple[str, str] = ("K1", "K2"),
    details: KDetails = NO_DETAILS,
    fov: float | None = None,
) -> tuple[Camera, Camera]:
    """The cameras of two images.

    K1, K2: a Camera, an array (3, 3), fx, fy, cx, cy, or a text or path as for --K; None is "auto".
    Without a K, the lines of the image contribute to the focal length. fov: horizontal field of
    view of both images, degrees, in place of K. names: of the arguments, for errors. Raises
    InputError if K is unusable, does not fit the image, or is stated together with `fov`.
    """
    images = image1, image2
    for image, name in zip(images, ("image1", "image2"), strict=True):
        check_type(image, Image, name)
    if fov is not None:
        if K1 is not None or K2 is not None:
            raise InputError(
                ArgumentName("fov"), f"and {names[K1 is None]} exclude each other: give only one"
            )
        first, second = (fitted_camera(view_camera(fov, i.size), details, i, "fov") for i in images)
        return first, second
    values = ["auto" if value is None else value for value in (K1, K2)]
    sharings = [_SHARING.get(value) if isinstance(value, str) else None for value in values]
    if sharings[0] is not None and sharings[1] is not None:
        if sharings[0] != sharings[1]:
            raise InputError(f"{names[0]} is {values[0]}, and {names[1]} is {values[1]}")
        _require_K(details, names[0])
        first, second = auto_cameras(*images, sharings[0])
    else:
        first = image_camera(values[0], image1, names[0], details, "K1")
        second = image_camera(values[1], image2, names[1], details, "K2")
    first, second = with_pictures(with_lines((first, second), images), images)
    return first, second


def image_camera(
    value: Any,
    image: Image,
    name: str = "K",
    details: KDetails = NO_DETAILS,
    part: str | None = None,
) -> Camera:
    """The camera of an image, as in `pair_cameras` but without its lines. part: "K1" or "K2" for an
    image of a pair."""
    value = "auto" if value is None else value
    if isinstance(value, (str, Path)):
        is_auto_of_pair = part is not None and value in _SHARING
        calibration = read_calibration(str(value), name, NO_DETAILS if is_auto_of_pair else details)
    else:
        camera = value if isinstance(value, Camera) else matrix_camera(value, name)
        camera = replace(camera, identity=camera.identity or name, focal_prior=None)
        calibration = Calibration(name, common=camera, details=details)
    return calibration.camera(Path(), image.name, image, part)


def single_camera(
    value: Any, image: Image, name: str = "K", details: KDetails = NO_DETAILS
) -> Camera:
    """The camera of an image that is no part of a pair: as in `pair_cameras`, with its lines."""
    (camera,) = with_lines([image_camera(value, image, name, details)], [image])
    return camera


def parse_camera(text: str, name: str = "K", *, files: bool = True) -> Camera:
    """Parse a camera, in any of this module's forms of a single camera.

    files: whether the text may be a path; False for untrusted text. Raises InputError, one line
    with `name`.
    """
    common = read_calibration(text, name).common if files else _parse_text(text, name)
    if common is None:
        raise InputError(f"{name}: {text} is not one camera for all images")
    return common


def read_calibration(
    text: str | None, name: str = "K", details: KDetails = NO_DETAILS
) -> Calibration:
    """The calibration of the argument K: a text or a path, see this module. None: no image has a
    camera. Raises InputError, with `name` or the path."""
    if text is None or text in _SHARING:
        _require_K(details, name)
        return Calibration(name, auto=_SHARING.get(text or ""))
    if text.endswith(_LENS) and not os.path.lexists(text):
        text = text.removesuffix(_LENS)
        details = replace(details, lens_std=LENS_STD)
    head, _, part = text.rpartition(":")
    if os.path.lexists(text):
        head = text
        part = ""
    elif not (head and os.path.lexists(head)):
        camera = replace(_parse_text(text, name), identity=name)
        return Calibration(name, common=camera, details=details)
    try:
        cameras = replace(read_file(Path(head)), details=details)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except OSError as error:
        raise InputError(f"{name}: {error.filename or head}: {error.strerror or error}") from error
    if part:
        named = {**cameras.by_name, **cameras.parts}
        if part not in named:
            parts = shortened(", ".join(cameras.parts)) or "a single camera"
            lacks = "no matrix of" if part in cameras.rig else "no"
            raise InputError(f"{name}: {head} has {parts}, and {lacks} {shortened(part)}")
        return Calibration(text, common=named[part], details=details)
    common = cameras.common
    if common is not None and common.identity is None:
        common = replace(common, identity=head)
    return replace(cameras, common=common)


def _parse_text(text: str, name: str) -> Camera:
    values = numbers(text)
    if values is not None and len(values) in (4, 9):
        return numbers_camera(values, name)
    if not colmap.is_line(text):
        raise InputError(
            f"{name}: {shortened(text)!r} is neither {', '.join(_SHARING)}, fx,fy,cx,cy nor "
            "MODEL,width,height,parameters nor a file"
        )
    try:
        return colmap.parse_line(text)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _require_K(details: KDetails, name: str) -> None:
    for option, value in (("size", details.size), ("std", details.focal_std or details.centre_std)):
        if value:
            raise InputError(ArgumentName(f"K_{option}"), f"needs a K, and {name} states none")


def camera_data(camera: Camera) -> dict[str, Any]:
    """Convert a camera to JSON data."""
    lens = camera.distortion
    return {
        "K": camera.K.tolist(),
        "size": camera.size,
        "model": None if lens is None else lens.model,
        "coefficients": None if lens is None else lens.coefficients,
        "warnings": camera.warnings,
        **camera.deviations,
        "focal_source": camera.focal_source,
        "identity": camera.identity,
        "projection": camera.projection,
    }


def parse_camera_data(data: Mapping[str, Any]) -> Camera:
    """The camera from `camera_data`. Raises KeyError, TypeError or ValueError for other data."""
    if data["focal_source"] not in get_args(FocalSource):
        raise ValueError(f"unknown focal_source {data['focal_source']!r:.60}")
    return replace(
        keyed_camera(data),
        warnings=tuple(data["warnings"]),
        focal_source=data["focal_source"],
        projection=data.get("projection", ""),  # absent in files of 0.2.0
    )
