"""The contract of all matchers: two images in, matches out, with the dense map if there is one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.two_views import TwoViews
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.texture import textured
from dgc_pose.runtime.engine import Engine

# Error of a good match of a map along one axis, in cells of its grid; see docs/experiments.md.
ERROR_CELLS = 0.5
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
        cycle: Cycle error (H, W) float32, pixels of image 2: the distance between the cell and its
            point in image 1 mapped back by the reverse map; None if that map was not computed.
    """

    map: np.ndarray
    grid: np.ndarray
    matchability: np.ndarray
    size1: tuple[int, int]
    size2: tuple[int, int]
    cycle: np.ndarray | None = None

    def __repr__(self) -> str:
        rows, columns = self.matchability.shape
        sizes = " to ".join(f"{width} x {height}" for width, height in (self.size2, self.size1))
        mean = float(self.matchability.mean())
        return f"CorrespondenceMap({columns} x {rows} cells, {sizes}, matchability={mean:.2f})"

    @property
    def cell_size(self) -> float:
        """Side of a cell in pixels of the original images: mean over both images and both axes."""
        cells = self.matchability.size
        areas = [w * h / cells for w, h in (self.size1, self.size2)]
        return sum(math.sqrt(area) for area in areas) / 2

    def thinned(self, step: int) -> CorrespondenceMap:
        """Every `step`-th cell of every `step`-th row."""
        cells = (slice(step // 2, None, step), slice(step // 2, None, step))
        return replace(
            self,
            map=self.map[cells],
            grid=self.grid[cells],
            matchability=self.matchability[cells],
            cycle=None if self.cycle is None else self.cycle[cells],
        )


@dataclass(frozen=True, eq=False)
class MatchResult:
    """The matches of two images.

    Attributes:
        matches: Matches that a pose is estimated from, pixels of the images matched.
        correspondence_map: The dense map; None for a matcher of key points.
        aligned: Those of refined matches whose patches are aligned; None without refinement.
    """

    matches: Matches
    correspondence_map: CorrespondenceMap | None
    aligned: Matches | None = None

    @property
    def map_matches(self) -> Matches | None:
        """An even sample of the map, whatever its matchability, which is their confidence; None
        without a map. Evidence for or against a pose, not matches to estimate one from."""
        if self.correspondence_map is None:
            return None
        side = max(self.correspondence_map.matchability.shape)
        sample = self.correspondence_map.thinned(max(1, -(-side // _SAMPLE)))
        return Matches(
            sample.map.reshape(-1, 2),
            sample.grid.reshape(-1, 2),
            sample.matchability.ravel(),
            error_px=ERROR_CELLS * self.correspondence_map.cell_size,
        )


class Matcher:
    """Anything that matches two images: the network, SIFT, optical flow, files, or a refiner."""

    engine: Engine | None = None  # of a network of ours, whose features may refine the matches
    name: str  # in results and tables

    @property
    def fingerprint(self) -> str | None:
        """16 hexadecimal digits that identify the weights; None for a matcher without weights."""
        return None

    def match(self, image1: Image, image2: Image) -> MatchResult:
        """Matches in pixels of the images, both points where the images have structure, and the
        dense map if the matcher makes one."""
        return self.match_batch([(image1, image2)])[0]

    def match_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[MatchResult]:
        """As `match` for each pair; a network decodes the pairs together."""
        return [
            replace(result, matches=textured(result.matches, *pair))
            for result, pair in zip(self._match_batch(pairs), pairs, strict=True)
        ]

    def coarser(self) -> Matcher | None:
        """The matcher of the coarsest map, of upright images of one scale, for a quick pass; None
        if there is none."""
        return None

    def match_quickly(self, image1: Image, image2: Image) -> MatchResult | None:
        """As `match`, with less of everything: enough for a pair that is easy. None from a matcher
        that has no quick pass, and where it shows that the pair is not easy."""
        return None

    def match_finely(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult:
        """The matches that the map of a quick pass leads to at full resolution; `result` itself
        from a matcher that has no quick pass."""
        return result

    def match_squeezed(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult:
        """The matches of a result of `match`, and with them those of images that are made narrower
        or lower; `result` itself from a matcher that does not search again."""
        return result

    def match_near(
        self, image1: Image, image2: Image, result: MatchResult, hypotheses: Sequence[TwoViews]
    ) -> MatchResult:
        """The matches of a result of `match`, and with them those near the epipolar lines of each
        hypothesis of the pose; `result` itself from a matcher that does not search again."""
        return result

    def coarse_features(self, image: Image) -> np.ndarray:
        """A network's coarsest features of an image (cells, C) float32, of unit length over C.

        Raises InputError for a matcher that has none.
        """
        raise InputError(f"--pairs auto needs the features of a network, and {self.name} has none")

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """As `match`, also where an image has no structure: what a subclass defines."""
        raise NotImplementedError

    def _match_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[MatchResult]:
        """As `_match` for each pair: what a subclass that matches them together defines instead."""
        return [self._match(*pair) for pair in pairs]
