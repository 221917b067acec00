"""The refiner: more accurate matches of a pair than its dense map has, aligned on the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from dgc_pose.cameras.camera import TwoViews
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import ImageCache
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult, PairSearch
from dgc_pose.matching.selection import WEAK
from dgc_pose.refinement.align import CORNER_RADIUS, MIN_ZNCC, align, spread
from dgc_pose.refinement.consistency import consistent
from dgc_pose.refinement.features import FeatureMatches
from dgc_pose.system.options import check_options, option
from dgc_pose.system.threads import in_threads

# Error of an aligned match along one axis, pixels of the originals; see docs/experiments.md.
ALIGNED_ERROR_PX = 0.5
QUICK_SIDE = 512  # most pixels of the images that a quick pass computes features on
QUICK_CORNER_RADIUS = 12  # its cells are larger, so that the strongest corner of one is further
NEIGHBOURS = 12  # nearest matches whose affinity a match must fit
MIN_MATCHES = 50  # a source that leaves fewer is passed over
MIN_ALIGNED = 100  # fewer aligned matches are completed by the consistent ones

# The source of the matches to align: those selected from the map, or matches of the encoder's
# features at native resolution. "auto": the features', and the map's if those are too few. "none":
# no refinement.
SourceName = Literal["none", "auto", "map", "features"]


@dataclass(frozen=True)
class RefinementOptions:
    """How `load_matcher` refines a network's matches. Raises InputError for an unknown source."""

    source: SourceName = option(
        "auto",
        "Matches aligned on the originals: none; map; features, of the encoder at native "
        "resolution; auto: these, and the map's if they are few.",
        metavar="SOURCE",
        flag="--refine",
        section="matching",
    )

    def __post_init__(self) -> None:
        check_options(self)


class Refiner(Matcher):
    """A matcher of a dense map with more accurate matches. The dense map is the matcher's.

    source: of the matches that are aligned, see `RefinementOptions`. max_matches: an even subsample
    of at most so many. cache: of the features; None to keep those of the last three images.

    Raises InputError if the source is features, and the matcher has no network.
    """

    def __init__(
        self,
        matcher: Matcher,
        source: SourceName = "map",
        max_matches: int = 2000,
        cache: ImageCache | None = None,
    ) -> None:
        self.matcher, self.name, self.engine = matcher, matcher.name, matcher.engine
        self.source, self.max_matches = source, max_matches
        self.features: FeatureMatches | None = None
        self.quick_features: FeatureMatches | None = None
        if source in ("auto", "features"):
            if matcher.engine is None:
                raise InputError(f"{matcher.name}: refine={source} needs the features of a network")
            self.features = FeatureMatches(matcher.engine, cache=cache)
            self.cache = self.features.cache
            self.quick_features = FeatureMatches(matcher.engine, QUICK_SIDE, self.features.cache)

    @property
    def fingerprint(self) -> str | None:
        return self.matcher.fingerprint

    def forget(self, image: Image) -> None:
        self.matcher.forget(image)
        super().forget(image)

    def coarse_features(self, image: Image) -> np.ndarray:
        return self.matcher.coarse_features(image)

    def search(self, image1: Image, image2: Image) -> RefinedSearch:
        return RefinedSearch(self, image1, image2)

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        return self.matcher._match(image1, image2)


