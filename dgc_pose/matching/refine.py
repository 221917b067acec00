"""More accurate matches of a pair: those that agree with their neighbours, aligned on both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.align import CORNER_RADIUS, MIN_ZNCC, align
from dgc_pose.matching.consistency import consistent

# Error of an aligned match along one axis, pixels of the originals; see docs/experiments.md.
ALIGNED_ERROR_PX = 0.5
NEIGHBOURS = 12  # nearest matches whose affinity a match must fit
MIN_MATCHES = 50  # fewer that agree are too few to refine


def refine(
    image1: Image,
    image2: Image,
    matches: Matches,
    max_matches: int,
    corner_radius: int = CORNER_RADIUS,
) -> tuple[Matches, Matches]:
    """The matches that can be aligned, at most `max_matches`, evenly spread; and all that agree
    with their neighbours, aligned where that succeeds. None of either if fewer than `MIN_MATCHES`
    agree.

    corner_radius: pixels of image 2 that a match moves along each axis at most, to a corner.
    """
    local = consistent(matches, NEIGHBOURS)
    if len(local.index) < MIN_MATCHES:
        none = matches.subset(local.index[:0])
        return none, none
    agreeing = matches.subset(local.index)
    aligned = align(
        image1.pixels,
        image2.pixels,
        local,
        error_px=matches.error_px,
        max_matches=max_matches,
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
