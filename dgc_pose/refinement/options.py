"""The options of refinement, with defaults and units. docs/experiments.md has the measurements."""

from dataclasses import dataclass, field
from typing import Literal

from dgc_pose.refinement.align import CORNER_RADIUS
from dgc_pose.system.options import check_options, option

# The source of the matches to align: those selected from the map, or matches of the encoder's
# features at native resolution. "auto": the features', and the map's if those are too few. "none":
# no refinement.
SourceName = Literal["none", "auto", "map", "features"]


@dataclass(frozen=True)
class FeatureOptions:
    """Of `FeatureMatches`. Raises InputError, naming the field, for a value out of range."""

    long_side: int = option(800, min=64)  # most pixels of the images that features are computed on
    similar: int = option(12, min=1)  # most similar cells of stride 16, for the consensus
    likely: int = option(4, min=1)  # of them and the map's, those searched besides the map's
    # Most pixels of those of a quick pass; 0: none.
    quick_side: int = option(512, min=0)
    squeezed: bool = True  # whether a pose in doubt gets the matches of squeezed images
    # Of a pose in doubt, those near whose epipolar lines matches are searched again; 0: none.
    hypotheses: int = option(4, min=0)

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class AlignmentOptions:
    """Of `Refiner`. Raises InputError, naming the field, for a value out of range."""

    align: bool = True  # whether patches of the originals are aligned around each match
    neighbours: int = option(12, min=4)  # nearest matches whose affinity a match must fit
    # Pixels of image 2, along each axis, that a match moves at most, to a corner.
    corner_radius: int = option(CORNER_RADIUS, min=0)
    patch_radius: int = option(7, min=2)  # pixels of image 2; patches of 15x15
    min_zncc: float = option(0.8, above=0, max=1)  # least correlation of a pair of aligned patches
    min_matches: int = option(50, min=1)  # a step that leaves fewer is undone
    # Fewer aligned matches than this are completed by the consistent ones that were not aligned.
    min_aligned: int = option(100, min=1)

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class RefinementOptions:
    """How `load_matcher` refines a network's matches. Raises InputError for an unknown source."""

    source: SourceName = option(
        "auto",
        "Matches aligned on the originals: none; map; features, of the encoder at native "
        "resolution; auto: these, and the map's if they are few.",
        metavar="SOURCE",
        flag="--refine",
        section="matching",
    )
    features: FeatureOptions = field(default_factory=FeatureOptions)
    alignment: AlignmentOptions = field(default_factory=AlignmentOptions)

    def __post_init__(self) -> None:
        check_options(self)
