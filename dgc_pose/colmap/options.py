"""How a batch becomes a model, also as options of the commands."""

from dataclasses import dataclass, field
from typing import Literal

from dgc_pose.system.options import check_options, option

MapperName = Literal["incremental", "global"]


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
    """How a batch becomes a model.

    Raises InputError, naming the field, for a value out of range.
    """

    per_image: int = option(
        1000, "Most corners of an image.", metavar="N", min=1, max=10**7, section="reconstruction"
    )
    mapping: MappingOptions = field(default_factory=MappingOptions)
    gps: bool = option(False, "Metres by the GPS positions in EXIF data.", section="reconstruction")
    scale: str | None = option(
        None, "Distance of two cameras.", metavar="NAME1,NAME2,METRES", section="reconstruction"
    )

    def __post_init__(self) -> None:
        check_options(self)
