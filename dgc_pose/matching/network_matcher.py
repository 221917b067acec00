"""The frozen network as a matcher: its dense map, and matches refined on the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.cameras.camera import TwoViews
from dgc_pose.errors import InputError
from dgc_pose.geometry.sampling import spread
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.align import MIN_MATCHES, refine
from dgc_pose.matching.cache import ImageCache
from dgc_pose.matching.correspondence_map import WEAK, CorrespondenceMap
from dgc_pose.matching.dense import dense_map, map_features
from dgc_pose.matching.features import (
    LONG_SIDE,
    encoded_views,
    feature_matches,
    guided_matches,
)
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.matching.selection import MatchingOptions, select_matches
from dgc_pose.matching.surroundings import surroundings
from dgc_pose.matching.view import View
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.runtime.engine import Engine
from dgc_pose.system.threads import in_threads, one_blas_thread

COARSE_CELLS = 60  # cells a side of the map of the coarse step
_FIRST_CELLS = 30  # and of one before: where it is weak, the next has been too; docs/experiments.md
COARSE_SIDE = 512  # most pixels of the images that its features are computed on
COARSE_CORNER_RADIUS = 12  # its cells are larger, so that the strongest corner of one is further
MIN_ALIGNED = 100  # fewer aligned matches are completed by those that agree with their neighbours


class NetworkMatcher(Matcher):
    """Matches by a frozen network; image 1 is its source, image 2 its target.

    The steps beside `match` are None where no features of the network are matched
    (`MatchingOptions.aligned`).

    cache: of features, textures and small copies; None to keep those of the last three images.
    Raises InputError if `finest` is a level that the network's mask is not made for.
    """

    engine: Engine

    def __init__(
        self,
        engine: Engine,
        options: MatchingOptions | None = None,
        cache: ImageCache | None = None,
    ) -> None:
        self.cache = cache or ImageCache()
        self.engine, self.name = engine, engine.config.name
        self.options = options or MatchingOptions()
        if engine.config.matchability == "network" and self.options.finest != INPUT_SIZE:
            raise InputError(
                f"the mask network of {self.name} works at {INPUT_SIZE} cells alone: finest must "
                f"be {INPUT_SIZE}, not {self.options.finest}"
            )

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the weights: different weights of one network have different ones."""
        return self.engine.fingerprint

    def coarse_features(self, image: Image) -> np.ndarray:
        """As `Matcher`; those of the whole image."""
        (features,) = map_features(self.engine, self.cache, (image, View.whole(image.size)))
        return np.concatenate(self.engine.coarsest(features))

    @one_blas_thread()
    def match(self, image1: Image, image2: Image) -> MatchResult:
        """As `Matcher`: by the map at `finest` cells. Matches of the features at native resolution
        are refined, or else those of the map; the map's are as they are where refinement leaves too
        few."""
        given = super().match(image1, image2)
        return self.refined(image1, image2, given) or given

    def coarse(self, image1: Image, image2: Image) -> MatchResult | None:
        """Match with the map of 60 cells and small images: enough for an easy pair. None too if it
        leaves too few matches, and for images that may be rotated or of different scales, which it
        does not search."""
        if not self._has_features or self.engine.config.matchability == "network":
            return None  # a mask network needs the finest map
        images, cache = (image1, image2), self.cache
        for cells in (_FIRST_CELLS, COARSE_CELLS) if self.engine.goes_on else (COARSE_CELLS,):
            dense = dense_map(self.engine, *images, cache, cells=cells, search=False)
            if dense.mean_matchability < WEAK:
                return None
        matches = feature_matches(self.engine, *images, dense, cache, COARSE_SIDE)
        parts = refine(*images, matches, self.options.max_matches, COARSE_CORNER_RADIUS)
        return self._chosen(*images, *parts, dense, COARSE_SIDE)

    def refined(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult | None:
        """Match at full resolution by the map of a result: refine the matches of the features, then
        those of the result, until one leaves enough."""
        dense, most = result.correspondence_map, self.options.max_matches
        assert dense is not None
        if self._has_features:
            matches = feature_matches(self.engine, image1, image2, dense, self.cache)
            parts = refine(image1, image2, matches, most)
            if refined := self._chosen(image1, image2, *parts, dense):
                return refined
        if self.options.aligned not in ("auto", "map"):
            return None
        parts = refine(image1, image2, result.matches, most)
        return self._chosen(image1, image2, *parts, dense)

    def guided(
        self, image1: Image, image2: Image, result: MatchResult, hypotheses: Sequence[TwoViews]
    ) -> MatchResult | None:
        """Add to a result matches of squeezed images and near the epipolar lines of the hypotheses;
        each part is refined by itself. All go together: the matches near the lines of a single pose
        would agree with it, right or wrong."""
        dense = result.correspondence_map
        if not self._has_features or result.aligned is None or dense is None:
            return None
        images, most = (image1, image2), self.options.max_matches
        matches = guided_matches(self.engine, *images, dense, self.cache, hypotheses)
        parts = in_threads(lambda part: refine(*images, part, most), matches)
        aligned = Matches.joined([result.aligned, *(part for part, _ in parts)])
        agreeing = Matches.joined([result.matches, *(part for _, part in parts)])
        return self._chosen(*images, aligned, agreeing, dense)

    @property
    def _has_features(self) -> bool:
        return self.options.aligned in ("auto", "features")

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        dense = dense_map(self.engine, image1, image2, self.cache, cells=self.options.finest)
        matches = select_matches(dense, self.options)
        return MatchResult(replace(matches, weights=self.fingerprint), dense)

    def _chosen(
        self,
        image1: Image,
        image2: Image,
        aligned: Matches,
        agreeing: Matches,
        dense: CorrespondenceMap,
        long_side: int = LONG_SIDE,
    ) -> MatchResult | None:
        """The aligned matches, or all that agree, where the images have structure, with what
        surrounds them; None if they are too few. long_side: as of `feature_matches`."""
        aligned = self._textured(image1, image2, aligned)
        if len(aligned) >= MIN_ALIGNED:
            aligned = self._surrounded(image1, image2, aligned, dense, long_side)
            return MatchResult(aligned, dense, aligned)
        # Patches of views far apart often differ too much. What is left of them is more accurate,
        # but too little to distinguish a pose from chance: both together have the error that all of
        # them had before.
        completed = self._textured(image1, image2, agreeing)
        if len(completed) < MIN_MATCHES:
            return None
        completed = self._surrounded(image1, image2, completed, dense, long_side)
        return MatchResult(completed, dense, aligned)

    def _surrounded(
        self,
        image1: Image,
        image2: Image,
        matches: Matches,
        dense: CorrespondenceMap,
        long_side: int,
    ) -> Matches:
        """The matches, evenly spread, with what surrounds them."""
        most, images = self.options.max_matches, (image1, image2)
        kept = spread(matches.points2, matches.confidence, image2.size, most)
        matches = matches.subset(kept)
        if not self._has_features:
            return matches
        views, scale = encoded_views(self.engine, *images, dense, self.cache, long_side)
        share = surroundings(images, views, self._textures(*images), matches, scale)
        return replace(matches, surroundings=share)
