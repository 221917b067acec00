"""The dense map of two images."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches

# Error of a good match of a map along one axis, in cells of its grid; see docs/experiments.md.
ERROR_CELLS = 0.5
# Mean matchability below which the images may be rotated or of different scales
WEAK = 0.25
_SAMPLE = 40  # cells a row of the sample of a map


@dataclass(frozen=True, eq=False)
class CorrespondenceMap:
    """A dense map over image 2's grid. All points are in pixels of the original images.

    Attributes:
        map: For each cell of image 2 its x and y in image 1, (H, W, 2) float32; no NaN.
        grid: The cells' x and y in image 2, (H, W, 2) float32.
        matchability: Probability that a cell's match can be used, (H, W) float32; 1 everywhere for
            a net without a mask.
        size1: Size (width, height) of image 1, pixels.
        size2: Size (width, height) of image 2, pixels.
        used: (H, W) bool, False where either point lies on a masked pixel, and matchability is 0;
            None if no image has a mask.
    """

    map: np.ndarray
    grid: np.ndarray
    matchability: np.ndarray
    size1: tuple[int, int]
    size2: tuple[int, int]
    used: np.ndarray | None = None

    def __repr__(self) -> str:
        rows, columns = self.matchability.shape
        sizes = " to ".join(f"{width} x {height}" for width, height in (self.size2, self.size1))
        mean = self.mean_matchability
        return f"CorrespondenceMap({columns} x {rows} cells, {sizes}, matchability={mean:.2f})"

    @property
    def mean_matchability(self) -> float:
        """Mean matchability of the cells that are used."""
        count = self.matchability.size if self.used is None else max(self.used.sum(), 1)
        return float(self.matchability.sum() / count)

    @property
    def error_px(self) -> float:
        """Expected error of a good match of the map, pixels of the original images."""
        cells = self.matchability.size
        sides = [math.sqrt(w * h / cells) for w, h in (self.size1, self.size2)]
        return ERROR_CELLS * sum(sides) / 2

    @property
    def sample(self) -> Matches:
        """An even sample of the used cells, with any matchability, their confidence: evidence for
        or against a pose, not matches to estimate one from."""
        sample = self.thinned(max(1, -(-max(self.matchability.shape) // _SAMPLE)))
        used = np.ones(sample.matchability.shape, bool) if sample.used is None else sample.used
        return Matches(
            sample.map[used], sample.grid[used], sample.matchability[used], error_px=self.error_px
        )

    def thinned(self, step: int) -> CorrespondenceMap:
        """Every `step`-th cell of every `step`-th row."""
        cells = (slice(step // 2, None, step), slice(step // 2, None, step))
        return replace(
            self,
            map=self.map[cells],
            grid=self.grid[cells],
            matchability=self.matchability[cells],
            used=None if self.used is None else self.used[cells],
        )

    def masked(self, image1: Image, image2: Image) -> CorrespondenceMap:
        """The map between the two images with their masks."""
        if image1.mask is None and image2.mask is None:
            return self
        used = ~(image1.is_masked(self.map) | image2.is_masked(self.grid))
        return replace(self, matchability=self.matchability * used, used=used)
