"""The interface of all matchers: two images in, matches out, with the dense map if there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from dgc_pose.cameras.camera import TwoViews
from dgc_pose.errors import InputError
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.correspondence_map import CorrespondenceMap
from dgc_pose.matching.texture import Texture, texture, textured
from dgc_pose.runtime.engine import Engine


@dataclass(frozen=True, eq=False)
class MatchResult:
    """The matches of two images.

    Attributes:
        matches: Matches to estimate a pose from, in pixels of the matched images.
        correspondence_map: The dense map; None for a matcher of key points.
        aligned: The refined matches whose patches are aligned; None without refinement.
    """

    matches: Matches
    correspondence_map: CorrespondenceMap | None
    aligned: Matches | None = None

    @property
    def map_matches(self) -> Matches | None:
        """The sample of the dense map, for `estimate_pose`; None without a map."""
        return None if self.correspondence_map is None else self.correspondence_map.sample


class Matcher:
    """Anything that matches two images: the network, SIFT, a detector, or files.

    `match` suffices for a pair. `coarse`, `refined`, `guided` and `second` are further steps of
    `solve_pair`; each returns None if it has no new matches.
    """

    name: str  # in results and tables
    engine: Engine | None = None  # the network of a `NetworkMatcher`, which has all steps

    @property
    def second_matcher(self) -> Matcher | None:
        """The matcher of the step `second`, loaded on first use; None without one."""
        return None

    @cached_property
    def cache(self) -> ImageCache:
        """Values computed of images; by default the values of the last three images are kept."""
        return ImageCache(None)

    @property
    def fingerprint(self) -> str | None:
        """16 hexadecimal digits that identify the weights; None for a matcher without weights."""

    def match(self, image1: Image, image2: Image) -> MatchResult:
        """The matches in pixels of the images, and the dense map if the matcher makes one. Both
        points of a match lie where their image has structure and no mask."""
        result = self._match(image1, image2)
        return replace(result, matches=self._textured(image1, image2, result.matches))

    def coarse(self, image1: Image, image2: Image) -> MatchResult | None:
        """Match small images, which is enough for an easy pair."""

    def refined(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult | None:
        """Match at full resolution, guided by the map of a result."""

    def guided(
        self, image1: Image, image2: Image, result: MatchResult, hypotheses: Sequence[TwoViews]
    ) -> MatchResult | None:
        """Add to a result matches near the epipolar lines of hypotheses of the pose."""

    def second(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult | None:
        """Add to a result the matches of a second matcher; the result itself if it has none."""

    def coarse_features(self, image: Image) -> np.ndarray:
        """A network's coarsest features of an image (cells, C) float32, of unit length over C.
        Raises InputError for a matcher that has none."""
        raise InputError(f"{self.name} cannot choose pairs, which needs the features of a network")

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """As `match`, but also where an image has no structure or a mask. A subclass defines it."""
        raise NotImplementedError

    def _textured(self, image1: Image, image2: Image, matches: Matches) -> Matches:
        """The matches whose points have structure around them in both images, and no mask."""
        masked = image1.is_masked(matches.points1) | image2.is_masked(matches.points2)
        return textured(matches.subset(~masked), *self.textures(image1, image2))

    def textures(self, image1: Image, image2: Image) -> list[Texture]:
        """Where both images have structure; kept for their next pairs."""
        made = [(image, "texture", partial(texture, image)) for image in (image1, image2)]
        return self.cache.get_all(made, in_turn=False)
