"""How alike two images are around matches that come without a dense map.

`texture.context_ratio` needs views of both images at one scale and orientation. The affinities
between neighbouring matches give both.
"""

from __future__ import annotations

import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.correspondence_map import rotation_between
from dgc_pose.matching.features import LONG_SIDE, encode_each, equal_scales, shown_at
from dgc_pose.matching.matcher import Matcher
from dgc_pose.matching.patches import consistent
from dgc_pose.matching.texture import context_ratio
from dgc_pose.matching.view import View

_NEIGHBOURS = 8  # matches of an affinity
_LEAST = 8  # matches that agree with their neighbours
_STEP_DEG = 30.0  # image 2 is rotated by a multiple of it


def surroundings(matcher: Matcher, image1: Image, image2: Image, matches: Matches) -> float | None:
    """`Matches.context_ratio` by the features of a network; None if few matches agree with their
    neighbours. matches: in pixels of the upright images."""
    engine = matcher.engine
    near = consistent(matches, _NEIGHBOURS)
    if engine is None or len(near.points1) < _LEAST:
        return None
    areas = np.abs(np.linalg.det(near.affinity))
    octave = round(float(np.log2(np.clip(np.median(areas), 0.01, 100))) / 2)
    angle = _STEP_DEG * round(rotation_between(near.points1, near.points2) / _STEP_DEG) % 360
    scales = equal_scales(image1.size, image2.size, 2.0**octave, LONG_SIDE)
    first, second = (
        shown_at(View.whole(image, turn, scale), scale)
        for image, turn, scale in ((image1, 0.0, scales[0]), (image2, angle, scales[1]))
    )
    encoded = encode_each(engine, matcher.cache, (first, second))
    return context_ratio(
        (encoded[first], encoded[second]), matcher.textures(image1, image2), matches
    )
