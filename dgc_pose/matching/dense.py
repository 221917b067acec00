"""The dense map of two images of any size by the frozen network, with a search for the rotation and
scale between the images.

The network is trained on upright pairs of similar scale. If its map is weak, rotated small copies
of one image are compared with the other image: at twelve angles for equal fields of view, at eight
for fields of view that differ by a factor of 2, and of 4 if 2 matches best. The copy with the
lowest mean entropy of the coarse matching distribution wins, as in REDI-Match for quarter turns;
this needs no training. Its most probable matches give the similarity that cuts both views.

Entropies are compared only within a pair, so no bound depends on the weights' temperature.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from dgc_pose.geometry.pixels import Size, rescale, within
from dgc_pose.geometry.sampling import bilinear
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image, resize_by
from dgc_pose.matching.correspondence_map import WEAK, CorrespondenceMap
from dgc_pose.matching.view import View, similarity
from dgc_pose.network.config import INPUT_SIZE, LONGEST, STRIDE
from dgc_pose.network.correlation import log_softmax, match_scores
from dgc_pose.runtime.engine import Engine, MapFeatures, NativeFeatures
from dgc_pose.system.parallel import in_threads

_CELLS = 56  # cells of an image's smallest copy; 225 find the rotation no better
_ANGLES = range(0, 360, 30)  # degrees, at equal fields of view
_FEWER_ANGLES = range(0, 360, 45)  # at other fields of view
_LARGEST = 4  # largest ratio between the fields of view
# A copy is selected if its entropy is below this share of the upright pair's entropy, and of the
# median of all copies.
_LOWER = 0.92
_CLEAR = 0.8  # relative to the median: if the entropy is lower, other scales are not tried
_PIXELS = 480  # square root of the area of a view, before the network resizes it
_MARGIN = 1.5  # sides of a window, relative to the part that the other image should cover
_MIN_MATCHES = 6  # least number of inliers of a similarity
_ANGLE_STEP = 5  # degrees: views are rotated by multiples of it
_REACH = 1.5  # inlier threshold of a similarity, cells
_ANGLE_OFF = 30.0  # degrees by which a similarity may differ from the copy that was compared
_SCALE_OFF = 2.0  # factor by which its scale may differ


def dense_map(
    engine: Engine,
    image1: Image,
    image2: Image,
    cache: ImageCache,
    *,
    cells: int = INPUT_SIZE,
    search: bool = True,
) -> CorrespondenceMap:
    """The map of a pair; image 1 is the network's source, image 2 its target. cells: see `finest`
    of `Engine.decode`. search: whether to try other rotations of image 2 and other scales if the
    mean matchability is below `WEAK`."""

    def decode(views: tuple[View, View]) -> tuple[np.ndarray, np.ndarray, Size]:
        source, target = map_features(engine, cache, *views)
        return *engine.decode(source, target, cells), source.size

    views = whole = View.whole(image1), View.whole(image2)
    points, matchability, size = decode(views)
    mean = matchability.mean()
    if search and mean < WEAK and (likely := search_views(engine, image1, image2, cache)):
        again = decode(likely)
        inside = likely[1].mask(again[1].shape[::-1])
        if again[1][inside].mean() > mean:
            views = likely
            points, matchability, size = again

    seen = matchability.shape[::-1]
    grid = whole[1].centres(seen)
    if views[1] != whole[1]:  # resample to image 2 as it is; matchability 0 outside the view
        sides = engine.config.input_size(image2.size)
        columns, rows = (side * cells // INPUT_SIZE for side in sides)
        grid = whole[1].centres((columns, rows))
        at = views[1].to_view(grid, seen)
        points = bilinear(points, at)
        matchability = bilinear(matchability, at)
        shown = within(views[1].to_view(grid), views[1].size)
        matchability = np.where(shown, matchability, np.float32(0))

    return CorrespondenceMap(
        map=views[0].to_image(points, size).astype(np.float32),
        grid=grid.astype(np.float32),
        matchability=np.ascontiguousarray(matchability),
        size1=image1.size,
        size2=image2.size,
    ).masked(image1, image2)


def map_features(engine: Engine, cache: ImageCache, *views: View) -> list[MapFeatures]:
    """The encoder's features of views."""

    def encode(view: View) -> MapFeatures:
        return engine.encode(view.pixels())

    wanted = [(view.image, view, partial(encode, view)) for view in views]
    return cache.get_all(wanted, in_turn=not engine.concurrent)


