"""A scene of DTU: its views that are on the disk, whatever the layout."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from dgc_pose.benchmarks.dtu.calibration import DtuView
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.checks import checked_camera
from dgc_pose.errors import InputError
from dgc_pose.images.image import image_size

Light = Literal["0", "1", "2", "3", "4", "5", "6", "max"]  # as in the names of images
LIGHTS: tuple[Light, ...] = get_args(Light)


@dataclass(frozen=True)
class DtuScene:
    """The views of a scene that have both an image and a calibration."""

    number: int
    views: Mapping[int, DtuView]  # by DTU's position, from 1; in pixels of `size`
    images: Mapping[int, Path]  # by position
    size: tuple[int, int]  # (width, height) of every image; (0, 0) without any
    missing: Mapping[int, str]  # by position, the file that was expected, of the views left out

    @property
    def name(self) -> str:
        return f"scan{self.number}"

    def require(self, position: int) -> None:
        """Raise InputError, with the file that was expected, if this view is missing."""
        if position in self.missing:
            raise InputError(
                f"view {position} of {self.name} is not there: expected {self.missing[position]}"
            )
        if position not in self.views:
            raise InputError(
                f"{self.name} has views 1 to {number_of_views(self.number)}, not {position}"
            )


@dataclass(frozen=True)
class SceneReader(ABC):
    """Where a layout keeps images and calibrations. Positions count from 1, as DTU's do."""

    root: Path  # what the names of images are relative to
    _read: dict[Any, DtuView] = field(default_factory=dict, init=False)  # shared by all scenes

    @abstractmethod
    def numbers(self) -> list[int]:
        """The scenes that have a folder, ascending."""

    @abstractmethod
    def image_stem(self, scene: int, position: int) -> Path:
        """Where an image is expected, without its .png or .jpg."""

    @abstractmethod
    def view(self, scene: int, position: int) -> DtuView | str:
        """The calibration, or where it is expected if it is missing. Raises InputError if it is
        malformed."""

    def image_size(self, scene: int) -> tuple[int, int] | None:
        """The (width, height) that the calibration is for, if the layout fixes it."""
        return None

    def calibration(self, path: Path, read: Callable[[Path], DtuView]) -> DtuView | str:
        """What `read` makes of a file, which is read once; the path if it is missing."""
        if (path, read) not in self._read and path.is_file():
            self._read[path, read] = read(path)
        return self._read.get((path, read), str(path))


def number_of_views(scene: int) -> int:
    """How many positions DTU took a scene from."""
    return 49 if scene <= 77 else 64


def read_scene(reader: SceneReader, number: int) -> DtuScene:
    """Find the views of a scene; those without an image or a calibration are left out.

    Raises InputError, with the path, for a calibration that is malformed or cannot belong to the
    image, and if images differ in size; ImageError for a file that is no image.
    """
    views: dict[int, DtuView] = {}
    images: dict[int, Path] = {}
    missing: dict[int, str] = {}
    size = reader.image_size(number)
    for position in range(1, number_of_views(number) + 1):
        stem = reader.image_stem(number, position)
        files = (stem.with_name(stem.name + suffix) for suffix in (".png", ".jpg"))
        image = next((file for file in files if file.is_file()), None)
        if image is None:
            missing[position] = f"{stem}.png or .jpg"
            continue
        view = reader.view(number, position)
        if isinstance(view, str):
            missing[position] = view
            continue
        actual = image_size(image)
        size = size or actual
        if actual != size:
            raise InputError(
                f"{image}: expected {size[0]} x {size[1]} pixels, found {actual[0]} x {actual[1]}"
            )
        # Its warning about the principal point is for cameras that a user gives.
        checked_camera(Camera(view.K), size, f"K of {image}")
        views[position], images[position] = view, image
    return DtuScene(number, views, images, size or (0, 0), missing)


def numbered_folders(folder: Path, pattern: str) -> dict[int, Path]:
    """The folders within a folder whose whole name matches, by the number that the pattern's group
    catches; none if the folder is missing."""
    folders: dict[int, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        match = re.fullmatch(pattern, path.name)
        if match and path.is_dir():
            folders.setdefault(int(match[1]), path)
    return folders


def light_suffix(light: str) -> str:
    """How the name of a raw image ends: 3_r5000 for a light, max for all of them."""
    return light if light == "max" else f"{light}_r5000"
