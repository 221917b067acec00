"""From a correspondence map to matches: by matchability, evenly spread."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dgc_pose.geometry.sampling import spread
from dgc_pose.matches import Matches
from dgc_pose.matching.correspondence_map import CorrespondenceMap
from dgc_pose.system.options import check_options, option

MIN_SHARE = 0.01  # of all cells that must pass; a smaller patch matches by chance


@dataclass(frozen=True)
class MatchingOptions:
    """Which matches a dense map gives. Raises InputError, naming the field, for a value out of
    range.

    Attributes:
        finest: Cells a side of the level that the map is taken from.
        aligned: What a network refines on the originals: the matches selected from its map, or
            those of its features; other matchers refine nothing.
    """

    finest: Literal[240, 120, 60] = option(
        240,
        "Cells a side of the dense map, 240, 120 or 60: fewer are faster.",
        metavar="CELLS",
        section="matching",
    )
    matchability: float = option(
        0.7,
        "Least matchability of a match of the map, 0 to 1; for --refine none and map.",
        metavar="T",
        min=0,
        max=1,
        section="matching",
    )
    max_matches: int = option(
        2000, "Most matches, evenly spread.", metavar="N", min=1, max=2**31, section="matching"
    )
    aligned: Literal["none", "auto", "map", "features"] = option(
        "auto",
        "Matches aligned on the originals: none; map; features, of the encoder at native "
        "resolution; auto: these, and the map's if they are few.",
        metavar="SOURCE",
        flag="--refine",
        section="matching",
    )

    def __post_init__(self) -> None:
        check_options(self)


def select_matches(
    correspondence_map: CorrespondenceMap, options: MatchingOptions, min_share: float = MIN_SHARE
) -> Matches:
    """The cells that pass the options, as matches; none if they are less than a share of all. With
    matchability 0 and min_share 0 these are all cells that the map sends into image 1.
    """
    points1 = correspondence_map.map
    width, height = correspondence_map.size1
    keep = correspondence_map.matchability >= options.matchability
    keep &= (points1 >= -0.5).all(-1) & (points1 <= (width - 0.5, height - 0.5)).all(-1)
    if keep.mean() < min_share:
        keep = np.zeros_like(keep)
    # Evenly spread, the matches condition the essential matrix well where the confident cells
    # concentrate on one object.
    cells, confidence = np.argwhere(keep)[:, ::-1], correspondence_map.matchability[keep]
    side = max(1.0, math.sqrt(len(cells) / options.max_matches))
    rows = spread(cells, confidence, keep.shape[::-1], options.max_matches, side, 1.05)
    grid, error_px = correspondence_map.grid, correspondence_map.error_px
    return Matches(points1[keep][rows], grid[keep][rows], confidence[rows], error_px=error_px)
