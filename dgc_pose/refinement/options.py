"""The options of refinement, with defaults and units. docs/experiments.md has the measurements."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
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
    other_scales_below: float = 0.25  # mean matchability; other scales than the map's are tried

    def __post_init__(self) -> None:
        _within(self, long_side=(64, inf), candidates=(1, inf), neighbours=(4, inf))
        _within(self, other_scales_below=(0, 1))


@dataclass(frozen=True)
class FlowOptions:
    """Of `FlowMatches`. Raises InputError, naming the field, on a value out of range."""

    matchability: float = 0.7  # least matchability, 0 to 1
    long_side: int = 800  # pixels at most of the images that flow is computed on
    max_matches: int = 2000  # an even subsample of at most so many

    def __post_init__(self) -> None:
        _within(self, matchability=(0, 1), long_side=(64, inf), max_matches=(1, inf))


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
        _within(self, neighbours=(4, inf), max_matches=(1, inf), patch_radius=(2, inf))
        _within(self, min_zncc=(0.01, 1), min_matches=(1, inf))


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


def _within(options: Any, **ranges: tuple[float, float]) -> None:
    for name, (low, high) in ranges.items():
        value = getattr(options, name)
        if not low <= value <= high:
            limits = f"at least {low}" if high == inf else f"between {low:g} and {high:g}"
            raise InputError(f"{name} must be {limits}, not {value}")
