"""The sources of the matches that the refiner aligns."""

from __future__ import annotations

from typing import Protocol

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import CorrespondenceMap


class MatchSource(Protocol):
    """Finds better matches, given those of a matcher and its dense map."""

    def find(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap, matches: Matches
    ) -> Matches:
        """Matches in pixels of the images; `error_px` is the error of this source."""


class MapMatches:
    """The matcher's own matches, those selected from its map (a `MatchSource`)."""

    def find(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap, matches: Matches
    ) -> Matches:
        return matches
