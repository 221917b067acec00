"""Matches in hloc's layout: a file of features and a file of matches."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from dgc_pose.batch.given.matches import (
    ERROR_PX,
    IndexedMatches,
    KeyPoints,
    Names,
    each_once,
)
from dgc_pose.errors import InputError
from dgc_pose.system.files import open_file, read_as


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


def read_hloc(folder: Path) -> HlocMatches:
    """The images and pairs of a folder with hloc's files. Raises InputError, with the path, if
    there are several of a kind or none, or if no pair has matches; OSError if one cannot be
    read."""
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
    places, repeated = each_once(matches, known)
    if not places:
        first = f" (first: {odd[0]})" if odd else ""
        raise InputError(matches, f"has no pair of images of {features.name}{first}")
    notes = [
        f"{folder}: hloc's key points, whose first pixel has its centre at (0, 0), as here",
        *repeated,
    ]
    if odd:
        no_two = f"{matches}: groups that name no two images of {features.name}"
        notes.append(f"{no_two}: {len(odd)} (first: {odd[0]})")
    sizes = {}
    with read_as("hloc's features", features), h5py.File(features) as file:
        for name in names:
            if (size := file[name].get("image_size")) is not None:
                width, height = np.asarray(size).astype(int).tolist()
                sizes[name] = width, height
    return HlocMatches(
        folder, tuple(names), places, tuple(notes), sizes, features=features, matches=matches
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
