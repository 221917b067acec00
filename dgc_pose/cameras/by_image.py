"""Cameras by the names of images, and the camera of an upright image by its K."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import Sharing, auto_camera
from dgc_pose.errors import ArgumentName, InputError, shortened
from dgc_pose.geometry.pixels import EXCHANGING, Size, exif_turn
from dgc_pose.images.image import size_in_file

if TYPE_CHECKING:
    from dgc_pose.images.decoding import Header
    from dgc_pose.images.image import Image

_PART_FOLDER = re.compile(r"(image_|cam)0*(\d+)")  # of KITTI, Kalibr
_MAX_ASPECT_DIFFERENCE = 0.01  # of the sizes of an image and of its K: more is a crop
_MAX_CENTRE_OFFSET = 0.04  # of the principal point from the middle, over the side
_TURNED_OFFSET = 2 * _MAX_CENTRE_OFFSET  # more is of the image turned, whose middle is nearer
_LEAST_FOCAL = 0.1339  # of a pinhole, over the width: a field of view of 150 degrees
_MAX_USUAL_OFFSET = 0.2  # of the principal point from the middle, as a share of the image's side
_SAME_ASPECT = 0.03  # of the logarithms of two aspect ratios that are the same
# Logarithms of the scale between two sizes of the same aspect ratio: less is the same size, and
# more cannot be the image's.
_MAX_SAME_SCALE, _MAX_POSSIBLE_SCALE = 0.1, 0.4


@dataclass(frozen=True)
class KDetails:
    """The size that a K refers to, and its deviations."""

    size: Size | None = None  # (width, height) of the image that K refers to
    focal_std: float = 0.0  # relative, of the focal lengths
    centre_std: float = 0.0  # of each coordinate of the principal point, pixels of the image
    lens_std: float = 0.0  # of the radial coefficient of a camera without a lens, see `Camera`


NO_DETAILS = KDetails()


@dataclass(frozen=True)
class Calibration:
    """Cameras by the names of images, and the one of all others."""

    where: str = ""  # of errors: the option or file that the cameras come from
    by_name: Mapping[str, Camera] = field(default_factory=dict)  # names as written
    # Of a rig or a pair: "cam1" of Kalibr, "image_2" of KITTI, "K2" of the second image.
    parts: Mapping[str, Camera] = field(default_factory=dict)
    common: Camera | None = None  # of all other images
    # The images have no K. With "shared" one camera took all; with "two" one each.
    auto: Sharing | None = None
    details: KDetails = NO_DETAILS
    poses: Mapping[str, np.ndarray] = field(default_factory=dict)  # cam_from_world (3, 4), by name
    rig: tuple[str, ...] = ()  # all cameras of a file that names them; `parts` are the calibrated

    def camera(
        self, root: Path, name: str, image: Image | Header, part: str | None = None
    ) -> Camera:
        """The camera of an upright image or its header, see `fitted_camera`.

        root: the folder that `name` is relative to. part: of a pair, "K1" or "K2". Raises
        InputError if there is none, or if it is for another size.
        """
        camera = self.stated(root, name, part)
        if camera is not None:
            label = self.where if part and not self.by_name else f"{self.where}: {name}: K"
            shown = f"image {part[-1]}" if part else "the image"
            return fitted_camera(camera, self.details, image, label, shown)
        if self.auto is not None:
            return auto_camera(image, self.auto)
        if self.parts or self.by_name:
            *_, last = ("", *self.parts)
            names = shortened(", ".join(self.parts))
            other = f": state one of {names}, as in {self.where}:{last}" if last else ""
            raise InputError(f"{self.where} has no camera for {name}{other}")
        K = ArgumentName("K")
        raise InputError(f"no camera for {name}: state", K, "or", K, "auto")

    def stated(self, root: Path, name: str, part: str | None = None) -> Camera | None:
        """The camera of an image as the text or file states it; None without one."""
        return self.named(root, name) or self._of_part(root / name, part) or self.common

    def lacks(self, root: Path, name: str) -> bool:
        """Whether an image may take a camera from elsewhere, such as a list of pairs."""
        return self.auto is None and self.stated(root, name) is None

    def named(self, root: Path, name: str) -> Camera | None:
        """The camera that the file has for an image: of the longest name that the image's path ends
        with, or else of the only name with its file name. A name in the file may lack its ending.

        Raises InputError if several names have its file name, and other cameras.
        """
        path = PurePath(os.path.abspath(root / name))
        alike = self._by_file_name.get(path.name) or self._by_file_name.get(path.stem) or []
        for folders, stated in sorted(alike, key=lambda named: -len(named[0])):
            if path.parts[-1 - len(folders) : -1] == folders:
                return self.by_name[stated]
        if len({id(self.by_name[stated]) for _, stated in alike}) > 1:
            first, second, *_ = (stated for _, stated in alike)
            raise InputError(f"{self.where} has {first} and {second}, and {name} may be either")
        return self.by_name[alike[0][1]] if alike else None

    @cached_property
    def _by_file_name(self) -> dict[str, list[tuple[tuple[str, ...], str]]]:
        """The folders in each name, and the name."""
        names = defaultdict[str, list[tuple[tuple[str, ...], str]]](list)
        for name in self.by_name:
            *folders, file = ["", *(p for p in PurePath(os.path.normpath(name)).parts if p != "..")]
            names[file].append((tuple(folders[1:]), name))
        return names

    def _of_part(self, path: Path, part: str | None) -> Camera | None:
        """The camera of a part that is stated, of a folder, or of two in their order."""
        if part is not None and part in self.parts:
            return self.parts[part]
        for folder in reversed(path.absolute().parts if self.parts else ()):
            match = _PART_FOLDER.fullmatch(folder)
            if match and (key := f"{match[1]}{int(match[2])}") in self.parts:
                return self.parts[key]
        if part is None or self.common is not None or len(self.rig) != 2:
            return None
        first, second = self.rig
        taken = self.parts.get(second if part == "K2" else first)
        warning = (
            f"{self.where} has two cameras and no image names: {first} is taken for image 1, "
            f"{second} for image 2"
        )
        return taken and replace(taken, warnings=(*taken.warnings, warning))


def fitted_camera(
    camera: Camera,
    details: KDetails,
    image: Image | Header,
    name: str,
    shown: str = "the image",
) -> Camera:
    """The camera of an upright image by its K: checked, scaled from the size of `details`, turned,
    and with its deviations.

    Raises InputError, naming K and the image by `name` and `shown`, if K states another size, if
    the image is a crop, and as `checked_camera`.
    """
    is_turned = orientation_of(camera, image, details.size) != 1
    size = size_in_file(image) if is_turned else image.size
    if (of_K := details.size) is None:
        camera = checked_camera(camera, size, name, shown)
    else:
        if camera.size not in (None, of_K):
            stated = f"{name} states {times(camera.size)}, and"
            raise InputError(stated, ArgumentName("K_size"), times(of_K))
        if abs(of_K[0] * size[1] / (of_K[1] * size[0]) - 1) > _MAX_ASPECT_DIFFERENCE:
            raise InputError(
                f"{name} is for {times(of_K)} pixels and the image has {times(size)}, "
                "of another aspect ratio: K cannot be scaled"
            )
        camera = replace(checked_camera(camera, of_K, name), size=of_K).resized(size)
    camera = upright_camera(camera, image)
    return replace(
        camera,
        size=image.size,
        focal_std=details.focal_std or camera.focal_std,
        centre_std=details.centre_std or camera.centre_std,
        lens_std=camera.lens_std if camera.distortion else details.lens_std or camera.lens_std,
    )


def upright_camera(camera: Camera, image: Image | Header) -> Camera:
    """The camera of an upright image by a K that was given, which is turned by `orientation_of`.

    It has a warning if the turn changes K, and K may be of the upright image too.
    """
    orientation = orientation_of(camera, image)
    if orientation == 1:
        return camera
    turned = camera.turned(exif_turn(orientation), size_in_file(image))
    turned = replace(turned, size=camera.size and turned.size)
    if _fits(camera, image) == (True, False) or np.array_equal(turned.K, camera.K):
        return turned
    warning = (
        f"EXIF orientation {orientation} rotates K with the image: K must refer to the pixels as "
        "stored"
    )
    return replace(turned, warnings=(*turned.warnings, warning))


def orientation_of(camera: Camera, image: Image | Header, size: Size | None = None) -> int:
    """The EXIF orientation by which K is turned with its image: that of the image; 1 if K is
    certainly of the upright image, by its size, or without one by its principal point. size: that
    K is for, besides that of the camera."""
    return 1 if _fits(camera, image, size) == (False, True) else image.exif.orientation


def _fits(camera: Camera, image: Image | Header, size: Size | None = None) -> tuple[bool, bool]:
    """Whether K may be of the pixels as stored, and of the upright image."""
    if image.exif.orientation not in EXCHANGING:
        return True, True
    return _may_be_of(camera, size_in_file(image), size), _may_be_of(camera, image.size, size)


def _may_be_of(camera: Camera, image_size: Size, size: Size | None = None) -> bool:
    """Whether K may be of an image of `image_size`, rather than of one turned by 90 degrees. size:
    that K is for, besides that of the camera."""
    size = size or camera.size
    if size is not None:
        return (size[0] - size[1]) * (image_size[0] - image_size[1]) >= 0
    return _offset(camera, image_size) < _MAX_CENTRE_OFFSET


def _offset(camera: Camera, size: Size) -> float:
    """The larger distance of the principal point from the middle, along an axis, over its side."""
    return float(np.abs((camera.K[:2, 2] + 0.5) / size - 0.5).max())


def checked_camera(camera: Camera, size: Size, name: str, image: str = "the image") -> Camera:
    """The camera of an image of `size` (width, height), called `image`, with a warning if its
    principal point is far from the middle, or that of an image of another size.

    Raises InputError, naming the argument `name`, if the camera's size differs; if its principal
    point lies outside the image, or, of a camera without a size, in the middle of the image turned
    by 90 degrees or of one of far more or fewer pixels; and for a pinhole of a focal length in
    millimetres, as its field of view shows.
    """
    if camera.size is not None and camera.size != size:
        turned = ": K is of the image rotated by 90 degrees" if camera.size == size[::-1] else ""
        raise InputError(
            f"{name} is for an image of {camera.size[0]} x {camera.size[1]} pixels, {image} has "
            f"{size[0]} x {size[1]}{turned}"
        )
    centre = camera.K[:2, 2]
    place = f"{name} has its principal point at ({centre[0]:g}, {centre[1]:g})"
    of_K = 2 * centre + 1  # the size of an image whose middle the principal point is
    if camera.size is None and (of_K > 1).all():
        about = times(np.rint(of_K).astype(int))
        middle = f"{place}, the middle of about {about} pixels; {image} has {times(size)}"
        if _may_be_of(camera, size[::-1]) and _offset(camera, size) > _TURNED_OFFSET:
            raise InputError(f"{middle}: K is of the image rotated by 90 degrees")
        x, y = np.log(of_K / size)
        scale = abs(np.log(of_K.max() / max(size)))
        if abs(x - y) <= _SAME_ASPECT and scale > _MAX_SAME_SCALE:
            if scale > _MAX_POSSIBLE_SCALE:
                raise InputError(f"{middle}: state the size of K")
            return replace(camera, warnings=(*camera.warnings, middle))
    if not ((of_K > 0) & (of_K < 2 * np.array(size))).all():
        raise InputError(f"{place}, outside {image} of {times(size)}")
    if camera.distortion is None and camera.K[0, 0] < _LEAST_FOCAL * size[0]:
        problem = f"{name} has a focal length of {camera.K[0, 0]:g} pixels"
        raise InputError(f"{problem}, a field of view above 150 degrees in {times(size)}")
    if _offset(camera, size) <= _MAX_USUAL_OFFSET:
        return camera
    warning = f"{place}, far from the middle of {image} of {times(size)}"
    return replace(camera, warnings=(*camera.warnings, warning))


def times(size: ArrayLike) -> str:
    """A size as 640x480."""
    width, height = np.asarray(size).tolist()
    return f"{width}x{height}"
