"""The options of refinement, with defaults and units. docs/experiments.md has the measurements."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from dgc_pose.errors import InputError

# The source of the matches to align: the map itself, the encoder's features at native resolution,
# or optical flow from the map's estimate. "auto": the features, and the map if those give too few.
SourceName = Literal["auto", "map", "features", "flow"]


@dataclass(frozen=True)
class FeatureOptions:
    """Of `FeatureMatches`. Raises InputError, naming the field, on a value out of range."""

    long_side: int = 800  # pixels at most of the images that features are computed on
    candidates: int = 8  # cells of stride 16 compared for each cell, besides those of the map
    neighbours: int = 12  # that a match must agree with, to compare scales by
    # Mean matchability below which scales other than the map's are tried.
    other_scales_below: float = 0.25

    def __post_init__(self) -> None:
        _at_least(self, long_side=64, candidates=1, neighbours=4)
        _share(self, "other_scales_below")


@dataclass(frozen=True)
class FlowOptions:
    """Of `FlowMatches`. Raises InputError, naming the field, on a value out of range."""

    matchability: float = 0.7  # least matchability, 0 to 1
    long_side: int = 800  # pixels at most of the images that flow is computed on
    max_matches: int = 2000  # an even subsample of at most so many

    def __post_init__(self) -> None:
        _at_least(self, long_side=64, max_matches=1)
        _share(self, "matchability")


@dataclass(frozen=True)
class AlignmentOptions:
    """Of `Refiner`. Raises InputError, naming the field, on a value out of range."""

    align: bool = True  # whether patches of the originals are aligned around each match
    neighbours: int = 12  # nearest matches whose affinity a match must fit
    max_matches: int = 2000  # an even subsample of at most so many
    patch_radius: int = 7  # pixels of image 2; patches of 15x15
    min_zncc: float = 0.8  # least correlation of a pair of aligned patches
    min_matches: int = 50  # a step that leaves fewer is undone

    def __post_init__(self) -> None:
        _at_least(self, neighbours=4, max_matches=1, patch_radius=2, min_matches=1)
        if not 0 < self.min_zncc <= 1:
            raise InputError(f"min_zncc must lie in (0, 1], not {self.min_zncc}")


@dataclass(frozen=True)
class RefinementOptions:
    """How `load_matcher` refines a network's matches. Raises InputError if there is no such
    source."""

    source: SourceName = "auto"
    features: FeatureOptions = field(default_factory=FeatureOptions)
    flow: FlowOptions = field(default_factory=FlowOptions)
    alignment: AlignmentOptions = field(default_factory=AlignmentOptions)

    def __post_init__(self) -> None:
        if self.source not in get_args(SourceName):
            names = ", ".join(get_args(SourceName))
            raise InputError(f"source must be one of {names}, not '{self.source}'")


def _at_least(options: Any, **least: int) -> None:
    for name, low in least.items():
        value = getattr(options, name)
        if value < low:
            raise InputError(f"{name} must be at least {low}, not {value}")


def _share(options: Any, name: str) -> None:
    value = getattr(options, name)
    if not 0 <= value <= 1:
        raise InputError(f"{name} must lie in [0, 1], not {value}")
