"""Options that several commands share: dataclasses that `dataclass_options` makes options of."""

from dataclasses import dataclass
from pathlib import Path

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera, guess_camera
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.system.options import option


def split_names(text: str) -> list[str]:
    """The names in a comma-separated list, without blanks around them; empty ones are dropped."""
    return [name for name in (part.strip() for part in text.split(",")) if name]


@dataclass(frozen=True)
class CameraChoice:
    """What the user said about the cameras. --K1 and --K2 override --K."""

    k: str | None = option(
        None,
        "Camera of both images: fx,fy,cx,cy, a COLMAP camera MODEL,w,h,params, a file (a 3x3 text "
        "or .npy, COLMAP's, .csv, transforms.json, KITTI's), or auto: it is not known. auto:shared "
        "says that one camera took both images, auto:two that two did.",
        flag="--K",
        metavar="K|FILE|auto",
    )
    k1: str | None = option(None, "Camera of image 1 alone.", flag="--K1", metavar="K")
    k2: str | None = option(None, "Camera of image 2 alone.", flag="--K2", metavar="K")
    guess_focal: bool = option(
        False,
        "Without a K, take the focal length from EXIF or guess it. Poses get much worse.",
    )

    def resolve(self, image1: Image, image2: Image) -> tuple[Camera, Camera]:
        """The cameras of both images, checked. Raises InputError, naming the option, if one is
        missing, unusable, or does not fit its image."""
        text1, text2 = (self.k if k is None else k for k in (self.k1, self.k2))
        name1, name2 = (
            "--K" if k is None else f"--K{number}"
            for number, k in enumerate((self.k1, self.k2), start=1)
        )
        if self.guess_focal and text1 is None and text2 is None:
            return guess_camera(Path(image1.name)), guess_camera(Path(image2.name))
        if text1 is None or text2 is None:
            number = 1 if text1 is None else 2
            raise InputError(f"image {number} has no K: give --K or --K{number}, or --K auto")
        return pair_cameras(text1, text2, image1, image2, (name1, name2))
