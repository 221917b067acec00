"""The refiner: better matches from the dense map's, by one of several ways, then aligned."""

from __future__ import annotations

import math

from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.dense import DenseMatcher
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.refinement.align import align, spread
from dgc_pose.refinement.consistency import consistent
from dgc_pose.refinement.features import match_features
from dgc_pose.refinement.flow import match_flow
from dgc_pose.refinement.guide import zoom_between
from dgc_pose.refinement.native import NativeCache, native_cache
from dgc_pose.refinement.options import MatchSource, RefinementOptions
from dgc_pose.refinement.sift import match_sift
from dgc_pose.refinement.zoom import match_zoom

# Error of an aligned match along one axis, pixels of the originals; see docs/accuracy.md.
ALIGNED_ERROR_PX = 0.5
_FEW = 0.3  # of the features' matches that agree: with fewer, other zooms may do better
_ZOOMS = (1 / 3, 3.0)  # that are tried then
_SHIFT = 5.0  # how far alignment may move a match, in units of the error that it came with


class Refiner:
    """A dense matcher with refinement behind it: a `Matcher` as well.

    The network is the dense matcher's own, as frozen as there. cache: of the features at native
    resolution; by default none is kept from pair to pair.
    """

    def __init__(
        self,
        dense: DenseMatcher,
        options: RefinementOptions | None = None,
        cache: NativeCache | None = None,
    ) -> None:
        self.dense = dense
        self.options = options or RefinementOptions()
        self.cache = cache
        self._sift = SiftMatcher()

    @property
    def name(self) -> str:
        return self.dense.name

    def match(self, image1: Image, image2: Image) -> Matches:
        """Refined matches, in pixels of the original images."""
        return self.trace(image1, image2)[1]

    def trace(self, image1: Image, image2: Image) -> tuple[CorrespondenceMap, Matches]:
        """The dense map, and the refined matches."""
        correspondences, matches = self.dense.trace(image1, image2)
        return correspondences, self.refine(image1, image2, correspondences, matches)

    def refine(
        self, image1: Image, image2: Image, correspondences: CorrespondenceMap, matches: Matches
    ) -> Matches:
        """Matches in pixels of the originals, with the error of the way that they were made.

        matches: those selected from the map. Each step counts where it leaves at least
        `min_matches`; else the step before it does, and at last the matches given: a scene that
        refinement cannot hold on to is no worse for it.
        """
        auto: tuple[MatchSource, ...] = ("features", "map")
        for source in auto if self.options.source == "auto" else (self.options.source,):
            found = self._found(source, image1, image2, correspondences, matches)
            refined = self._steps(image1, image2, found)
            if refined is not None:
                return refined
        return matches

    def _steps(self, image1: Image, image2: Image, found: Matches) -> Matches | None:
        """Matches that agree with their neighbours, aligned; None where too few agree."""
        options = self.options
        local = consistent(found, options.neighbours)
        if len(local.index) < options.min_matches:
            return None
        if options.align:
            aligned = align(
                image1.pixels,
                image2.pixels,
                local,
                radius=options.patch_radius,
                max_shift=_SHIFT * found.error_px,
                max_matches=options.max_matches,
                back_px=options.back_px,
            )
            good = aligned.converged & (aligned.zncc >= options.min_zncc)
            if good.sum() >= options.min_matches:
                points1, points2 = aligned.points1[good], aligned.points2[good]
                error_px = ALIGNED_ERROR_PX * aligned.pixel
                return Matches(points1, points2, aligned.zncc[good].clip(0, 1), error_px)
        confidence = found.confidence[local.index]
        kept = spread(local.points2, confidence, image2.size, options.max_matches)
        return Matches(
            found.points1[local.index[kept]],
            local.points2[kept],
            confidence[kept],
            found.error_px,
        )

    def _found(
        self,
        source: MatchSource,
        image1: Image,
        image2: Image,
        correspondences: CorrespondenceMap,
        matches: Matches,
    ) -> Matches:
        """The matches that the steps start from."""
        options = self.options
        if source == "features":
            return self._features(image1, image2, correspondences)
        if source == "flow":
            return match_flow(
                image1,
                image2,
                correspondences,
                matchability=self.dense.options.matchability,
                long_side=options.long_side,
                max_matches=options.max_matches,
            )
        if source == "sift":
            return match_sift(
                self._sift,
                image1,
                image2,
                correspondences,
                window_cells=options.window_cells,
                ratio=options.sift_ratio,
            )
        if source == "zoom":
            return match_zoom(self.dense, image1, image2, correspondences, tiles=options.tiles)
        return matches

    def _features(
        self, image1: Image, image2: Image, correspondences: CorrespondenceMap
    ) -> Matches:
        """Matches of features at the zoom that the map shows, in octaves, since features bear half
        of one; where the map is weak, at others as well, and the best of them kept."""
        options = self.options
        cache = self.cache or native_cache()

        def at(zoom: float) -> Matches:
            return match_features(
                self.dense.net,
                image1,
                image2,
                correspondences,
                zoom=zoom,
                long_side=options.long_side,
                candidates=options.candidates,
                cache=cache,
            )

        def agreeing(found: Matches) -> int:
            return len(consistent(found, options.neighbours).index)

        shown = 2.0 ** round(math.log2(zoom_between(correspondences)))
        found = at(shown)
        if correspondences.matchability.mean() >= self.dense.options.roll_share:
            return found
        most = agreeing(found)
        # What a weak map shows is a guess, and that things are equally large as good a one.
        for zoom in (1.0, *_ZOOMS):
            if zoom == shown or (zoom != 1.0 and most >= _FEW * len(found)):
                continue
            other = at(zoom)
            count = agreeing(other)
            if count > most:
                found, most = other, count
        return found
