"""The refiner: a matcher's matches, or more accurate ones of the pair, aligned on the images."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult
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


class MapMatches:
    """The matches selected from the map as they are (a `MatchSource`)."""

    def find(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap, matches: Matches
    ) -> Matches:
        return matches


class Refiner(Matcher):
    """A matcher with refinement of its matches. The dense map is the matcher's.

    sources: tried in this order until one gives enough matches. For a pair without a map the
    matcher's matches are aligned instead. max_matches: an even subsample of at most so many.
    """

    def __init__(
        self,
        matcher: Matcher,
        sources: Sequence[MatchSource] = (MapMatches(),),
        options: AlignmentOptions | None = None,
        max_matches: int = 2000,
    ) -> None:
        self.matcher = matcher
        self.name = matcher.name
        self.sources = tuple(sources)
        self.options = options or AlignmentOptions()
        self.max_matches = max_matches

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
        dense = result.correspondence_map
        sources: Iterable[Matches] = [result.matches]
        if dense is not None:
            sources = (s.find(image1, image2, dense, result.matches) for s in self.sources)
        for source in sources:
            for candidates, least in self._steps(image1, image2, source):
                matches = textured(candidates, image1, image2)
                if len(matches) >= least:
                    rows = spread(
                        matches.points2, matches.confidence, image2.size, self.max_matches
                    )
                    return MatchResult(matches.subset(rows), dense)
        return result

    def _steps(
        self, image1: Image, image2: Image, matches: Matches
    ) -> Iterator[tuple[Matches, int]]:
        """The matches aligned, then those that agree with their neighbours, aligned where that
        succeeds; and how many there must be with structure where they end."""
        options = self.options
        local = consistent(matches, options.neighbours)
        if len(local.index) < options.min_matches:
            return
        agreeing = matches.subset(local.index)
        if options.align:
            aligned = align(
                image1.pixels,
                image2.pixels,
                local,
                radius=options.patch_radius,
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
            yield moved, options.min_aligned
            # Patches of views far apart often differ too much. What is left of them is more
            # accurate, but too little to tell a pose from chance: both together have the error
            # that all of them had before.
            rows = np.searchsorted(local.index, aligned.index[good])
            points1, points2 = agreeing.points1.copy(), agreeing.points2.copy()
            points1[rows], points2[rows] = moved.points1, moved.points2
            agreeing = replace(agreeing, points1=points1, points2=points2)
        yield agreeing, options.min_matches
