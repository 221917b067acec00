"""The options of refinement."""

from dataclasses import dataclass
from typing import Literal

from dgc_pose.system.options import check_options, option

# The source of the matches to align: those selected from the map, or matches of the encoder's
# features at native resolution. "auto": the features', and the map's if those are too few. "none":
# no refinement.
SourceName = Literal["none", "auto", "map", "features"]


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

    def __post_init__(self) -> None:
        check_options(self)
