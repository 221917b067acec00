"""Lists of DTU pairs in SuperGlue's format: only which views make a pair is taken from them.

Scene and view come from the names of the images (`scan65/rect_012_3_r5000.png`); the truth comes
from the calibration, so that a list serves every light.
"""

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from dgc_pose.benchmarks.dtu.dataset import Dataset
from dgc_pose.benchmarks.dtu.view_pairs import (
    ViewPair,
    ViewPairOptions,
    draw,
    find_view_pairs,
    view_pair,
)
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.errors import InputError

PAIRS = 3000  # of the paper
_NAME = re.compile(r"(?:.*/)?scan(\d+)(?:_train)?/(?:rect|clean)_(\d{3})_\w+\.\w+")


def choose_pairs(
    dataset: Dataset, pairs: str, *, seed: int, scenes: Sequence[int] | None = None
) -> list[ViewPair]:
    """The pairs that a number (so many, drawn by the seed) or the path of a list stands for, scene
    by scene, so that cached images serve all pairs of their scene.

    Raises InputError if the number is not positive or no views fit, and what `read_view_pairs`
    raises.
    """
    if Path(pairs).exists() or not pairs.lstrip("-").isdigit():
        chosen = read_view_pairs(pairs, dataset, scenes=scenes)
    else:
        options = ViewPairOptions(pairs=int(pairs), seed=seed)
        chosen = draw(find_view_pairs(dataset, options), options)
        if not chosen:
            raise InputError(
                f"{dataset.root}: no two views are {options.min_rotation:g} to "
                f"{options.max_rotation:g} degrees apart and share {options.min_overlap:g} of what "
                "they see"
            )
    return sorted(chosen, key=lambda pair: pair.scene)


def read_view_pairs(
    path: str | Path, dataset: Dataset, *, scenes: Collection[int] | None = None
) -> list[ViewPair]:
    """The pairs of views of a list; with `scenes`, of these alone.

    Raises InputError, with the path, for a pair that is none or names a view that the data set
    lacks, and for a list without any pair; OSError if the file cannot be read.
    """
    pairs = []
    for listed in read_pairs(path):
        where = f"{path}: {listed.name1} {listed.name2}"
        (scene, view1), (other, view2) = (_view(n, where) for n in (listed.name1, listed.name2))
        if scene != other:
            raise InputError(f"{where}: expected two views of one scene")
        if scenes is None or scene in scenes:
            try:
                pairs.append(view_pair(dataset.scene(scene), view1, view2))
            except InputError as error:
                raise InputError(f"{where}: {error}") from None
    if not pairs:
        raise InputError(f"{path}: no pairs in this list")
    return pairs


def _view(name: str, where: str) -> tuple[int, int]:
    """Scene and view of an image by its name."""
    match = _NAME.fullmatch(name)
    if match is None:
        raise InputError(f"{where}: expected the names of DTU images")
    return int(match[1]), int(match[2])
