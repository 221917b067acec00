"""Matches of another program: a COLMAP database, hloc's features and matches, or a folder of .npz.

A source lists its images and pairs at once, and reads the matches of one pair at a time, in the
process that judges it. Points are in pixels, (0, 0) the centre of the first one.
"""

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from dgc_pose.cameras.by_image import times
from dgc_pose.cameras.camera import Camera, image_size
from dgc_pose.cameras.formats.colmap import (
    Table,
    database_files,
    open_database,
    read_images,
    read_pairs,
)
from dgc_pose.errors import ArgumentName, ImageError, InputError
from dgc_pose.geometry.pixels import Size, exif_turn, turn_points
from dgc_pose.images.decoding import Header, image_header
from dgc_pose.images.image import Image, size_in_file
from dgc_pose.matches import Matches
from dgc_pose.system.arrays import read_arrays
from dgc_pose.system.files import open_file, read_as
from dgc_pose.system.options import check_type

ERROR_PX = 1.0  # of a match along one axis, pixels, unless the source states it
_HALF_PIXEL = 0.5  # COLMAP's centre of the first pixel
_PICTURE = re.compile(r".+\.[^\W\d_][^\W_]*")  # a name with an ending
Names = tuple[str, str]


@dataclass(frozen=True)
class GivenMatches:
    """The pairs of a source. `read` gives the matches of one of them."""

    path: Path
    names: tuple[str, ...]
    places: Mapping[Names, str]  # by pair, where the source has its matches
    said: tuple[str, ...]  # what was read and by which convention, a line each
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
class DatabaseMatches(IndexedMatches):
    """The matches of a COLMAP database; if it has none, the inliers of its geometries."""

    ids: Mapping[str, int] = field(default_factory=dict)  # of the images
    table: Table = "matches"

    def files(self) -> list[Path]:
        return database_files(self.path)

    def key_points(self, name: str) -> KeyPoints:
        with open_database(self.path) as database:
            found = database.execute(
                "SELECT rows, cols, data FROM keypoints WHERE image_id = ?", (self.ids[name],)
            ).fetchone()
            rows, columns, data = found or (0, 2, b"")
            points = np.frombuffer(data or b"", "<f4").reshape(rows, columns)
        return KeyPoints(points[:, :2].astype(np.float64) - _HALF_PIXEL)

    def indices(self, names: Names) -> tuple[np.ndarray, np.ndarray]:
        with open_database(self.path) as database:
            rows, data = database.execute(
                f"SELECT rows, data FROM {self.table} WHERE pair_id = ?", (self.places[names],)
            ).fetchone()
            index = np.frombuffer(data, "<u4").reshape(rows, 2).astype(np.int64)
        return index, np.ones(len(index))


@dataclass(frozen=True)
class HlocMatches(IndexedMatches):
    """Matches in hloc's layout. The places are groups of the file of matches."""

    features: Path = Path()
    matches: Path = Path()

    def files(self) -> list[Path]:
        return [self.features, self.matches]

    def key_points(self, name: str) -> KeyPoints:
        with read_as("hloc's features", self.features), h5py.File(self.features) as file:
            stored = file[name]["keypoints"]
            points = np.asarray(stored, np.float64)[:, :2]
            return KeyPoints(points, float(stored.attrs.get("uncertainty", ERROR_PX)))

    def indices(self, names: Names) -> tuple[np.ndarray, np.ndarray]:
        count = len(self.key_points(names[0]).points)
        with read_as("hloc's matches", self.matches), h5py.File(self.matches) as file:
            group = file[self.places[names]]
            second = np.asarray(group["matches0"]).astype(np.int64)
            if len(second) != count:
                raise ValueError(f"matches0 has {len(second)} rows for {count} key points")
            kept = np.flatnonzero(second >= 0)
            scores = group.get("matching_scores0", np.ones(len(second)))
            return np.column_stack([kept, second[kept]]), np.asarray(scores, np.float64)[kept]


class NpzMatches(GivenMatches):
    """A folder with a file of points for each pair. The places are the names of the files."""

    upright = True

    def files(self) -> list[Path]:
        return [self.path / place for place in self.places.values()]

    def read(self, names: Names) -> Matches:
        path = self.path / self.places[names]
        with read_as("matches", path):
            arrays = read_arrays(path)
            points1 = arrays["points1"]
            return Matches(
                points1,
                arrays["points2"],
                arrays.get("confidence", np.ones(len(points1))),
                float(arrays.get("error_px", ERROR_PX)),
                bool(arrays.get("key_points", False)),
                str(arrays.get("weights", "")) or None,
            )


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
        return cls(Path("matches"), _images(matches), dict.fromkeys(matches, ""), (), held=matches)

    def files(self) -> list[Path]:
        return []

    def read(self, names: Names) -> Matches:
        return self.held[names]


def read_given(path: Path) -> GivenMatches:
    """The images and pairs of a source: a COLMAP database, a folder with hloc's files of features
    and of matches, or a folder of .npz.

    An .npz has `points1` and `points2` (N, 2), and optionally `confidence` (N,), `error_px` and
    `key_points`, by default False. `image1` and `image2` are the names of its images; without them
    its own name is NAME1_NAME2.npz. A damaged one with such a name is a pair, whose `read` raises.

    Raises InputError, with the path, if the source is none of these or has no matches; OSError if
    it cannot be read.
    """
    if not path.is_dir():
        return _read_database(path)
    if any(path.glob("*.h5")):
        return _read_hloc(path)
    files = sorted(path.glob("*.npz"))
    if not files:
        raise InputError(path, "holds neither hloc's .h5 nor an .npz")
    places, repeated = _each_once(path, ((_pair_names(file), file.name) for file in files))
    said = (
        f"{len(files)} .npz: points in pixels of the upright images, (0, 0) the first one's centre",
        *repeated,
    )
    return NpzMatches(path, _images(places), places, said)


