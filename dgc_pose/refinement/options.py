"""What refinement may be told, each choice with its default and unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from dgc_pose.errors import InputError

# Where the matches that alignment starts from are taken from: the dense map itself, the encoder's
# features at native resolution, optical flow after the map, SIFT key points, or the network run
# again on tiles. "auto": the features, and the map where they leave too few.
MatchSource = Literal["auto", "map", "features", "flow", "sift", "zoom"]


@dataclass(frozen=True)
class RefinementOptions:
    """How matches are refined. Raises InputError, naming the field, on a value out of range."""

    source: MatchSource = "auto"
    align: bool = True  # patches of the originals aligned around each match, to a part of a pixel
    long_side: int = 800  # pixels at most of the images that features and flow are taken from
    candidates: int = 8  # places at stride 16, beside those of the map, that each cell may lie in
    tiles: int = 3  # of the target along each axis, for zoom
    window_cells: float = 4.0  # radius, in cells of the map, that SIFT key points are searched in
    sift_ratio: float = 0.85  # largest distance, of that to the second best within the window
    neighbours: int = 12  # matches that a match must agree with
    max_matches: int = 2000  # an even subsample of at most so many
    patch_radius: int = 7  # pixels of image 2; patches of 15x15
    min_zncc: float = 0.8  # least correlation of a pair of aligned patches
    back_px: float | None = None  # image 2: aligned back, a match may be so far off; None: not done
    # Fewer matches than this are not worth the loss: the stage before is kept.
    min_matches: int = 50

    def __post_init__(self) -> None:
        if self.source not in get_args(MatchSource):
            names = ", ".join(get_args(MatchSource))
            raise InputError(f"source must be one of {names}, not '{self.source}'")
        least = {
            "long_side": 64,
            "candidates": 1,
            "tiles": 1,
            "neighbours": 4,
            "max_matches": 1,
            "patch_radius": 2,
            "min_matches": 1,
        }
        for name, low in least.items():
            if getattr(self, name) < low:
                raise InputError(f"{name} must be at least {low}, not {getattr(self, name)}")
        if not 0 < self.window_cells < float("inf"):
            raise InputError(f"window_cells must be positive and finite, not {self.window_cells}")
        if self.back_px is not None and not 0 < self.back_px < float("inf"):
            raise InputError(f"back_px must be positive and finite, not {self.back_px}")
        for name in ("sift_ratio", "min_zncc"):
            if not 0 < getattr(self, name) <= 1:
                raise InputError(f"{name} must lie in (0, 1], not {getattr(self, name)}")
