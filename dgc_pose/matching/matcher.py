"""The contract of all matchers: two images in, matches out, with the dense map if there is one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dgc_pose.image import Image
from dgc_pose.matches import Matches


@dataclass(frozen=True, eq=False)
class CorrespondenceMap:
    """A dense map over image 2's grid. All points are in pixels of the original images."""

    map: np.ndarray  # (H, W, 2) float32, for each cell of image 2 its x and y in image 1; no NaN
    grid: np.ndarray  # (H, W, 2) float32, the cells' x and y in image 2
    matchability: np.ndarray  # (H, W) float32 in [0, 1]; 1 everywhere for a net without a mask
    size1: tuple[int, int]  # (width, height) of image 1
    size2: tuple[int, int]  # (width, height) of image 2
    # (H, W) float32, pixels of image 2: cycle error, the distance between the cell and its point in
    # image 1 mapped back by the reverse map; None if that map was not computed
    cycle: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class MatchResult:
    """What a matcher found in two images."""

    matches: Matches  # those that a pose is estimated from, pixels of the images matched
    correspondence_map: CorrespondenceMap | None  # None for a matcher of key points


class Matcher(ABC):
    """Anything that matches two images: the network, SIFT, optical flow, files, or a refiner."""

    @property
    @abstractmethod
    def name(self) -> str:
        """The name in results and tables."""

    @property
    def fingerprint(self) -> str | None:
        """16 hexadecimal digits that identify the weights; None for a matcher without weights."""
        return None

    @abstractmethod
    def match(self, image1: Image, image2: Image) -> MatchResult:
        """Matches in pixels of the images given, and the dense map if the matcher makes one."""

    def match_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[MatchResult]:
        """As `match` for each pair. A network overrides this to decode the pairs together."""
        return [self.match(*pair) for pair in pairs]