def _read_database(path: Path) -> DatabaseMatches:
    table: Table = "matches"
    with open_database(path) as database:
        ids, sizes, cameras = read_images(database)
        database.execute("SELECT image_id, rows, cols, data FROM keypoints LIMIT 0")
        pairs = read_pairs(database, ids, table)
        said = [
            f"{path}: COLMAP's key points, whose first pixel has its centre at (0.5, 0.5): 0.5 "
            "is subtracted"
        ]
        if not pairs:
            table = "two_view_geometries"
            pairs = read_pairs(database, ids, table)
            said.append("no matches, but two-view geometries: their inliers are judged")
        if not pairs:
            raise ValueError("it has no matches")
    places = {names: str(key) for names, key in pairs.items()}
    return DatabaseMatches(
        path, tuple(sorted(ids)), places, tuple(said), sizes, cameras, ids=ids, table=table
    )


def _read_hloc(folder: Path) -> HlocMatches:
    found: dict[str, dict[Path, list[str]]] = {"keypoints": {}, "matches0": {}}
    for path in sorted(folder.glob("*.h5")):
        groups = _groups(path)
        for dataset, files in found.items():
            if those := groups.get(dataset):
                files[path] = those
    for dataset, files in found.items():
        if len(files) != 1:
            listed = ", ".join(file.name for file in files) or "no file"
            raise InputError(folder, f"needs one .h5 with {dataset}, and {listed} has it")
    ((features, names),) = found["keypoints"].items()
    ((matches, groups_of_pairs),) = found["matches0"].items()
    keys = {name.replace("/", "-"): name for name in names}
    if len(keys) < len(names):
        raise InputError(features, 'has names that differ only in "/" and "-"')
    split = {group: _split(group, keys) for group in groups_of_pairs}
    odd = [group for group, pair in split.items() if pair is None]
    known = ((pair, group) for group, pair in split.items() if pair is not None)
    places, repeated = _each_once(matches, known)
    if not places:
        first = f" (first: {odd[0]})" if odd else ""
        raise InputError(matches, f"has no pair of images of {features.name}{first}")
    said = [
        f"{folder}: hloc's key points, whose first pixel has its centre at (0, 0), as here",
        *repeated,
    ]
    if odd:
        no_two = f"{matches}: groups that name no two images of {features.name}"
        said.append(f"{no_two}: {len(odd)} (first: {odd[0]})")
    sizes = {}
    with read_as("hloc's features", features), h5py.File(features) as file:
        for name in names:
            if (size := file[name].get("image_size")) is not None:
                width, height = np.asarray(size).astype(int).tolist()
                sizes[name] = width, height
    return HlocMatches(
        folder, tuple(names), places, tuple(said), sizes, features=features, matches=matches
    )


def _groups(path: Path) -> dict[str, list[str]]:
    """By the name of a dataset, the groups of an .h5 that have one."""
    groups: dict[str, list[str]] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            group, _, dataset = name.rpartition("/")
            groups.setdefault(dataset, []).append(group)

    open_file(path).close()
    with read_as("an .h5", path), h5py.File(path) as file:
        file.visititems(visit)
    return groups


def _split(group: str, keys: Mapping[str, str]) -> Names | None:
    """The names of a pair from hloc's group, NAME1/NAME2 or, by older versions, NAME1_NAME2. keys:
    names by their form in groups."""
    for mark in "/_":
        ends = [match.start() for match in re.finditer(mark, group)]
        halves = [(group[:end], group[end + 1 :]) for end in ends]
        known = [(keys[a], keys[b]) for a, b in halves if a in keys and b in keys]
        if len(known) == 1:
            return known[0]
    return None


def guessed_size(camera: Camera) -> Size:
    """The size of an image whose middle is the principal point."""
    width, height = image_size(camera)
    return round(width), round(height)


def _pair_names(file: Path) -> Names:
    """The names in an .npz; if it has none or is damaged, those of which its own name consists."""
    arrays: Mapping[str, np.ndarray] = {}
    damage: InputError | OSError | None = None
    try:
        arrays = read_arrays(file)
    except (InputError, OSError) as error:
        damage = error
    if "image1" in arrays and "image2" in arrays:
        with read_as("names of images", file):
            return arrays["image1"].astype(str).item(), arrays["image2"].astype(str).item()
    ends = [match.start() for match in re.finditer("(?<=.)_(?=.)", file.stem)]
    splits = [(file.stem[:end], file.stem[end + 1 :]) for end in ends]
    pictures = [pair for pair in splits if all(map(_PICTURE.fullmatch, pair))]
    halves = pictures or splits
    if len(halves) == 1:
        return halves[0]
    ways = f"its name is NAME1_NAME2.npz in {len(halves)} ways, not in one"
    raise damage or InputError(file, f"has no arrays image1 and image2, and {ways}")


def _each_once(
    path: Path, pairs: Iterable[tuple[Names, str]]
) -> tuple[dict[Names, str], list[str]]:
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


def _images(pairs: Iterable[Names]) -> tuple[str, ...]:
    return tuple(sorted(set(chain.from_iterable(pairs))))