@dataclass(frozen=True, eq=False)
class _Thumbnail:
    points: np.ndarray  # (N, 2), centres of the cells inside, in pixels of the image
    pixel: float  # side of the copy's pixels, in pixels of the image
    features: NativeFeatures
    inside: np.ndarray  # (h, w) bool, which cells of stride 16 show the image

    @property
    def nbytes(self) -> int:
        return self.points.nbytes + self.features.nbytes + self.inside.nbytes


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A relative rotation and scale, with the result of the comparison."""

    angle_deg: float  # rotation of image 2
    octave: int  # log2 of the ratio of the fields of view: positive if image 1 shows more
    wide: _Thumbnail  # of the image with the larger field of view
    narrow: _Thumbnail
    logarithms: np.ndarray  # see `matching_distribution`
    entropy: float  # mean over the cells of `narrow`, 1 for a uniform distribution


def search_views(
    engine: Engine, image1: Image, image2: Image, cache: ImageCache
) -> tuple[View, View] | None:
    """Views of both images at a common orientation and scale; None if the images as they are match
    as well, or if the network squeezes one: its rotated copy would be nearly all border."""
    images = image1, image2
    if any(max(image.size) > LONGEST * min(image.size) for image in images):
        return None
    smaller = {image: cache.get(image, "shrunk", partial(_shrunk, image)) for image in images}

    def thumbnail(image: Image, angle_deg: int, octave: int) -> _Thumbnail:
        small = Image(smaller[image])
        scale = 2**octave * STRIDE * math.sqrt(_CELLS / math.prod(small.size))
        view = View.whole(small, float(angle_deg), scale)
        columns, rows = (max(1, round(side / STRIDE)) for side in view.size)
        features = engine.native(view.pixels(), (columns, rows))
        features = replace(features, fine=features.fine[:0].copy())  # not compared
        inside = view.mask((columns, rows))
        points = view.centres((columns, rows))[inside]
        pixel = math.sqrt(math.prod(image.size) / math.prod(small.size)) / view.scale
        return _Thumbnail(rescale(points, small.size, image.size), pixel, features, inside)

    def compared(motions: Sequence[tuple[int, int]]) -> list[_Candidate]:
        """The candidate for each angle and octave. The image with the smaller field of view is
        rotated, and shrunk to the scale of the other."""
        copies: list[tuple[Image, int, int]] = []  # for each motion the wide and the narrow copy
        for angle_deg, octave in motions:
            small, turn = (1, angle_deg) if octave >= 0 else (0, -angle_deg)
            copies += [(images[1 - small], 0, abs(octave)), (images[small], turn % 360, 0)]
        wanted = [(copy[0], copy[1:], partial(thumbnail, *copy)) for copy in copies]
        made = cache.get_all(wanted, in_turn=not engine.concurrent)

        def candidate(number: int) -> _Candidate:
            wide, narrow = made[2 * number : 2 * number + 2]
            logarithms = matching_distribution(
                wide.features, narrow.features, narrow.inside, engine.correlation_scales
            )
            return _Candidate(*motions[number], wide, narrow, logarithms, mean_entropy(logarithms))

        return in_threads(candidate, range(len(motions)))

    candidates = compared([(angle, 0) for angle in _ANGLES])
    upright = candidates[0]
    best, median = _lowest(candidates)
    if best.entropy > _CLEAR * median:
        candidates += compared([(angle, octave) for angle in _FEWER_ANGLES for octave in (1, -1)])
        best, median = _lowest(candidates)
        if best.octave:  # the fields of view may differ by more
            candidates += compared([(angle, 2 * best.octave) for angle in _FEWER_ANGLES])
            best, median = _lowest(candidates)
    if best is upright or best.entropy > _LOWER * min(upright.entropy, median):
        return None
    return _views(best, image1, image2)


def _shrunk(image: Image) -> np.ndarray:
    """The image shrunk to the size of its largest copy, or as it is if it is smaller."""
    largest = _LARGEST * STRIDE * math.sqrt(_CELLS)
    return resize_by(image.pixels, min(1.0, largest / math.sqrt(math.prod(image.size))))


def _lowest(candidates: Sequence[_Candidate]) -> tuple[_Candidate, float]:
    """The candidate with the lowest entropy, and the median of the entropies."""
    entropies = [candidate.entropy for candidate in candidates]
    return candidates[int(np.argmin(entropies))], float(np.median(entropies))


def matching_distribution(
    source: NativeFeatures, target: NativeFeatures, inside: np.ndarray, scales: np.ndarray
) -> np.ndarray:
    """For each of the target's n2 cells `inside` (h, w), the log-probabilities (n1, n2) of the
    source's coarse cells, by the dual softmax over the cosines of the correlated levels. scales:
    inverse temperatures of the levels, the coarsest first."""
    cells = np.flatnonzero(inside)
    coarse1, coarse2 = (
        features.coarse.reshape(-1, features.coarse.shape[2]) for features in (source, target)
    )
    evidence = scales[0] * (coarse1 @ coarse2[cells].T)
    if len(scales) > 1:
        children1, children2 = (
            children.transpose(1, 0, 2).reshape(-1, children.shape[2])
            for children in (source.middle_by_cell, target.middle_by_cell[cells])
        )
        four = (children1 @ children2.T).reshape(4, len(evidence), 4, len(cells))
        evidence = evidence + scales[1] * four.max(0).mean(1)
    return log_softmax(match_scores(evidence), 0)


def mean_entropy(logarithms: np.ndarray) -> float:
    """Mean entropy of the columns of log-probabilities (n1, n2): 0 certain, 1 uniform or empty."""
    cells, columns = logarithms.shape
    if cells < 2 or columns == 0:
        return 1.0
    return float(-(np.exp(logarithms) * logarithms).sum() / (columns * math.log(cells)))


def _views(best: _Candidate, image1: Image, image2: Image) -> tuple[View, View]:
    """Views of image 1 and image 2: the image with the smaller field of view is whole, the other is
    cut to the part that both show, with a margin. At equal fields of view both are whole."""
    linear, shift = _similarity(best)
    ratio = float(np.hypot(*linear[0]))  # pixels of the wide image per pixel of the narrow one
    turned = math.degrees(math.atan2(linear[0, 1], linear[0, 0]))
    step = _ANGLE_STEP * round((turned if best.octave >= 0 else -turned) / _ANGLE_STEP)
    angle = float(step % 360)
    if best.octave == 0:
        return View.whole(image1), View.rotated(image2, angle, _PIXELS)
    small, large = (image2, image1) if best.octave > 0 else (image1, image2)
    turn = angle if best.octave > 0 else 0.0
    whole = View.rotated(small, turn, _PIXELS)
    # At scale 1, in the orientation of image 1, which both views have.
    extent = [_MARGIN * ratio * side for side in View.whole(small, turn).size]
    centre = linear @ ((np.array(small.size) - 1) / 2) + shift
    centre = centre.clip(0, np.array(large.size) - 1)
    scale = min(1.0, _PIXELS / math.sqrt(math.prod(extent)))
    size = (max(1, round(extent[0] * scale)), max(1, round(extent[1] * scale)))
    around = (float(centre[0]), float(centre[1]))
    if best.octave > 0:
        return View(large, 0.0, scale, around, size), whole
    return whole, View(large, angle, scale, around, size)


def _similarity(best: _Candidate) -> tuple[np.ndarray, np.ndarray]:
    """Matrix (2, 2) and shift (2,) of the similarity from pixels of the narrow image to the wide
    one: fitted to the most probable matches, or else by the candidate's angle and octave."""
    peaks = best.logarithms.max(0)
    sure = peaks >= np.median(peaks)
    wide = best.wide.points[best.logarithms.argmax(0)][sure]
    narrow = best.narrow.points[sure]
    matrix = None
    fits = 0
    if len(narrow) >= _MIN_MATCHES:
        matrix, mask = cv2.estimateAffinePartial2D(
            narrow, wide, ransacReprojThreshold=_REACH * STRIDE * best.wide.pixel
        )
        fits = int(mask.sum())
    angle = best.angle_deg if best.octave >= 0 else -best.angle_deg
    linear = similarity(angle, best.wide.pixel / best.narrow.pixel)
    if matrix is not None and fits >= _MIN_MATCHES:
        change = np.linalg.solve(linear, matrix[:, :2])  # near the identity, if the fit is right
        off = abs(math.atan2(change[0, 1], change[0, 0]))
        grown = float(np.hypot(*change[0]))
        if off < math.radians(_ANGLE_OFF) and 1 / _SCALE_OFF < grown < _SCALE_OFF:
            return matrix[:, :2], matrix[:, 2]
    return linear, np.median(wide - narrow @ linear.T, 0)
