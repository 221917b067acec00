"""A folder with a file of matches for each pair."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dgc_pose.batch.given.matches import ERROR_PX, GivenMatches, Names, each_once, images_of
from dgc_pose.errors import InputError
from dgc_pose.matches import Matches
from dgc_pose.system.arrays import read_arrays
from dgc_pose.system.files import read_as

_PICTURE = re.compile(r".+\.[^\W\d_][^\W_]*")  # a name with an ending


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


def read_npz(path: Path) -> NpzMatches:
    """The images and pairs of a folder of .npz, see `read_given`. Raises InputError, with the path,
    without a file and for one whose images are not known; OSError if one cannot be read."""
    files = sorted(path.glob("*.npz"))
    if not files:
        raise InputError(path, "holds neither hloc's .h5 nor an .npz")
    places, repeated = each_once(path, ((_pair_names(file), file.name) for file in files))
    notes = (
        f"{len(files)} .npz: points in pixels of the upright images, (0, 0) the first one's centre",
        *repeated,
    )
    return NpzMatches(path, images_of(places), places, notes)


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
