"""Options of the reconstruction of a model from a batch; most are options of commands too."""

from dataclasses import dataclass
from typing import Literal

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.images.markers import MAX_SIDE
from dgc_pose.system.options import check_options, option

MapperName = Literal["incremental", "global"]


@dataclass(frozen=True)
class ReconstructionOptions:
    """How a model is reconstructed from a batch.

    Raises InputError, naming the field, for a value out of range, and if more than one of `gps`,
    `scale` and `marker` is set.
    """

    per_image: int = option(
        1000, "Most corners of an image.", metavar="N", min=1, max=10**7, section="reconstruction"
    )
    mapper: MapperName = option(
        "incremental", "incremental or global.", metavar="NAME", section="reconstruction"
    )
    refine_intrinsics: bool = option(
        False,
        "Bundle adjustment changes focal lengths and distortion; always if K is auto.",
        section="reconstruction",
    )
    gps: bool = option(False, "Metres by the GPS positions in EXIF data.", section="reconstruction")
    scale: str | None = option(
        None, "Distance of two cameras.", metavar="NAME1,NAME2,METRES", section="reconstruction"
    )
    marker: float | None = option(
        None,
        "Metres by the side of printed ArUco or AprilTag markers.",
        metavar="METRES",
        above=0,
        max=MAX_SIDE,
        unit=" metres",
        section="reconstruction",
    )

    min_images: int = option(3, min=2)  # of a model
    refine_centres: bool = False  # bundle adjustment changes principal points of uncertain cameras

    def __post_init__(self) -> None:
        check_options(self)
        stated = [ArgumentName(n) for n in ("gps", "scale", "marker") if getattr(self, n)]
        if len(stated) > 1:
            both = "both set the scale: give only one"
            raise InputError(stated[0], "and", stated[1], both)
