"""The frozen network as a matcher: its dense map, and matches refined on the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from dgc_pose.cameras.camera import TwoViews
from dgc_pose.geometry.sampling import spread
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.align import CORNER_RADIUS, MIN_MATCHES, refine
from dgc_pose.matching.correspondence_map import (
    WEAK,
    CorrespondenceMap,
    MatchingOptions,
    select_matches,
)
from dgc_pose.matching.dense import dense_map, map_features
from dgc_pose.matching.features import (
    LONG_SIDE,
    CommonViews,
    common_views,
    feature_matches,
)
from dgc_pose.matching.lightglue import LightGlueMatcher, as_second, is_available
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.matching.texture import context_ratio
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import Engine
from dgc_pose.system.parallel import in_threads, one_blas_thread

COARSE_CELLS = 60  # cells a side of the coarse step's map
_FIRST_CELLS = 30  # of a first map: where it was weak, so was the next; see docs/experiments.md
COARSE_SIDE = 512  # longest side of the images that its features are computed on, pixels
COARSE_CORNER_RADIUS = 12  # pixels: its cells are larger, so their strongest corners are further
MIN_ALIGNED = 100  # with fewer aligned matches, all that agree with their neighbours are used


class NetworkMatcher(Matcher):
    """Matches by a frozen network; image 1 is its source, image 2 its target. All steps except
    `match` return None if refinement is off (`MatchingOptions.aligned`)."""

    engine: Engine

    def __init__(
        self,
        engine: Engine,
        options: MatchingOptions | None = None,
        cache: ImageCache | None = None,
    ) -> None:
        self.cache = cache or ImageCache(None)
        self.engine = engine
        self.name = engine.config.name
        self.options = options or MatchingOptions()

    @property
    def fingerprint(self) -> str:
        return self.engine.fingerprint

    @cached_property
    def second_matcher(self) -> Matcher | None:
        if self.options.aligned == "none" or not is_available():
            return None
        with as_second():
            return LightGlueMatcher(self.cache)

    def coarse_features(self, image: Image) -> np.ndarray:
        (features,) = map_features(self.engine, self.cache, View.whole(image))
        return np.concatenate(self.engine.coarsest(features))

    @one_blas_thread()
    def match(self, image1: Image, image2: Image) -> MatchResult:
        """As `Matcher.match`. Refines the matches of the features at native resolution, or else the
        matches of the map. If too few remain, returns the map's matches unrefined."""
        given = super().match(image1, image2)
        return self.refined(image1, image2, given) or given

    def coarse(self, image1: Image, image2: Image) -> MatchResult | None:
        """Match with a map of 60 cells and small images: enough for an easy pair. Returns None also
        if too few matches remain, or if the map is weak: the images may be rotated or differ in
        scale, and this step does not search for either."""
        if self.options.aligned == "none" or self.engine.config.matchability == "network":
            return None  # a mask network needs the finest map
        for cells in (_FIRST_CELLS, COARSE_CELLS) if self.engine.can_resume else (COARSE_CELLS,):
            dense = dense_map(self.engine, image1, image2, self.cache, cells=cells, search=False)
            if dense.mean_matchability < WEAK:
                return None
        return self._refined(image1, image2, dense, side=COARSE_SIDE)

    def refined(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult | None:
        """Match at full resolution, guided by the map of a result: refine the matches of the
        features, or, if too few remain, the matches of the result."""
        dense = result.correspondence_map
        if self.options.aligned == "none" or dense is None:
            return None
        return self._refined(image1, image2, dense, instead=result.matches)

    def guided(
        self, image1: Image, image2: Image, result: MatchResult, hypotheses: Sequence[TwoViews]
    ) -> MatchResult | None:
        """Add to a result matches of squeezed images and matches near the epipolar lines of the
        hypotheses; each part is refined separately. All are used together, because matches near the
        lines of a single pose would agree with it, right or wrong."""
        dense = result.correspondence_map
        if result.aligned is None or dense is None:
            return None
        first = result.aligned, result.matches
        return self._refined(image1, image2, dense, first=[first], hypotheses=hypotheses)

    def second(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult | None:
        """Add to a result the matches of `LightGlueMatcher`, refined as its own are. Returns the
        result itself if none agree, None if the distribution is not installed; raises WeightsError
        if that is damaged."""
        dense = result.correspondence_map
        if self.second_matcher is None or dense is None:
            return None
        found = self.second_matcher.match(image1, image2).matches
        found = replace(found, key_points=False, weights=self.fingerprint)
        part = refine(image1, image2, found, self.options.max_matches)
        aligned, agreeing = self._joined(image1, image2, [part])
        if not len(agreeing):
            return result
        if result.aligned is not None:
            aligned = agreeing = Matches.joined([result.matches, aligned])
        views = common_views(self.engine, self.cache, image1, image2, dense)
        return self._selected(views, dense, aligned, agreeing) or result

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        dense = dense_map(self.engine, image1, image2, self.cache)
        matches = select_matches(dense, self.options)
        return MatchResult(replace(matches, weights=self.fingerprint), dense)

    def _refined(
        self,
        image1: Image,
        image2: Image,
        dense: CorrespondenceMap,
        *,
        side: int = LONG_SIDE,
        first: Sequence[tuple[Matches, Matches]] = (),
        hypotheses: Sequence[TwoViews] | None = None,
        instead: Matches | None = None,
    ) -> MatchResult | None:
        """The matches of `feature_matches`, refined on the images; None if too few remain. instead:
        matches to refine if too few of these remain. first: pairs of aligned and agreeing matches
        (see `refine`) to add."""
        views = common_views(self.engine, self.cache, image1, image2, dense, side)
        found = feature_matches(self.engine, self.cache, dense, views, hypotheses)
        most = self.options.max_matches
        radius = COARSE_CORNER_RADIUS if side == COARSE_SIDE else CORNER_RADIUS

        def aligned_and_agreeing(part: Matches) -> tuple[Matches, Matches]:
            return refine(image1, image2, part, most, radius)

        parts = [*first, *in_threads(aligned_and_agreeing, found)]
        aligned, agreeing = self._joined(image1, image2, parts)
        too_few = len(aligned) < MIN_ALIGNED and len(agreeing) < MIN_MATCHES
        if instead is not None and too_few:
            aligned, agreeing = self._joined(image1, image2, [aligned_and_agreeing(instead)])
        return self._selected(views, dense, aligned, agreeing)

    def _joined(
        self, image1: Image, image2: Image, parts: Sequence[tuple[Matches, Matches]]
    ) -> tuple[Matches, Matches]:
        """The aligned and the agreeing matches of all parts, where both images have structure."""
        aligned, agreeing = (
            self._textured(image1, image2, Matches.joined(some) if len(some) > 1 else some[0])
            for some in zip(*parts, strict=True)
        )
        return aligned, agreeing

    def _selected(
        self, views: CommonViews, dense: CorrespondenceMap, aligned: Matches, agreeing: Matches
    ) -> MatchResult | None:
        """The result of aligned and agreeing matches (see `refine`), evenly spread; None if too few
        agree."""
        # Patches of views far apart often differ too much. Few aligned matches are more accurate,
        # but cannot distinguish a pose from chance. All agreeing matches are then used, with the
        # error that they had before alignment.
        enough = len(aligned) >= MIN_ALIGNED
        chosen = aligned if enough else agreeing
        if len(chosen) < MIN_MATCHES:
            return None
        both = (views.first, views.second)
        image1, image2 = (view.image for view, _ in both)
        most = self.options.max_matches
        chosen = chosen.subset(spread(chosen.points2, chosen.confidence, image2.size, most))
        encoded = [views.encoded[shown] for shown in both]
        share = context_ratio(encoded, self.textures(image1, image2), chosen, views.scale)
        chosen = replace(chosen, context_ratio=share)
        return MatchResult(chosen, dense, chosen if enough else aligned)
