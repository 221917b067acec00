"""Options that several commands share: dataclasses that `dataclass_options` makes options of."""

import re
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from dgc_pose.cameras.by_image import KDetails
from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.cli.guard import OutputFile
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.system.options import option


def output_file(help: str, metavar: str, **kind: bool) -> Any:
    """A field of an output file, None by default. kind: as of `OutputFile`."""
    return option(None, help, metavar=metavar, type=OutputFile(**kind))


_camera = partial(option, None, metavar="K|FILE|auto", section="cameras")
_detail = partial(option, None, section="advanced")


def parse_size(text: str) -> tuple[int, int]:
    """A text WxH. Raises InputError for another one."""
    match = re.fullmatch(r"0*([1-9]\d{0,5})[xX]0*([1-9]\d{0,5})", text.strip())
    if match is None:
        raise InputError(f"--K-size must be WxH in pixels, such as 1600x1200, not {text!r}")
    return int(match[1]), int(match[2])


def parse_deviations(text: str) -> tuple[float, float]:
    """A text F[,C]; C is 0 without one. Raises InputError for another one."""
    with suppress(ValueError):
        focal, centre = map(float, (text if "," in text else f"{text},0").split(","))
        if 0 <= focal <= 1 and 0 <= centre < 1e6:
            return focal, centre
    raise InputError(
        f"--K-std must be F or F,C, the relative deviation of the focal length, at most 1, and the "
        f"pixels of the principal point, not {text!r}"
    )


@dataclass(frozen=True)
class KChoice:
    """The options of K, for all images."""

    k: str | None = _camera(
        "Camera of all images: fx,fy,cx,cy; COLMAP's MODEL,w,h,params; a file (COLMAP, OpenCV, "
        "ROS, Kalibr, KITTI, NeRF, .csv, JSON, 3x3 matrix); or auto: not known (auto:shared: one "
        "camera took all, auto:two: each has its own).",
        flag="--K",
    )
    k_size: tuple[int, int] | None = _detail(
        "Size of the images that K is for: K is scaled.",
        flag="--K-size",
        metavar="WxH",
        parse=parse_size,
    )
    k_std: tuple[float, float] | None = _detail(
        "Standard deviation of f, relative, and centre, px.",
        flag="--K-std",
        metavar="F[,C]",
        parse=parse_deviations,
    )

    @property
    def details(self) -> KDetails:
        """The facts about K besides its numbers."""
        return KDetails(self.k_size, *(self.k_std or ()))


@dataclass(frozen=True)
class CameraChoice(KChoice):
    """The options of the cameras of two images. --K1 and --K2 override --K."""

    k1: str | None = _camera("Camera of image 1; of both without --K2 and --K.", flag="--K1")
    k2: str | None = _camera("Camera of image 2 alone.", flag="--K2")
    fov: float | None = _camera("Horizontal field of view.", metavar="DEGREES", section="advanced")

    def resolve(self, image1: Image, image2: Image) -> tuple[Camera, Camera]:
        """The cameras of both images, checked; without any option as of --K auto. Raises
        InputError, naming the option, if one is unusable, or does not fit its image."""
        name1, text1 = ("--K", self.k) if self.k1 is None else ("--K1", self.k1)
        name2, text2 = ("--K", self.k) if self.k2 is None else ("--K2", self.k2)
        if text2 is None:
            name2, text2 = name1, text1
        return pair_cameras(text1, text2, image1, image2, (name1, name2), self.details, self.fov)


@dataclass(frozen=True)
class MaskChoice:
    """The options of the masks of two images."""

    mask1: str | None = option(None, "Black is not matched.", metavar="FILE", section="matching")
    mask2: str | None = option(None, "The same of image 2.", metavar="FILE", section="matching")
