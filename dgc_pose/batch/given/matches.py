"""Matches of another program, and matches in memory.

A source lists its images and pairs at once, and reads the matches of one pair at a time, in the
process that judges it. Points are in pixels, (0, 0) the centre of the first one.
"""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dgc_pose.cameras.by_image import times
from dgc_pose.cameras.camera import Camera, image_size
from dgc_pose.errors import ArgumentName, ImageError, InputError
from dgc_pose.geometry.pixels import Size, exif_turn, turn_points
from dgc_pose.images.decoding import Header, image_header
from dgc_pose.images.image import Image, size_in_file
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_type

ERROR_PX = 1.0  # of a match along one axis, pixels, unless the source states it
Names = tuple[str, str]


@dataclass(frozen=True)
class GivenMatches:
    """The pairs of a source. `read` gives the matches of one of them."""

    path: Path
    names: tuple[str, ...]
    places: Mapping[Names, str]  # by pair, where the source has its matches
    notes: tuple[str, ...]  # what was read and by which convention, a line each
    sizes: Mapping[str, Size] = field(default_factory=dict)  # of images, if the source states them
    cameras: Mapping[str, Camera] = field(default_factory=dict)  # of known focal length
    with_images: bool = False  # whether the photographs are there
    upright = False  # whether the points refer to upright images, not to the pixels as stored

    def read(self, names: Names) -> Matches:
        """The matches of a pair. Raises InputError if they are damaged."""
        raise NotImplementedError

    def files(self) -> list[Path]:
        """The files of the source."""
        return [self.path]

    @property
    def state(self) -> str:
        """A text that changes with the files: their names, sizes and times of change."""
        stats = [(str(file.resolve()), file.stat()) for file in self.files()]
        states = [(name, stat.st_size, stat.st_mtime_ns) for name, stat in stats]
        return hashlib.sha256(repr(states).encode()).hexdigest()[:16]

    def has_size(self, name: str, stated: Camera | None) -> bool:
        """Whether the size of an image is known, and not only by the principal point of its K."""
        has_own = self.with_images or name in self.sizes
        return has_own or (stated is not None and stated.size is not None)

    def header(self, path: Path, name: str, stated: Camera | None) -> Header:
        """The facts about the image that the points refer to. path: of its photograph. stated: the
        K that is given for it, which determines an unknown size.

        Raises ImageError if there should be a photograph and it cannot be read or has another size;
        InputError if the size is not known.
        """
        size = self.sizes.get(name)
        if self.with_images:
            header = image_header(path)
            if not self.upright:
                exif = replace(header.exif, orientation=1)
                header = replace(header, size=size_in_file(header), exif=exif)
            if size not in (None, header.size):
                which = f"{times(header.size)} pixels, and {self.path} states {times(size)}"
                raise ImageError(f"{path}: {which}")
            return header
        if size is None and stated is not None:
            size = guessed_size(stated)
        if size is None:
            unknown = f"{name} has no camera, and {self.path} states no size of it: give"
            raise InputError(unknown, ArgumentName("K"), "or", ArgumentName("images"))
        return Header("", size)

    def on_upright(self, matches: Matches, image1: Image, image2: Image) -> Matches:
        """The matches in pixels of the upright photographs."""
        if self.upright:
            return matches
        points1, points2 = (
            turn_points(points, exif_turn(image.exif.orientation), size_in_file(image))
            for points, image in ((matches.points1, image1), (matches.points2, image2))
        )
        return replace(matches, points1=points1, points2=points2)


class KeyPoints(NamedTuple):
    """The key points of an image."""

    points: np.ndarray  # (N, 2) float64
    error_px: float = ERROR_PX


class IndexedMatches(GivenMatches):
    """Matches as indices of key points, which the pairs of an image share."""

    def key_points(self, name: str) -> KeyPoints:
        """The key points of an image."""
        raise NotImplementedError

    def indices(self, names: Names) -> tuple[np.ndarray, np.ndarray]:
        """The matches of a pair: indices (M, 2) int64 of key points, and confidences (M,)."""
        raise NotImplementedError

    def read(self, names: Names) -> Matches:
        index, confidence = self.indices(names)
        chosen = []
        errors_px = []
        for name, column in zip(names, index.T, strict=True):
            points, error_px = self.key_points(name)
            errors_px.append(error_px)
            if len(column) and not 0 <= column.min() <= column.max() < len(points):
                odd = column.max() if column.min() >= 0 else column.min()
                raise InputError(f"a match has key point {odd} of {name}, which has {len(points)}")
            chosen.append(points[column])
        points1, points2 = chosen
        return Matches(points1, points2, confidence, max(errors_px), key_points=True)


@dataclass(frozen=True)
class HeldMatches(GivenMatches):
    """Matches in memory."""

    held: Mapping[Names, Matches] = field(default_factory=dict)
    upright = True

    @classmethod
    def of(cls, matches: Mapping[Names, Matches]) -> GivenMatches:
        """Raises InputError without a pair."""
        if not matches:
            raise InputError(ArgumentName("source"), "has no pairs")
        for names, some in matches.items():
            check_type(names, tuple[str, str], "source")
            check_type(some, Matches, "source")
        return cls(
            Path("matches"), images_of(matches), dict.fromkeys(matches, ""), (), held=matches
        )

    def files(self) -> list[Path]:
        return []

    def read(self, names: Names) -> Matches:
        return self.held[names]


def guessed_size(camera: Camera) -> Size:
    """The size of an image whose middle is the principal point."""
    width, height = image_size(camera)
    return round(width), round(height)


def each_once(path: Path, pairs: Iterable[tuple[Names, str]]) -> tuple[dict[Names, str], list[str]]:
    """The places of pairs, and a line about those left out: of several places of a pair, in either
    order of its images, the first counts."""
    places: dict[frozenset[str], tuple[Names, str]] = {}
    repeated = []
    for names, place in pairs:
        if places.setdefault(frozenset(names), (names, place)) != (names, place):
            repeated.append(place)
    line = f"{path}: matches left out, as their pairs have some already: {len(repeated)}"
    lines = [f"{line} (first: {repeated[0]})"] if repeated else []
    return dict(places.values()), lines


def images_of(pairs: Iterable[Names]) -> tuple[str, ...]:
    """The names of all images of pairs, sorted."""
    return tuple(sorted(set(chain.from_iterable(pairs))))
