"""Cameras from the options --K, --K1 and --K2: a text, a file or a value.

- `auto`, `auto:shared` or `auto:two`: no K, see `prior.py`;
- `fx,fy,cx,cy` or nine numbers, split by commas or blanks, (0, 0) the centre of the top-left pixel;
- a COLMAP camera `MODEL,width,height,parameters...`, (0.5, 0.5) there;
- a file of one of the formats of `formats/recognise.py`, or the folder of a COLMAP model;
- `FILE:PART`, a camera of a rig, such as `camchain.yaml:cam1`;
- any of these but the first and `,lens`: the lens is not known, and is fitted.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePath, PurePosixPath
from typing import TYPE_CHECKING, Any, get_args

from dgc_pose.cameras.camera import Camera, FocalSource, matrix_camera, view_camera
from dgc_pose.cameras.checks import checked_camera, times
from dgc_pose.cameras.formats import colmap
from dgc_pose.cameras.formats.keyed import keyed_camera, numbers, numbers_camera
from dgc_pose.cameras.formats.recognise import read_file
from dgc_pose.cameras.prior import (
    LENS_STD,
    Sharing,
    auto_camera,
    auto_cameras,
)
from dgc_pose.cameras.upright import orientation_of, upright_camera
from dgc_pose.errors import ArgumentName, InputError, shortened
from dgc_pose.images.image import Image, size_in_file

if TYPE_CHECKING:
    from dgc_pose.images.header import Header

_LENS = ",lens"  # after a K whose lens is not known
_SHARING: Mapping[str, Sharing] = {"auto": "files", "auto:shared": "shared", "auto:two": "two"}
_PART_FOLDER = re.compile(r"(image_|cam)0*(\d+)")  # of KITTI, Kalibr
_MAX_ASPECT_DIFFERENCE = 0.01  # of the sizes of an image and of its K: more is a crop


@dataclass(frozen=True)
class KDetails:
    """The size that a K refers to, its deviations, and the image that it is checked against."""

    size: tuple[int, int] | None = None  # (width, height) of the image that K refers to
    focal_std: float = 0.0  # relative, of the focal lengths
    centre_std: float = 0.0  # of each coordinate of the principal point, pixels of the image
    lens_std: float = 0.0  # of the radial coefficient of a camera without a lens, see `Camera`
    image: str = "the image"  # as messages call it
    other: tuple[int, int] | None = None  # (width, height) of the pair's other image


@dataclass(frozen=True)
class Calibration:
    """Cameras by the names of images, and the one of all others."""

    where: str  # of errors: the option or file that the cameras come from
    by_name: Mapping[str, Camera] = field(default_factory=dict)
    parts: Mapping[str, Camera] = field(default_factory=dict)  # of a rig or a pair, by name
    common: Camera | None = None  # of all other images
    # The images have no K. With "shared" one camera took all; with "two" one each.
    auto: Sharing | None = None
    details: KDetails = KDetails()

    def camera(
        self, root: Path, name: str, image: Image | Header, part: str | None = None
    ) -> Camera:
        """The camera of an upright image or its header, checked against its size; a K of the pixels
        as stored is turned with them, see `upright_camera`.

        root: the folder that `name` is relative to. part: of a pair, "K1" or "K2".

        Raises InputError if there is none, or if it is for another size.
        """
        camera = self.stated(root, name, part)
        if camera is not None:
            label = self.where if part and not self.by_name else f"{self.where}: {name}: K"
            return _fitted(camera, self.details, image, label)
        if self.auto is not None:
            return auto_camera(image, self.auto)
        if self.parts or self.by_name:
            *_, last = ("", *self.parts)
            other = f": another of its cameras is {self.where}:{last}" if last else ""
            raise InputError(f"{self.where} has no camera for {name}{other}")
        raise InputError(f"no camera for {name}: give", ArgumentName("K"), "or auto in its place")

    def stated(self, root: Path, name: str, part: str | None = None) -> Camera | None:
        """The camera of an image as the text or file states it; None without one."""
        return self.named(root, name) or self._of_part(root / name, part) or self.common

    def lacks(self, root: Path, name: str) -> bool:
        """Whether an image may take a camera from elsewhere, such as a list of pairs."""
        return self.common is None and self.auto is None and self.named(root, name) is None

    def named(self, root: Path, name: str) -> Camera | None:
        """The camera that the file has for an image: of all of its file name, that with the most
        folders in common. A name in the file may lack its ending.

        A name with another folder is of another image, where the folder is one of `name`, or one
        of `root` that the file has for others. Any other root may hold copies of the photographs.
        Without a root, so may another folder in place of those that all names in the file begin
        with.

        Raises InputError if that leaves several cameras.
        """
        path = PurePath(os.path.abspath(root / name))
        alike = {**self._by_file_name.get(path.stem, {}), **self._by_file_name.get(path.name, {})}
        parts, count_of_name = (*path.parts[:-1], path.stem), len(PurePath(name).parts)
        common, folders = self._folders
        common = 0 if root.parts else common
        shared = {}
        for other in alike:
            count = len(os.path.commonprefix([_parts(other)[::-1], parts[::-1]]))
            differs = count < len(_parts(other)) - common
            if not (differs and (count < count_of_name or parts[-1 - count] in folders)):
                shared[other] = count
        if not shared:
            return None
        most = max(shared.values())
        nearest = {id(alike[other]): other for other, count in shared.items() if count == most}
        if len(nearest) > 1:
            first, second, *_ = nearest.values()
            raise InputError(f"{self.where} has {first} and {second}, and {name} may be either")
        return alike[next(iter(nearest.values()))]

    @cached_property
    def _by_file_name(self) -> dict[str, dict[str, Camera]]:
        names: dict[str, dict[str, Camera]] = {}
        for name, camera in self.by_name.items():
            names.setdefault(PurePosixPath(name).name, {})[name] = camera
        return names

    @cached_property
    def _folders(self) -> tuple[int, set[str]]:
        """How many folders all names begin with, and the further ones of each."""
        folders = [_parts(name)[:-1] for name in self.by_name]
        common = len(os.path.commonprefix(folders))
        return common, {folder for of_name in folders for folder in of_name[common:]}

    def _of_part(self, path: Path, part: str | None) -> Camera | None:
        if not self.parts:
            return None
        if part is not None and part in self.parts:
            return self.parts[part]
        for folder in reversed(path.absolute().parts):
            match = _PART_FOLDER.fullmatch(folder)
            if match and (key := f"{match[1]}{int(match[2])}") in self.parts:
                return self.parts[key]
        kinds = {(*camera.K.ravel().tolist(), camera.distortion) for camera in self.parts.values()}
        if self.common is None or len(kinds) == 1:
            return self.common
        first, *_, last = self.parts
        warning = (
            f"{self.where} has {len(self.parts)} cameras, and {path} lies in no folder of their "
            f"names: {first} is taken; {self.where}:{last} is another"
        )
        return replace(self.common, warnings=(*self.common.warnings, warning))


def _fitted(camera: Camera, details: KDetails, upright: Image | Header, name: str) -> Camera:
    """The camera of an upright image: checked, scaled from the size of `details`, turned, and with
    its deviations.

    Raises InputError if K states another size, if the image is a crop, and as `checked_camera`.
    """
    is_turned = orientation_of(camera, upright, details.size) != 1
    size = size_in_file(upright) if is_turned else upright.size
    of_K = details.size or size
    if details.size is not None:
        if camera.size not in (None, of_K):
            raise InputError(
                f"{name} states {times(camera.size)}, and", ArgumentName("K_size"), times(of_K)
            )
        if abs(of_K[0] * size[1] / (of_K[1] * size[0]) - 1) > _MAX_ASPECT_DIFFERENCE:
            raise InputError(
                f"{name} is for {times(of_K)} pixels and the image has {times(size)}, of another "
                "aspect ratio: K cannot be scaled to it"
            )
    image = details.image if details.size is None else "the image"
    camera = checked_camera(camera, of_K, name, image, details.other)
    if details.size is not None:
        camera = replace(camera, size=of_K).resized(size)
    camera = upright_camera(camera, upright)
    return replace(
        camera,
        focal_std=details.focal_std or camera.focal_std,
        centre_std=details.centre_std or camera.centre_std,
        lens_std=camera.lens_std if camera.distortion else details.lens_std or camera.lens_std,
    )


def pair_cameras(
    K1: Camera | Any | None,
    K2: Camera | Any | None,
    image1: Image,
    image2: Image,
    names: tuple[str, str] = ("K1", "K2"),
    details: KDetails = KDetails(),
    fov: float | None = None,
) -> tuple[Camera, Camera]:
    """The cameras of two images, each from a Camera, an array (3, 3), fx, fy, cx, cy, or a text or
    path as of --K; or both by the horizontal field of view, degrees.

    None is "auto"; if both are, by `auto_cameras`. A value without an identity gets that of its
    argument. names: of the arguments. Raises InputError, naming the argument, if K is unusable,
    does not fit the image, or is stated beside `fov`.
    """
    values = ["auto" if value is None else value for value in (K1, K2)]
    sharings = [_SHARING.get(value) if isinstance(value, str) else None for value in values]
    if fov is not None:
        if K1 is not None or K2 is not None:
            raise InputError(ArgumentName("fov"), f"and {names[K1 is None]} are both stated")
        cameras = (view_camera(fov, image.size) for image in (image1, image2))
        first, second = (
            _fitted(camera, details, image, "fov")
            for camera, image in zip(cameras, (image1, image2), strict=True)
        )
        return first, second
    if sharings[0] is not None and sharings[1] is not None:
        if sharings[0] != sharings[1]:
            raise InputError(f"{names[0]} is {values[0]}, and {names[1]} is {values[1]}")
        _require_K(details, names[0])
        return auto_cameras(image1, image2, sharings[0])
    of1 = replace(details, image="image 1", other=image2.size)
    of2 = replace(details, image="image 2", other=image1.size)
    first = image_camera(values[0], image1, names[0], of1, "K1")
    return first, image_camera(values[1], image2, names[1], of2, "K2")


def image_camera(
    value: Camera | Any | None,
    image: Image,
    name: str = "K",
    details: KDetails = KDetails(),
    part: str | None = None,
) -> Camera:
    """The camera of an image, as `pair_cameras` has it. part: of a pair, "K1" or "K2".

    Raises InputError, naming the argument `name`, likewise.
    """
    value = "auto" if value is None else value
    if isinstance(value, (str, Path)):
        is_auto_of_pair = part is not None and value in _SHARING
        calibration = read_calibration(str(value), name, KDetails() if is_auto_of_pair else details)
    else:
        camera = value if isinstance(value, Camera) else matrix_camera(value, name)
        camera = replace(camera, identity=camera.identity or name)
        calibration = Calibration(name, common=camera, details=details)
    return calibration.camera(Path(), image.name, image, part)


def parse_camera(text: str, name: str = "K", *, files: bool = True) -> Camera:
    """A camera from a text, as on the command line: any of this module's forms of a single camera.

    files: whether the text may be a path; False for a stranger's text. Raises InputError of one
    line, naming `name`.
    """
    if not files:
        return _parse_text(text, name)
    calibration = read_calibration(text, name)
    if calibration.common is None:
        raise InputError(f"{name}: {text} is no camera for all images")
    return calibration.common


def read_calibration(
    text: str | None, name: str = "K", details: KDetails = KDetails()
) -> Calibration:
    """The calibration of the argument K: a text or the path of a file, see this module.

    None: no camera for any image. Raises InputError, with `name` or the path, if the
    text is none of these or the file is malformed.
    """
    if text is None or text in _SHARING:
        _require_K(details, name)
        return Calibration(name, auto=_SHARING.get(text or ""))
    if text.endswith(_LENS) and not os.path.lexists(text):
        text, details = text.removesuffix(_LENS), replace(details, lens_std=LENS_STD)
    head, _, part = text.rpartition(":")
    if os.path.lexists(text):
        head, part = text, ""
    elif not (head and os.path.lexists(head)):
        camera = replace(_parse_text(text, name), identity=name)
        return Calibration(name, common=camera, details=details)
    try:
        cameras = read_file(Path(head))
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except OSError as error:
        raise InputError(f"{name}: {error.filename or head}: {error.strerror or error}") from error
    for refused, why in cameras.refused.items():
        if part in ("", refused):
            raise InputError(f"{name}: {head}: {why}")
    common = cameras.common
    if part:
        common = cameras.parts.get(part)
        if common is None:
            parts = ", ".join([*cameras.parts, *cameras.refused]) or "a single camera"
            raise InputError(f"{name}: {head} has {parts}, and no {shortened(part)}")
        return Calibration(text, common=common, details=details)
    if common is not None and common.identity is None:
        common = replace(common, identity=head)
    return Calibration(head, cameras.by_name, cameras.parts, common, details=details)


def _parse_text(text: str, name: str) -> Camera:
    """The camera of numbers or of a line of COLMAP's. Raises InputError, naming `name`."""
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
    """Raise InputError for details of a K that there is not."""
    for option, value in (("size", details.size), ("std", details.focal_std or details.centre_std)):
        if value:
            raise InputError(ArgumentName(f"K_{option}"), f"is of a K, and {name} gives none")


def _parts(name: str) -> tuple[str, ...]:
    path = PurePosixPath(name)
    return *path.parts[:-1], path.stem


def camera_data(camera: Camera) -> dict[str, Any]:
    """A camera for JSON."""
    lens = camera.distortion
    return {
        "K": camera.K.tolist(),
        "size": camera.size,
        "model": None if lens is None else lens.model,
        "coefficients": None if lens is None else lens.coefficients,
        "warnings": camera.warnings,
        "focal_std": camera.focal_std,
        "centre_std_px": camera.centre_std,
        "lens_std": camera.lens_std,
        "aspect_std": camera.aspect_std,
        "focal_source": camera.focal_source,
        "identity": camera.identity,
        "projection": camera.projection,
    }


def parse_camera_data(data: Mapping[str, Any]) -> Camera:
    """The camera of `camera_data`. Raises KeyError, TypeError or ValueError for other data."""
    if data["focal_source"] not in get_args(FocalSource):
        raise ValueError("a focal_source that is none")
    return replace(
        keyed_camera(data),
        warnings=tuple(data["warnings"]),
        focal_source=data["focal_source"],
        projection=data.get("projection", ""),  # files of 0.2.0 have none
    )
