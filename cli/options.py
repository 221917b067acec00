"""Options that several commands share: dataclasses that `dataclass_options` makes options of."""

from dataclasses import dataclass
from pathlib import Path

from dgc_pose.cameras.camera import Camera, camera_for, guess_camera
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
        "Camera of both images: fx,fy,cx,cy, a 3x3 text or .npy file, or a COLMAP camera "
        "MODEL,w,h,params.",
        flag="--K",
        metavar="K",
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
        return self._camera(1, self.k1, image1), self._camera(2, self.k2, image2)

    def _camera(self, number: int, k: str | None, image: Image) -> Camera:
        name, text = ("--K", self.k) if k is None else (f"--K{number}", k)
        if text is not None:
            return camera_for(text, image.size, name)
        if self.guess_focal:
            return guess_camera(Path(image.name))
        raise InputError(
            f"image {number} has no K: give --K or --K{number}, or --guess-focal for a rough guess"
        )
