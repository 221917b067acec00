"""What a matcher is, and the dense map that the network's matcher makes on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dgc_pose.image import Image
from dgc_pose.matches import Matches


class Matcher(Protocol):
    """Anything that matches two images."""

    @property
    def name(self) -> str:
        """What results and tables call it."""
        ...

    def match(self, image1: Image, image2: Image) -> Matches:
        """Matches in pixels of the original images."""
        ...


@dataclass(frozen=True)
class CorrespondenceMap:
    """A dense map over image 2's grid. All places are pixels of the original images."""

    map: np.ndarray  # (H, W, 2) float32, for each cell of image 2 its x and y in image 1; no NaN
    grid: np.ndarray  # (H, W, 2) float32, the cells' x and y in image 2
    matchability: np.ndarray  # (H, W) float32 in [0, 1]; 1 everywhere for a net without a mask
    size1: tuple[int, int]  # (width, height) of image 1
    size2: tuple[int, int]  # (width, height) of image 2
    # (H, W) float32, pixels of image 2: how far the cell's place in image 1 maps back from it;
    # None where the way back was not asked for
    cycle: np.ndarray | None = None
