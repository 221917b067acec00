"""Cameras by image name, and the camera that fits an upright image."""

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

_PART_FOLDER = re.compile(r"(image_|cam)0*(\d+)")  # KITTI, Kalibr
_MAX_ASPECT_DIFFERENCE = 0.01  # relative, between image and K; above it, the image is a crop
# Distances of the principal point from the middle, as shares of the side
_MAX_CENTRE_OFFSET = 0.04  # K fits the size of the image
_TURNED_OFFSET = 2 * _MAX_CENTRE_OFFSET  # above: K belongs to the rotated image if it fits there
_LEAST_FOCAL = 0.1339  # of a pinhole, over the width: a field of view of 150 degrees
_MAX_USUAL_OFFSET = 0.2  # above: warning; a share as before
_SAME_ASPECT = 0.03  # largest difference of the logarithms of two equal aspect ratios
# |ln(scale)| between two sizes of equal aspect ratio: up to the first, the sizes are equal; above
# the second, K cannot belong to the image
_MAX_SAME_SCALE = 0.1
_MAX_POSSIBLE_SCALE = 0.4


@dataclass(frozen=True)
class KDetails:
    """The image size that a K refers to, and the standard deviations of K."""

    size: Size | None = None  # (width, height) of the image that K refers to
    focal_std: float = 0.0  # relative, of the focal lengths
    centre_std: float = 0.0  # of each coordinate of the principal point, pixels of the image
    lens_std: float = 0.0  # of the radial coefficient, if the camera has no lens; see `Camera`


NO_DETAILS = KDetails()


@dataclass(frozen=True)
class Calibration:
    """Cameras by image name, and a common camera for all other images."""

    where: str = ""  # the option or file that the cameras come from, for errors
    by_name: Mapping[str, Camera] = field(default_factory=dict)  # names as written
    # Cameras of a rig or a pair: "cam1" (Kalibr), "image_2" (KITTI), "K2" (the second image)
    parts: Mapping[str, Camera] = field(default_factory=dict)
    common: Camera | None = None  # for all other images
    # Set if the images have no K. "shared": one camera took all; "two": each has another camera
    auto: Sharing | None = None
    details: KDetails = NO_DETAILS
    poses: Mapping[str, np.ndarray] = field(default_factory=dict)  # cam_from_world (3, 4), by name
    rig: tuple[str, ...] = ()  # names of all cameras of a rig file; `parts` has the calibrated ones

    def camera(
        self, root: Path, name: str, image: Image | Header, part: str | None = None
    ) -> Camera:
        """The camera of an upright image or its header, see `fitted_camera`.

        root: the folder that `name` is relative to. part: "K1" or "K2" for an image of a pair.
        Raises InputError if the image has no camera, or if its camera is for another size.
        """
        camera = self.stated(root, name, part)
        if camera is not None:
            label = self.where if part and not self.by_name else f"{self.where}: {name}: K"
            shown = f"image {part[-1]}" if part else "the image"
            return fitted_camera(camera, self.details, image, label, shown)
        if self.auto is not None:
            return auto_camera(image, self.auto)
        missing = f"{self.where} has no camera for {name}"
        if not self.parts:
            raise InputError(missing)
        *_, last = self.parts
        names = shortened(", ".join(self.parts))
        raise InputError(f"{missing}: choose one of {names}, as in {self.where}:{last}")

    def stated(self, root: Path, name: str, part: str | None = None) -> Camera | None:
        """The camera of an image exactly as the text or file states it, or None."""
        return self.named(root, name) or self._by_part(root / name, part) or self.common

    @property
    def is_empty(self) -> bool:
        """Whether nothing is stated, not even that the images have no K."""
        files = self.by_name or self.parts or self.poses or self.rig
        return self.auto is None and self.common is None and not files

    def lacks(self, root: Path, name: str) -> bool:
        """Whether an image needs a camera from elsewhere, such as a list of pairs."""
        return self.auto is None and self.stated(root, name) is None

    def named(self, root: Path, name: str) -> Camera | None:
        """The camera that the file names for an image, or None.

        The longest name that the image's path ends with counts; failing that, the only name with
        the same file name. Names in the file may lack the ending. Raises InputError if several
        names match and their cameras differ.
        """
        path = PurePath(os.path.abspath(root / name))
        alike = self._by_file_name.get(path.name) or self._by_file_name.get(path.stem) or []
        for folders, stated in sorted(alike, key=lambda named: -len(named[0])):
            if path.parts[-1 - len(folders) : -1] == folders:
                return self.by_name[stated]
        if len({id(self.by_name[stated]) for _, stated in alike}) > 1:
            first, second, *_ = (stated for _, stated in alike)
            raise InputError(f"{name} matches both {first} and {second} of {self.where}")
        return self.by_name[alike[0][1]] if alike else None

    @cached_property
    def _by_file_name(self) -> dict[str, list[tuple[tuple[str, ...], str]]]:
        """(folders, name) of each name in `by_name`, by its file name."""
        names = defaultdict[str, list[tuple[tuple[str, ...], str]]](list)
        for name in self.by_name:
            parts = [part for part in PurePath(os.path.normpath(name)).parts if part != ".."]
            file = parts[-1] if parts else ""
            names[file].append((tuple(parts[:-1]), name))
        return names

    def _by_part(self, path: Path, part: str | None) -> Camera | None:
        """The camera of `part`, of a folder of `path`, or of a two-camera rig by its order."""
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
            f"{self.where} has two cameras and no image names: {first} is used for image 1, "
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
    """The camera of an upright image: K checked, scaled from the size in `details`, rotated by
    EXIF, and with its deviations.

    name, shown: of K and of the image in errors. Raises InputError if K states another size than
    `details`, if the image is a crop, and as `checked_camera` does.
    """
    is_turned = orientation_of(camera, image, details.size) != 1
    size = size_in_file(image) if is_turned else image.size
    if details.size is None:
        camera = checked_camera(camera, size, name, shown)
    else:
        width, height = details.size
        if camera.size not in (None, details.size):
            stated = f"{name} states {times(camera.size)}, and"
            raise InputError(stated, ArgumentName("K_size"), times(details.size))
        if abs(width * size[1] / (height * size[0]) - 1) > _MAX_ASPECT_DIFFERENCE:
            raise InputError(
                f"{name} is for {times(details.size)} pixels, and the image of {times(size)} has "
                "another aspect ratio: K cannot be scaled"
            )
        checked = checked_camera(camera, details.size, name)
        camera = replace(checked, size=details.size).resized(size)

    camera = upright_camera(camera, image)
    return replace(
        camera,
        size=image.size,
        focal_std=details.focal_std or camera.focal_std,
        centre_std=details.centre_std or camera.centre_std,
        lens_std=camera.lens_std if camera.distortion else details.lens_std or camera.lens_std,
    )


