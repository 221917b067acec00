"""From a correspondence map to matches: by matchability, by the way back, evenly spread."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import CorrespondenceMap

FinestLevel = Literal[240, 120, 60]

# Error of a good match along one axis, in cells of the map's grid; see docs/accuracy.md.
ERROR_CELLS = 0.5


@dataclass(frozen=True)
class MatchingOptions:
    """Which cells of the dense map become matches. Raises InputError on values out of range."""

    matchability: float = 0.7  # least matchability, 0 to 1
    cycle_px: float | None = None  # largest error of the way there and back, pixels of image 2
    max_matches: int = 2000  # an even subsample of at most so many
    min_share: float = 0.01  # of the cells that must pass: a smaller patch is a chance likeness
    # Where the mean matchability is below this, image 2 is matched as well at the roll, of 90, 180
    # and 270 degrees, that its coarsest features ask for: the network knows photographs upright.
    roll_share: float = 0.25
    # Cells a side of the level that the map is taken from: the coarser, the faster.
    finest: FinestLevel = 240

    def __post_init__(self) -> None:
        for name in ("matchability", "min_share", "roll_share"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise InputError(f"{name} must lie in [0, 1], not {value}")
        if self.cycle_px is not None and not self.cycle_px > 0:
            raise InputError(f"cycle_px must be positive, not {self.cycle_px}")
        if self.finest not in get_args(FinestLevel):
            sizes = ", ".join(map(str, get_args(FinestLevel)))
            raise InputError(f"finest must be one of {sizes}, not {self.finest}")
        if self.max_matches < 1:
            raise InputError(f"max_matches must be at least 1, not {self.max_matches}")


def select_matches(correspondences: CorrespondenceMap, options: MatchingOptions) -> Matches:
    """The cells that pass the options, as matches. Raises InputError where a cycle is wanted of a
    map that was made without the way back."""
    place = correspondences.map
    width, height = correspondences.size1
    keep = correspondences.matchability >= options.matchability
    keep &= (place >= -0.5).all(-1) & (place <= (width - 0.5, height - 0.5)).all(-1)
    if options.cycle_px is not None:
        if correspondences.cycle is None:
            raise InputError("cycle_px needs a correspondence map made with the way back")
        keep &= correspondences.cycle <= options.cycle_px
    if keep.mean() < options.min_share:
        keep = np.zeros_like(keep)
    keep = even_subsample(keep, correspondences.matchability, options.max_matches)
    return Matches(
        place[keep],
        correspondences.grid[keep],
        correspondences.matchability[keep],
        error_px=ERROR_CELLS * cell_size(correspondences),
    )


def cell_size(correspondences: CorrespondenceMap) -> float:
    """Side of a cell in pixels of the original images: mean over both images and both axes."""
    cells = correspondences.matchability.size
    areas = [w * h / cells for w, h in (correspondences.size1, correspondences.size2)]
    return sum(math.sqrt(area) for area in areas) / 2


def even_subsample(keep: np.ndarray, confidence: np.ndarray, most: int) -> np.ndarray:
    """At most `most` of the True cells of `keep` (H, W), spread evenly, as a mask (H, W).

    The grid falls into square blocks, as small as the number allows, and the most confident cell
    of each stays: an even spread keeps the essential matrix well conditioned where confident
    cells crowd on one object.
    """
    rows, columns = np.nonzero(keep)
    if len(rows) <= most:
        return keep
    order = np.argsort(-confidence[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    side = math.sqrt(len(rows) / most)
    while True:
        blocks = rows // side * keep.shape[1] + columns // side
        _, first = np.unique(blocks, return_index=True)
        if len(first) <= most:
            break
        side *= 1.05
    chosen = np.zeros_like(keep)
    chosen[rows[first], columns[first]] = True
    return chosen
