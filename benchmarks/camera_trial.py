"""The cameras that methods have of a list: its K, a wrong K, or none."""

from dataclasses import dataclass
from typing import Literal

from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.cameras.by_image import checked_camera
from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.system.options import check_options, option

WithheldCameras = Literal["auto", "auto:shared", "auto:two"]
ToldCameras = Literal["list", WithheldCameras]


@dataclass(frozen=True)
class CameraTrial:
    """The cameras that methods have; errors are those of the list's K, whatever they have.

    Raises InputError, naming the field, on a value out of range, and for a K that is withheld and
    changed.
    """

    k: ToldCameras | None = option(
        None,
        "Report focal lengths and warnings too; auto withholds the K of LIST, auto:shared says "
        "that one camera took both images, auto:two that two did.",
        flag="--K",
    )
    k_scale: float = option(
        1.0, "Multiply the focal lengths of K.", flag="--K-scale", metavar="F", above=0, max=1000
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.withholds and self.k_scale != 1:
            raise InputError(f"K is {self.k}: it cannot be changed as well")

    @property
    def withholds(self) -> bool:
        """Whether the methods get no K."""
        return self.k not in (None, "list")

    @property
    def reports(self) -> bool:
        """Whether it is a trial at all."""
        return self != CameraTrial()

    def cameras(self, pair: PosedPair) -> tuple[Camera, Camera]:
        """What a method gets of a pair, with the warnings that a user would get.

        Raises InputError if a user would be refused the cameras.
        """
        truth = pair.truth
        if not self.reports:
            return truth.camera1, truth.camera2
        if self.withholds:
            return pair_cameras(self.k, self.k, pair.image1, pair.image2)
        camera1, camera2 = (
            checked_camera(camera.with_focal(self.k_scale * camera.focal), image.size, name)
            for name, camera, image in (
                ("K1", truth.camera1, pair.image1),
                ("K2", truth.camera2, pair.image2),
            )
        )
        return camera1, camera2
