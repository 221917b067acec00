"""The contract of all matchers: two images in, matches out, with the dense map if there is one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, SupportsIndex

import numpy as np

from dgc_pose.cameras.camera import TwoViews
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import ImageCache, LastImages
from dgc_pose.matching.texture import Texture, texture, textured
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
        used: (H, W) bool, False where either point lies on a masked pixel, and matchability is 0;
            None if no image has a mask.
    """

    map: np.ndarray
    grid: np.ndarray
    matchability: np.ndarray
    size1: tuple[int, int]
    size2: tuple[int, int]
    cycle: np.ndarray | None = None
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
            used=None if self.used is None else self.used[cells],
        )

    def masked(self, image1: Image, image2: Image) -> CorrespondenceMap:
        """The map between the two images with their masks."""
        if image1.mask is None and image2.mask is None:
            return self
        used = ~(image1.is_masked(self.map) | image2.is_masked(self.grid))
        return replace(self, matchability=self.matchability * used, used=used)


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
        """An even sample of the map's used cells, with any matchability, their confidence; None
        without a map. Evidence for or against a pose, not matches to estimate one from."""
        if self.correspondence_map is None:
            return None
        side = max(self.correspondence_map.matchability.shape)
        sample = self.correspondence_map.thinned(max(1, -(-side // _SAMPLE)))
        used = np.ones(sample.matchability.shape, bool) if sample.used is None else sample.used
        return Matches(
            sample.map[used],
            sample.grid[used],
            sample.matchability[used],
            error_px=ERROR_CELLS * self.correspondence_map.cell_size,
        )


class Matcher:
    """Anything that matches two images: the network, SIFT, optical flow, or files."""

    engine: Engine | None = None  # of a network of ours, whose features may refine the matches
    cache: ImageCache | None = None  # of what is computed of an image
    name: str  # in results and tables
    loaded_anew: Callable[[], Matcher] | None = None  # makes a copy; None: it is as of any object

    def __reduce_ex__(self, protocol: SupportsIndex) -> str | tuple[Any, ...]:
        """As pickle and copy take it."""
        return (self.loaded_anew, ()) if self.loaded_anew else super().__reduce_ex__(protocol)

    @property
    def fingerprint(self) -> str | None:
        """16 hexadecimal digits that identify the weights; None for a matcher without weights."""
        return None

    def search(self, image1: Image, image2: Image) -> PairSearch:
        """The search for matches of two images, step by step; nothing is computed yet."""
        return PairSearch(self, image1, image2)

    def match(self, image1: Image, image2: Image) -> MatchResult:
        """Matches in pixels of the images, both points where the images have structure, and the
        dense map if the matcher makes one: the step `whole` of `search`."""
        return self.search(image1, image2).whole()

    def forget(self, image: Image) -> None:
        """Drop all that is kept of an image."""
        if self.cache is not None:
            self.cache.drop(lambda key: key[0] is image)

    def coarse_features(self, image: Image) -> np.ndarray:
        """A network's coarsest features of an image (cells, C) float32, of unit length over C.

        Raises InputError for a matcher that has none.
        """
        raise InputError(f"{self.name} has no features of a network, which choose pairs")

    def coarse_map(self, image1: Image, image2: Image) -> CorrespondenceMap | None:
        """A dense map for a quick pass, of upright images of one scale; None for a matcher that has
        none."""
        return None

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """As `match`, also where an image has no structure: what a subclass defines."""
        raise NotImplementedError


class PairSearch:
    """The matches of two images, by one step after another.

    It keeps what its steps compute of the pair. Each step but `whole` returns None if it has no
    other matches than those that are there; a plain matcher has `whole` alone. `result` has the
    matches of the last step that had any.
    """

    def __init__(self, matcher: Matcher, image1: Image, image2: Image) -> None:
        self.matcher = matcher
        self.image1, self.image2 = image1, image2
        self.result: MatchResult | None = None

    @property
    def last(self) -> MatchResult:
        """The matches of the last step that had any. Raises ValueError before it."""
        if self.result is None:
            raise ValueError("no step of the search has been done")
        return self.result

    def quick(self) -> MatchResult | None:
        """Match with less of everything: enough for an easy pair."""
        return None

    def fine(self) -> MatchResult | None:
        """Match at full resolution by the map of the step before."""
        return None

    def whole(self) -> MatchResult:
        """Match with all that the matcher has."""
        self.result = self.unrefined
        return self.result

    def more(self, hypotheses: Sequence[TwoViews]) -> MatchResult | None:
        """Add matches of a pose in doubt, whose hypotheses are known."""
        return None

    @cached_property
    def unrefined(self) -> MatchResult:
        """The matches of the whole as the matcher makes them, before any refinement."""
        result = self.matcher._match(self.image1, self.image2)
        return replace(result, matches=self._textured(result.matches))

    def _textured(self, matches: Matches) -> Matches:
        """The matches whose points have structure around them in both images, and no mask."""
        masked = self.image1.is_masked(matches.points1) | self.image2.is_masked(matches.points2)
        return textured(matches.subset(~masked), *self._textures)

    @cached_property
    def _textures(self) -> tuple[Texture, Texture]:
        cache = self.matcher.cache or LastImages()
        made = [((i, "texture"), partial(texture, i)) for i in (self.image1, self.image2)]
        first, second = cache.get_all(made, in_turn=False)
        return first, second
