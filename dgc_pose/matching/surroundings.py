"""What surrounds the matches, and how alike it is in both images.

Matches of one place go on to an occlusion, to the end of an image, or to a surface without texture.
Those of two places that have an object, a wall or a window alike end with it, in the midst of
texture. Cells near the matches are therefore looked for in the other image, where the affinity
of their nearest match has them. Likeness is the cosine of the frozen features there, over that at
random places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgc_pose.geometry.pixels import cell_centres, pixel_grid, rescale, window_offsets, within
from dgc_pose.geometry.sampling import nearest_to
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.consistency import consistent
from dgc_pose.matching.texture import Texture
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import NativeFeatures
from dgc_pose.system.threads import in_threads

_NEIGHBOURS = 8  # matches, whose affinity predicts where a cell lies
# Cells of stride 8, at full resolution, from a cell to the nearest match: below, it is at a match;
# between, it is around the matches
_AT_MATCHES, _RIM = 1.5, (3.0, 8.0)
_MOST = 250  # cells of each kind, drawn at random
_REACH = 2  # cells searched about a place
_PLACES = 4  # at random, that a cell is compared with
_LEAST = 8  # cells of each kind, of an image that counts
_LEAST_LIKENESS = 0.01  # of cells at matches
_SEED = 0
_WINDOW = window_offsets(_REACH).astype(np.int64)

_Encoded = tuple[View, NativeFeatures]
_End = tuple[Image, _Encoded, Texture]


def surroundings(
    images: tuple[Image, Image],
    views: Sequence[_Encoded],
    textures: Sequence[Texture],
    matches: Matches,
    scale: float = 1.0,
) -> float | None:
    """The likeness of what surrounds the matches of two images, over that at the matches; means
    over cells with structure and no mask, and of both images the lesser. None if nothing surrounds
    them.

    views: of both images, with their features; textures: of both; scale: of the views' sides, over
    those at full resolution.
    """
    first, second = zip(images, views, textures, strict=True)
    ways = (first, second, matches), (second, first, matches.swapped())
    shares = []
    for at_matches, around in in_threads(lambda way: _likeness(*way, scale), ways):
        if min(len(at_matches), len(around)) >= _LEAST:
            shares.append(float(around.mean()) / max(float(at_matches.mean()), _LEAST_LIKENESS))
    return min(shares, default=None)


def _likeness(source: _End, target: _End, every: Matches, scale: float) -> list[np.ndarray]:
    """The likeness of cells of the target, image 2 of the matches: at matches, and around them."""
    matches = consistent(every, _NEIGHBOURS)
    rng = np.random.default_rng(_SEED)
    (image1, (view1, features1), _), (image2, (view2, features2), texture) = source, target
    sides1, sides2 = (features.middle.shape[1::-1] for features in (features1, features2))
    centres1, centres = (
        view.to_image(cell_centres(sides, features.size).reshape(-1, 2))
        for view, sides, features in ((view1, sides1, features1), (view2, sides2, features2))
    )
    random = pixel_grid(sides1).reshape(-1, 2)[within(centres1, image1.size)]
    at = rescale(view2.to_view(matches.points2), features2.size, sides2)
    distance, nearest = nearest_to(pixel_grid(sides2).reshape(-1, 2), at)
    distance = distance / scale
    usable, result = texture.at(centres) & ~image2.is_masked(centres), []
    for kind in (distance < _AT_MATCHES, (distance >= _RIM[0]) & (distance < _RIM[1])):
        chosen = rng.permutation(np.flatnonzero(kind & usable))[:_MOST]
        near = matches.subset(nearest[chosen])
        offsets = centres[chosen] - near.points2
        points = near.points1 + np.einsum("nij,nj->ni", near.affinity, offsets)
        place = rescale(view1.to_view(points), features1.size, sides1)
        shown = within(place, sides1) & within(points, image1.size) & ~image1.is_masked(points)
        wanted = features2.middle.reshape(len(centres), -1)[chosen[shown]]
        places = random[rng.integers(len(random), size=(_PLACES, len(wanted)))]
        elsewhere = [_best(features1.middle, wanted, of) for of in places]
        result.append(_best(features1.middle, wanted, place[shown]) - np.mean(elsewhere, 0))
    return result


def _best(middle: np.ndarray, wanted: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The largest cosine (N,) of features (N, C) within a window about places (N, 2) of a level."""
    cells = np.rint(places).astype(np.int64)[:, None] + _WINDOW
    x, y = cells.clip(0, np.subtract(middle.shape[1::-1], 1)).transpose(2, 0, 1)
    return (middle[y, x] @ wanted[:, :, None])[..., 0].max(1)
