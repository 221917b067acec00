"""A scene of DTU: its views that are on the disk, whatever the layout."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from dgc_pose.benchmarks.dtu.calibration import View
from dgc_pose.cameras.camera import Camera, check_size
from dgc_pose.errors import InputError
from dgc_pose.images.image import image_size

Light = Literal["0", "1", "2", "3", "4", "5", "6", "max"]  # as in the names of images
LIGHTS: tuple[Light, ...] = get_args(Light)
SUFFIXES = (".png", ".jpg")  # of both, the png is taken


@dataclass(frozen=True)
class Scene:
    """The views of a scene that have both an image and a calibration."""

    name: str  # "scan65"
    number: int
    views: Mapping[int, View]  # by DTU's position, from 1; in pixels of `size`
    images: Mapping[int, Path]  # by position
    size: tuple[int, int]  # (width, height) of every image; (0, 0) without any
    missing: Mapping[int, str]  # by position, the file that was expected, of the views left out

    @property
    def absent(self) -> int:
        """How many of DTU's views of this scene are missing."""
        return len(self.missing)

    def require(self, position: int) -> None:
        """Raise InputError, with the file that was expected, if this view is missing."""
        if position in self.views:
            return
        if position in self.missing:
            raise InputError(
                f"view {position} of {self.name} is not there: expected {self.missing[position]}"
            )
        raise InputError(
            f"{self.name} has views 1 to {number_of_views(self.number)}, not {position}"
        )


@dataclass(frozen=True)
class SceneReader(ABC):
    """Where a layout keeps things. Positions count from 1, as DTU's do."""

    root: Path  # what the names of images are relative to

    @abstractmethod
    def numbers(self) -> list[int]:
        """The scenes that have a folder, ascending."""

    @abstractmethod
    def image_stem(self, scene: int, position: int) -> Path:
        """Where an image is expected, without its .png or .jpg."""

    @abstractmethod
    def view(self, scene: int, position: int) -> View | None:
        """The calibration; None if missing, InputError if malformed."""

    @abstractmethod
    def calibration_name(self, scene: int, position: int) -> str:
        """Where the calibration is expected, for a message."""

    def image_size(self, scene: int) -> tuple[int, int] | None:
        """The (width, height) that the calibration is for, if the layout fixes it."""
        return None


def number_of_views(scene: int) -> int:
    """How many positions DTU took a scene from."""
    return 49 if scene <= 77 else 64


def read_scene(reader: SceneReader, number: int) -> Scene:
    """Find the views of a scene; those without an image or a calibration are left out.

    Raises InputError, with the path, for a calibration that is malformed or cannot belong to the
    image, and if images differ in size; ImageError for a file that is no image.
    """
    views: dict[int, View] = {}
    images: dict[int, Path] = {}
    missing: dict[int, str] = {}
    size = reader.image_size(number)
    for position in range(1, number_of_views(number) + 1):
        stem = reader.image_stem(number, position)
        image = _find_image(stem)
        if image is None:
            missing[position] = f"{stem}.png or .jpg"
            continue
        view = reader.view(number, position)
        if view is None:
            missing[position] = reader.calibration_name(number, position)
            continue
        found = image_size(image)
        size = size or found
        if found != size:
            raise InputError(
                f"{image}: expected {size[0]} x {size[1]} pixels, found {found[0]} x {found[1]}"
            )
        # Its warning about the principal point is for cameras that a user gives.
        check_size(Camera(view.K), size, f"K of {image}")
        views[position], images[position] = view, image
    return Scene(f"scan{number}", number, views, images, size or (0, 0), missing)


def numbered_folders(folder: Path, pattern: str) -> dict[int, Path]:
    """The folders within a folder whose whole name matches, by the number that the pattern's group
    catches; none if the folder is missing."""
    if not folder.is_dir():
        return {}
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        match = re.fullmatch(pattern, path.name)
        if match and path.is_dir():
            found.setdefault(int(match[1]), path)
    return found


def light_suffix(light: str) -> str:
    """How the name of a raw image ends: 3_r5000 for a light, max for all of them."""
    return light if light == "max" else f"{light}_r5000"


def _find_image(stem: Path) -> Path | None:
    paths = (stem.with_name(stem.name + suffix) for suffix in SUFFIXES)
    return next((path for path in paths if path.is_file()), None)
