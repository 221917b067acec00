"""Two cameras and the pose between them: where the match of a point may lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.geometry.epipolar import essential_from_pose


@dataclass(frozen=True, eq=False)
class TwoViews:
    """The pose x2 = R x1 + t of camera 2 relative to camera 1."""

    camera1: Camera
    camera2: Camera
    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), unit length

    @property
    def E(self) -> np.ndarray:
        """Essential matrix [t]x R (3, 3) of normalised points."""
        return essential_from_pose(self.R, self.t)
