"""The refiner: any matcher's matches, or better ones found from its map, aligned on the images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.matching.texture import textured
from dgc_pose.refinement.align import align, spread
from dgc_pose.refinement.consistency import consistent
from dgc_pose.refinement.options import AlignmentOptions
from dgc_pose.refinement.source import MapMatches, MatchSource

# Error of an aligned match along one axis, pixels of the originals; see docs/experiments.md.
ALIGNED_ERROR_PX = 0.5


class Refiner(Matcher):
    """A matcher with refinement of its matches. The dense map stays the matcher's own.

    sources: tried in this order until one gives enough matches. For a pair without a map the
    matcher's own matches are aligned instead. max_matches: an even subsample of at most so many.
    """

    def __init__(
        self,
        matcher: Matcher,
        sources: Sequence[MatchSource] = (MapMatches(),),
        options: AlignmentOptions | None = None,
        max_matches: int = 2000,
    ) -> None:
        self.matcher = matcher
        self.sources = tuple(sources)
        self.options = options or AlignmentOptions()
        self.max_matches = max_matches

    @property
    def name(self) -> str:
        return self.matcher.name

    @property
    def fingerprint(self) -> str | None:
        return self.matcher.fingerprint

    def coarse_features(self, image: Image) -> np.ndarray:
        return self.matcher.coarse_features(image)

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        return self.refine(image1, image2, self.matcher.match(image1, image2))

    def _match_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[MatchResult]:
        results = self.matcher.match_batch(pairs)
        return [self.refine(*pair, given) for pair, given in zip(pairs, results, strict=True)]

    def refine(self, image1: Image, image2: Image, given: MatchResult) -> MatchResult:
        """A matcher's result with its matches refined; `error_px` is that of the last step done.

        A step that leaves fewer than `min_matches` is undone. If every source gives too few, the
        result is returned as given.
        """
        for source in self._sources(image1, image2, given):
            for candidates, least in self._steps(image1, image2, source):
                matches = textured(candidates, image1, image2)
                if len(matches) >= least:
                    kept = spread(
                        matches.points2, matches.confidence, image2.size, self.max_matches
                    )
                    return MatchResult(matches.subset(kept), given.correspondence_map)
        return given

    def _sources(self, image1: Image, image2: Image, given: MatchResult) -> Iterator[Matches]:
        """Matches to refine: of each source, or those given if there is no map."""
        if given.correspondence_map is None:
            yield given.matches
            return
        for source in self.sources:
            yield source.find(image1, image2, given.correspondence_map, given.matches)

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
            rows = np.searchsorted(local.index, aligned.index[good])
            agreeing = _completed(agreeing, rows, moved)
        yield agreeing, options.min_matches


def _completed(rest: Matches, rows: np.ndarray, aligned: Matches) -> Matches:
    """Matches as they were found, but for those `rows` that were aligned.

    Patches of views far apart often differ too much. What is left of them is more accurate, but too
    little to tell a pose from chance; both together have the error of those found.
    """
    points1, points2 = rest.points1.copy(), rest.points2.copy()
    points1[rows], points2[rows] = aligned.points1, aligned.points2
    return replace(rest, points1=points1, points2=points2)