def upright_camera(camera: Camera, image: Image | Header) -> Camera:
    """The camera of an upright image from a given K, rotated by `orientation_of`.

    The camera gets a warning if the rotation changes K although K may fit the upright image too.
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
    """The EXIF orientation by which K is rotated with its image; 1 if K fits only the upright
    image, by its size or else by its principal point. size: of the image that K refers to, by
    default the camera's size."""
    return 1 if _fits(camera, image, size) == (False, True) else image.exif.orientation


def _fits(camera: Camera, image: Image | Header, size: Size | None = None) -> tuple[bool, bool]:
    """Whether K may refer to the stored pixels, and whether to the upright image."""
    if image.exif.orientation not in EXCHANGING:
        return True, True
    return _may_be_of(camera, size_in_file(image), size), _may_be_of(camera, image.size, size)


def _may_be_of(camera: Camera, image_size: Size, size: Size | None = None) -> bool:
    """Whether K may refer to an image of `image_size` rather than to the image rotated by 90
    degrees. size: of the image that K refers to, by default the camera's size."""
    size = size or camera.size
    if size is not None:
        return (size[0] - size[1]) * (image_size[0] - image_size[1]) >= 0
    return _offset(camera, image_size) < _MAX_CENTRE_OFFSET


def _offset(camera: Camera, size: Size) -> float:
    """The distance of the principal point from the middle over the side, on the worse axis."""
    return float(np.abs((camera.K[:2, 2] + 0.5) / size - 0.5).max())


def checked_camera(camera: Camera, size: Size, name: str, image: str = "the image") -> Camera:
    """The camera of an image of `size` (width, height), with a warning if the principal point is
    far from the middle or is the middle of an image of another size.

    name, image: of the argument K and of the image in errors. Raises InputError if the camera's
    size differs; if the principal point lies outside the image; if a camera without a size has the
    principal point of the image rotated by 90 degrees, or of an image with far more or fewer
    pixels; and for a pinhole with a field of view above 150 degrees (a focal length in mm).
    """
    if camera.size is not None and camera.size != size:
        turned = ": K is of the image rotated by 90 degrees" if camera.size == size[::-1] else ""
        raise InputError(
            f"{name} is for an image of {camera.size[0]} x {camera.size[1]} pixels, {image} has "
            f"{size[0]} x {size[1]}{turned}"
        )
    centre = camera.K[:2, 2]
    place = f"{name} has its principal point at ({centre[0]:g}, {centre[1]:g})"
    centred = 2 * centre + 1  # the image size with the principal point in the middle

    if camera.size is None and (centred > 1).all():
        about = times(np.rint(centred).astype(int))
        middle = f"{place}, the middle of about {about} pixels; {image} has {times(size)}"
        if _may_be_of(camera, size[::-1]) and _offset(camera, size) > _TURNED_OFFSET:
            raise InputError(f"{middle}: K is of the image rotated by 90 degrees")
        x, y = np.log(centred / size)
        scale = abs(np.log(centred.max() / max(size)))
        if abs(x - y) <= _SAME_ASPECT and scale > _MAX_SAME_SCALE:
            if scale > _MAX_POSSIBLE_SCALE:
                raise InputError(f"{middle}: state the size of K")
            return replace(camera, warnings=(*camera.warnings, middle))

    if not ((centred > 0) & (centred < 2 * np.array(size))).all():
        raise InputError(f"{place}, outside {image} of {times(size)}")
    if camera.distortion is None and camera.K[0, 0] < _LEAST_FOCAL * size[0]:
        problem = f"{name} has a focal length of {camera.K[0, 0]:g} pixels"
        raise InputError(f"{problem}, a field of view above 150 degrees in {times(size)}")
    if _offset(camera, size) <= _MAX_USUAL_OFFSET:
        return camera
    warning = f"{place}, far from the middle of {image} of {times(size)}"
    return replace(camera, warnings=(*camera.warnings, warning))


def times(size: ArrayLike) -> str:
    """Format a size as 640x480."""
    width, height = np.asarray(size).tolist()
    return f"{width}x{height}"
