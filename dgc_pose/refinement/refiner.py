"""The refiner: a matcher's matches, or more accurate ones of the pair, aligned on the images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from dgc_pose.cameras.two_views import TwoViews
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult
from dgc_pose.matching.selection import WEAK
from dgc_pose.matching.texture import textured
from dgc_pose.refinement.align import align, spread
from dgc_pose.refinement.consistency import consistent
from dgc_pose.refinement.options import AlignmentOptions

# Error of an aligned match along one axis, pixels of the originals; see docs/experiments.md.
ALIGNED_ERROR_PX = 0.5


class MatchSource(Protocol):
    """Makes the matches that a refiner aligns."""

    def find(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap, matches: Matches
    ) -> Matches:
        """Matches in pixels of the images, of a matcher's map and of the matches selected from it;
        `error_px` is the error of this source."""

    def find_squeezed(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap
    ) -> list[Matches]:
        """As `find`, each with one of the images made narrower or lower; none from a source that
        does not search."""
        return []

    def find_near(
        self,
        image1: Image,
        image2: Image,
        correspondence_map: CorrespondenceMap,
        hypotheses: Sequence[TwoViews],
    ) -> list[Matches]:
        """As `find`, of each hypothesis of the pose the matches near its epipolar lines; none from
        a source that does not search."""
        return []


class MapMatches(MatchSource):
    """The matches selected from the map as they are: the map has a single point for each cell."""

    def find(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap, matches: Matches
    ) -> Matches:
        return matches


class Refiner(Matcher):
    """A matcher with refinement of its matches. The dense map is the matcher's.

    sources: tried in this order until one gives enough matches. For a pair without a map the
    matcher's matches are aligned instead. max_matches: an even subsample of at most so many. quick:
    what makes the quick pass.
    """

    def __init__(
        self,
        matcher: Matcher,
        sources: Sequence[MatchSource] = (MapMatches(),),
        options: AlignmentOptions | None = None,
        max_matches: int = 2000,
        quick: Refiner | None = None,
    ) -> None:
        self.matcher = matcher
        self.name = matcher.name
        self.sources = tuple(sources)
        self.options = options or AlignmentOptions()
        self.max_matches = max_matches
        self.quick = quick

    @property
    def fingerprint(self) -> str | None:
        return self.matcher.fingerprint

    def coarse_features(self, image: Image) -> np.ndarray:
        return self.matcher.coarse_features(image)

    def _match_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[MatchResult]:
        results = self.matcher.match_batch(pairs)
        return [self.refine(*pair, result) for pair, result in zip(pairs, results, strict=True)]

    def refine(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult:
        """A matcher's result with its matches refined; `error_px` is that of the last step done.

        A step that leaves too few matches is undone. If all do, `result` itself is returned.
        """
        return self._refined(image1, image2, result) or result

    def match_quickly(self, image1: Image, image2: Image) -> MatchResult | None:
        """As `Matcher`; None too if the quick pass leaves too few matches, and if the images may
        be rotated or of different scales, which it does not search."""
        if self.quick is None:
            return None
        result = self.quick.matcher.match(image1, image2)
        dense = result.correspondence_map
        if dense is None or dense.matchability.mean() < WEAK:
            return None
        return self.quick._refined(image1, image2, result)

    def match_finely(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult:
        """As `Matcher`, by all sources."""
        return self.refine(image1, image2, result)

    def _refined(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult | None:
        """As `refine`; None if every step leaves too few matches."""
        dense = result.correspondence_map
        sources: Iterable[Matches] = [result.matches]
        if dense is not None:
            sources = (s.find(image1, image2, dense, result.matches) for s in self.sources)
        for source in sources:
            steps = self._steps(image1, image2, source)
            refined = self._last_step(image1, image2, *steps, dense)
            if refined is not None:
                return refined
        return None

    def match_squeezed(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult:
        """As `Matcher`, by the first source."""
        return self._searched(image1, image2, result, self.sources[0].find_squeezed)

    def match_near(
        self, image1: Image, image2: Image, result: MatchResult, hypotheses: Sequence[TwoViews]
    ) -> MatchResult:
        """As `Matcher`, by the first source. The matches of all hypotheses go together: those near
        the lines of a single pose would agree with it, right or wrong."""
        near = partial(self.sources[0].find_near, hypotheses=hypotheses)
        return self._searched(image1, image2, result, near)

    def _searched(
        self,
        image1: Image,
        image2: Image,
        result: MatchResult,
        search: Callable[[Image, Image, CorrespondenceMap], list[Matches]],
    ) -> MatchResult:
        """A result with the matches that a search has in parts, each refined by itself; `result`
        itself without a map, without refinement, and if the search has none."""
        dense, aligned = result.correspondence_map, result.aligned
        if dense is None or aligned is None:
            return result
        parts = search(image1, image2, dense)
        if not parts:
            return result
        steps = [self._steps(image1, image2, matches) for matches in parts]
        moved = Matches.joined([aligned, *(part for part, _ in steps)])
        agreeing = Matches.joined([result.matches, *(part for _, part in steps)])
        return self._last_step(image1, image2, moved, agreeing, dense) or result

    def _last_step(
        self,
        image1: Image,
        image2: Image,
        moved: Matches,
        agreeing: Matches,
        dense: CorrespondenceMap | None,
    ) -> MatchResult | None:
        """The aligned matches, or all that agree, where the images have structure; None if they are
        too few."""
        aligned = textured(moved, image1, image2)
        if len(aligned) >= self.options.min_aligned:
            aligned = self._spread(aligned, image2)
            return MatchResult(aligned, dense, aligned)
        # Patches of views far apart often differ too much. What is left of them is more accurate,
        # but too little to tell a pose from chance: both together have the error that all of them
        # had before.
        completed = textured(agreeing, image1, image2)
        if len(completed) < self.options.min_matches:
            return None
        return MatchResult(self._spread(completed, image2), dense, aligned)

    def _spread(self, matches: Matches, image2: Image) -> Matches:
        """An even subsample of at most `max_matches`."""
        rows = spread(matches.points2, matches.confidence, image2.size, self.max_matches)
        return matches.subset(rows)

    def _steps(self, image1: Image, image2: Image, matches: Matches) -> tuple[Matches, Matches]:
        """The matches that can be aligned, and all that agree with their neighbours, aligned where
        that succeeds; none if too few agree."""
        options = self.options
        local = consistent(matches, options.neighbours)
        if len(local.index) < options.min_matches:
            none = matches.subset(local.index[:0])
            return none, none
        agreeing = matches.subset(local.index)
        if not options.align:
            return agreeing.subset(local.index[:0]), agreeing
        aligned = align(
            image1.pixels,
            image2.pixels,
            local,
            radius=options.patch_radius,
            corner_radius=options.corner_radius,
            error_px=matches.error_px,
            min_zncc=options.min_zncc,
            max_matches=self.max_matches,
        )
        good = aligned.converged & (aligned.zncc >= options.min_zncc)
        moved = Matches(
            aligned.points1[good],
            aligned.points2[good],
            aligned.zncc[good].clip(0, 1),
            ALIGNED_ERROR_PX * aligned.pixel,
            matches.key_points,
        )
        rows = np.searchsorted(local.index, aligned.index[good])
        points1, points2 = agreeing.points1.copy(), agreeing.points2.copy()
        points1[rows], points2[rows] = moved.points1, moved.points2
        return moved, replace(agreeing, points1=points1, points2=points2)