class RefinedSearch(PairSearch):
    """The steps of a refiner for one pair.

    `quick` has the coarsest map and the features of small images, `fine` the features at full
    resolution by the same map, `whole` those by the finest map. `more` adds to the matches that are
    there.
    """

    matcher: Refiner

    def quick(self) -> MatchResult | None:
        """As `PairSearch`; None too if the quick pass leaves too few matches, and if the images may
        be rotated or of different scales, which it does not search."""
        features = self.matcher.quick_features
        if features is None:
            return None
        dense = self.matcher.matcher.coarse_map(self.image1, self.image2)
        if dense is None or dense.mean_matchability < WEAK:
            return None
        matches = features.at_scale(self.image1, self.image2, dense)
        return self._keep(self._final(*self._aligned(matches, QUICK_CORNER_RADIUS), dense))

    def fine(self) -> MatchResult | None:
        return None if self.result is None else self._keep(self._refined(self.result))

    def whole(self) -> MatchResult:
        """As `PairSearch`; the matches of the map as they are where refinement leaves too few."""
        self.result = self._whole
        return self.result

    def more(self, hypotheses: Sequence[TwoViews]) -> MatchResult | None:
        """As `PairSearch`, those of squeezed images and near epipolar lines; each part is refined
        by itself. All go together: the matches near the lines of a single pose would agree with it,
        right or wrong."""
        features, result = self.matcher.features, self.result
        if features is None or result is None or result.aligned is None:
            return None
        dense = result.correspondence_map
        if dense is None:
            return None
        matches = features.more(self.image1, self.image2, dense, hypotheses)
        parts = in_threads(self._aligned, matches)
        aligned = Matches.joined([result.aligned, *(part for part, _ in parts)])
        agreeing = Matches.joined([result.matches, *(part for _, part in parts)])
        return self._keep(self._final(aligned, agreeing, dense))

    @cached_property
    def _whole(self) -> MatchResult:
        return self._refined(self.unrefined) or self.unrefined

    def _keep(self, result: MatchResult | None) -> MatchResult | None:
        self.result = result or self.result
        return result

    def _refined(self, result: MatchResult) -> MatchResult | None:
        """Refine the matches of the features, then those of the map, until one leaves enough."""
        features, dense = self.matcher.features, result.correspondence_map
        if features is not None and dense is not None:
            matches = features.at_scale(self.image1, self.image2, dense)
            if refined := self._final(*self._aligned(matches), dense):
                return refined
        if self.matcher.source not in ("auto", "map"):
            return None
        return self._final(*self._aligned(result.matches), dense)

    def _aligned(
        self, matches: Matches, corner_radius: int = CORNER_RADIUS
    ) -> tuple[Matches, Matches]:
        """The matches that can be aligned, and all that agree with their neighbours, aligned where
        that succeeds; none if too few agree."""
        local = consistent(matches, NEIGHBOURS)
        if len(local.index) < MIN_MATCHES:
            none = matches.subset(local.index[:0])
            return none, none
        agreeing = matches.subset(local.index)
        aligned = align(
            self.image1.pixels,
            self.image2.pixels,
            local,
            error_px=matches.error_px,
            max_matches=self.matcher.max_matches,
            corner_radius=corner_radius,
        )
        good = aligned.converged & (aligned.zncc >= MIN_ZNCC)
        moved = replace(
            matches,
            points1=aligned.points1[good],
            points2=aligned.points2[good],
            confidence=aligned.zncc[good].clip(0, 1),
            error_px=ALIGNED_ERROR_PX * aligned.pixel,
        )
        rows = np.searchsorted(local.index, aligned.index[good])
        points1, points2 = agreeing.points1.copy(), agreeing.points2.copy()
        points1[rows], points2[rows] = moved.points1, moved.points2
        return moved, replace(agreeing, points1=points1, points2=points2)

    def _final(
        self, aligned: Matches, agreeing: Matches, dense: CorrespondenceMap | None
    ) -> MatchResult | None:
        """The aligned matches, or all that agree, where the images have structure; None if they are
        too few."""
        aligned = self._textured(aligned)
        if len(aligned) >= MIN_ALIGNED:
            aligned = self._spread(aligned)
            return MatchResult(aligned, dense, aligned)
        # Patches of views far apart often differ too much. What is left of them is more accurate,
        # but too little to distinguish a pose from chance: both together have the error that all of
        # them had before.
        completed = self._textured(agreeing)
        if len(completed) < MIN_MATCHES:
            return None
        return MatchResult(self._spread(completed), dense, aligned)

    def _spread(self, matches: Matches) -> Matches:
        """An even subsample of at most `max_matches`."""
        most, size = self.matcher.max_matches, self.image2.size
        return matches.subset(spread(matches.points2, matches.confidence, size, most))
