"""How a batch becomes a model, also as options of the commands."""

from dataclasses import dataclass, field
from typing import Literal

from dgc_pose.system.options import check_options, option

Sharing = Literal["tracks", "cells"]
MapperName = Literal["incremental", "global"]


@dataclass(frozen=True)
class SharingOptions:
    """How key points are shared between the pairs of an image.

    Raises InputError, naming the field, for a value out of range.
    """

    sharing: Sharing = option(
        "tracks",
        "Key points: tracks, corners located anew in each pair, which reads the images again; or "
        "cells, matches merged as hloc does.",
        metavar="NAME",
        section="reconstruction",
    )
    per_image: int | None = option(
        None,
        "Most corners (1000) or cells (8192) of an image.",
        metavar="N",
        min=1,
        max=10**7,
        section="reconstruction",
    )
    cell: float = option(
        1.0,
        "Side of a cell and farthest move of a match, pixels; for cells.",
        metavar="PX",
        above=0,
        max=10**4,
        section="reconstruction",
    )

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class MappingOptions:
    """How images are mapped. Raises InputError, naming the field, for a value out of range."""

    mapper: MapperName = option(
        "incremental", "incremental or global.", metavar="NAME", section="reconstruction"
    )
    refine_intrinsics: bool = option(
        False,
        "Bundle adjustment changes focal lengths and distortion; always with --K auto.",
        section="reconstruction",
    )
    mapper_threads: int = option(
        1,
        "With more than one, models differ in their last digits.",
        metavar="N",
        min=1,
        max=1024,
        section="reconstruction",
    )

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class ReconstructionOptions:
    """How a batch becomes a model."""

    sharing: SharingOptions = field(default_factory=SharingOptions)
    mapping: MappingOptions = field(default_factory=MappingOptions)
    gps: bool = option(False, "Metres by the GPS positions in EXIF data.", section="reconstruction")
    scale: str | None = option(
        None, "Distance of two cameras.", metavar="NAME1,NAME2,METRES", section="reconstruction"
    )
