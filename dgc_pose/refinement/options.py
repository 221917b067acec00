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
    """Of `FeatureMatches`. Raises InputError, naming the field, for a value out of range.

    Attributes:
        long_side: Most pixels of the images that features are computed on.
        similar: Most similar cells of stride 16, for the consensus.
        likely: Number of them and of the map's that are searched besides the map's.
        quick_side: `long_side` of a quick pass; 0: there is none.
        squeezed: Whether a pose in doubt gets the matches of squeezed images.
        hypotheses: Number of poses, of a pose in doubt, near whose epipolar lines matches are
            searched again; 0: none.
    """

    long_side: int = option(800, min=64)
    similar: int = option(12, min=1)
    likely: int = option(4, min=1)
    quick_side: int = option(512, min=0)
    squeezed: bool = True
    hypotheses: int = option(4, min=0)

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class AlignmentOptions:
    """Of `Refiner`. Raises InputError, naming the field, for a value out of range.

    Attributes:
        align: Whether patches of the originals are aligned around each match.
        neighbours: Nearest matches whose affinity a match must fit.
        corner_radius: Pixels of image 2, along each axis, that a match moves at most, to a corner.
        patch_radius: Radius of a patch, pixels of image 2: 7 for patches of 15x15.
        min_zncc: Least correlation of a pair of aligned patches.
        min_matches: A step that leaves fewer matches is undone.
        min_aligned: Fewer aligned matches than this are completed by the consistent ones that were
            not aligned.
    """

    align: bool = True
    neighbours: int = option(12, min=4)
    corner_radius: int = option(CORNER_RADIUS, min=0)
    patch_radius: int = option(7, min=2)
    min_zncc: float = option(0.8, above=0, max=1)
    min_matches: int = option(50, min=1)
    min_aligned: int = option(100, min=1)

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class RefinementOptions:
    """How `load_matcher` refines a network's matches. Raises InputError for an unknown source.

    Attributes:
        features: Options of the features' matches.
        alignment: Options of the alignment.
    """

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
