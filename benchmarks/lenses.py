"""Lenses that rendered pairs are seen through: one of each of COLMAP's models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from dgc_pose.cameras.colmap_camera import Distortion

if TYPE_CHECKING:
    from dgc_pose.training.synthesis.render.cameras import Cameras


@dataclass(frozen=True)
class Lens:
    """A lens before a square sensor."""

    model: str  # COLMAP's name
    focal: float  # over the side of the image
    coefficients: tuple[float, ...] = ()

    @cached_property
    def distortion(self) -> Distortion | None:
        """None for a pinhole."""
        if self.model in ("PINHOLE", "SIMPLE_PINHOLE"):
            return None
        return Distortion(self.model, self.coefficients)

    def before(self, cameras: Cameras) -> Cameras:
        """Cameras in the same places, and of the same size and principal point, with this lens."""
        from dgc_pose.training.synthesis.render.cameras import LensCameras

        K = cameras.K.clone()
        K[:, 0, 0] = K[:, 1, 1] = self.focal * cameras.size[0]
        cameras = replace(cameras, K=K)
        if self.distortion is None:
            return cameras
        return LensCameras(**vars(cameras), lens=self.distortion)


# OPENCV: EuRoC's camera; FULL_OPENCV: an Azure Kinect; OPENCV_FISHEYE: TUM-VI; FOV: TUM's monocular
# odometry; RAD_TAN_THIN_PRISM_FISHEYE: Project Aria. The others are about as strong. Fields of view
# from corner to corner: 83 to 90 degrees with radial distortion, 99 to 120 of OPENCV, FULL_OPENCV
# and the division models, 130 to 160 of the fisheyes, FOV and EUCM. The pinholes are there to
# compare with: PINHOLE for the radial models, SIMPLE_PINHOLE for the others, of focal lengths as
# short.
LENSES = {
    lens.model: lens
    for lens in (
        Lens("PINHOLE", 0.8),
        Lens("SIMPLE_PINHOLE", 0.55),
        Lens("SIMPLE_RADIAL", 0.8, (-0.1,)),
        Lens("RADIAL", 0.8, (-0.15, 0.03)),
        Lens("OPENCV", 0.61, (-0.2834, 0.074, 0.0002, 0.00002)),
        Lens("FULL_OPENCV", 0.6, (0.455, -2.51, 0.00085, -0.00027, 1.46, 0.335, -2.33, 1.39)),
        Lens("SIMPLE_DIVISION", 0.61, (-0.2,)),
        Lens("DIVISION", 0.61, (-0.25,)),
        Lens("FOV", 0.5, (0.92,)),
        Lens("EUCM", 0.5, (0.6, 1.1)),
        Lens("SIMPLE_FISHEYE", 0.53),
        Lens("FISHEYE", 0.6),
        Lens("SIMPLE_RADIAL_FISHEYE", 0.55, (-0.02,)),
        Lens("RADIAL_FISHEYE", 0.5, (0.03, -0.005)),
        Lens("OPENCV_FISHEYE", 0.53, (0.00348, 0.00072, -0.00205, 0.0002)),
        Lens(
            "THIN_PRISM_FISHEYE",
            0.55,
            (-0.02, 0.01, 0.0005, -0.0003, -0.004, 0.001, 0.0005, 0.0005),
        ),
        Lens(
            "RAD_TAN_THIN_PRISM_FISHEYE",
            0.55,
            (0.4053, -0.4895, 0.1746, 1.133, -1.7038, 0.6511)
            + (0.0004, -0.0002, 0.0005, 0.0001, -0.0005, 0.0001),
        ),
    )
}
