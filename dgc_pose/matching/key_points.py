"""Matchers of key points. The key points of an image are kept for its next pair.

SIFT serves for comparison with the same estimator. The user can supply another detector with
descriptors as an ONNX model. The model takes one image (1, 3, H, W) or (1, 1, H, W) in [0, 1]. Two
layouts of outputs are supported:

- a grid: descriptors (1, C, h, w); logits (1, 65, h, w), for the 8x8 pixels of a cell, row by row,
  and for no key point in the cell; and optionally a reliability (1, 1, h, w), as XFeat has (Potje
  et al., CVPR 2024);
- points: key points ([1,] N, 2) in pixels of the model's image, descriptors ([1,] N, D), and
  optionally scores.
"""

import hashlib
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from dgc_pose.errors import InputError, reason
from dgc_pose.geometry.pixels import Size, rescale
from dgc_pose.geometry.sampling import bilinear_at
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image, resize
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.network.weights import find_weights
from dgc_pose.system.files import read_bytes

ERROR_PX = 1.0  # of a match along one axis: pixels of the originals for SIFT, else of the input
FEATURES = 8000  # most SIFT key points of an image
RATIO = 0.8  # largest ratio of distances, nearest to second nearest descriptor
LONG_SIDE = 1024  # pixels; larger images are shrunk to it, unless the model has a fixed size
MAX_POINTS = 4096  # most key points of an image by a model, of the highest scores
_MULTIPLE = 32  # pixels: the sides of the model's input are multiples of it
Shape = list[int | str | None]  # of a tensor; a variable side is a name or None
_CELL = 8  # pixels along a cell of the grid
_LEAST_SCORE = 0.05  # least probability of a key point
_RADIUS = 2  # pixels around a key point that contain no other one


# Rows (M,) of the first and of the second key points, and confidences (M,) of these matches
Rows = tuple[np.ndarray, np.ndarray, np.ndarray]


class KeyPoints(NamedTuple):
    """The key points of an image and their descriptors."""

    points: np.ndarray  # (N, 2), pixels of the image at `size`
    descriptors: np.ndarray  # (N, D)
    size: Size  # (width, height) at which they were found

    @property
    def nbytes(self) -> int:
        return self.points.nbytes + self.descriptors.nbytes


class KeyPointMatcher(Matcher):
    """Detects key points in each image (`_detect`) and matches their descriptors (`_matched`); a
    subclass defines both methods. Makes no map."""

    def __init__(self, cache: ImageCache | None = None) -> None:
        self.cache = cache or ImageCache(None)

    def _detect(self, image: Image) -> KeyPoints:
        raise NotImplementedError

    def _matched(self, found1: KeyPoints, found2: KeyPoints) -> Rows:
        raise NotImplementedError

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        images = image1, image2
        found = [
            self.cache.get(image, "key points", partial(self._detect, image)) for image in images
        ]
        rows1 = rows2 = np.zeros(0, int)
        confidence = np.zeros(0)
        if min(len(one.points) for one in found) > 1:  # a ratio test needs two
            rows1, rows2, confidence = self._matched(*found)
        points1, points2 = (
            rescale(one.points[rows], one.size, image.size)
            for one, rows, image in zip(found, (rows1, rows2), images, strict=True)
        )
        scales = [
            math.sqrt(math.prod(image.size) / math.prod(one.size))
            for one, image in zip(found, images, strict=True)
        ]
        error_px = ERROR_PX * sum(scales) / 2
        matches = Matches(points1, points2, confidence, error_px, key_points=True)
        return MatchResult(matches, None)


class SiftMatcher(KeyPointMatcher):
    """OpenCV's SIFT: mutual nearest neighbours that pass the ratio test (Lowe, IJCV 2004, section
    7.1); the confidence is 1 - distance ratio."""

    name = "sift"

    def _detect(self, image: Image) -> KeyPoints:
        detector = cv2.SIFT.create(nfeatures=FEATURES)
        grey = cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
        points, descriptors = detector.detectAndCompute(grey, None)
        if descriptors is None:
            return KeyPoints(np.zeros((0, 2)), np.zeros((0, 128), np.float32), image.size)
        at = np.array([point.pt for point in points], np.float64)
        return KeyPoints(at, descriptors, image.size)

    def _matched(self, found1: KeyPoints, found2: KeyPoints) -> Rows:
        matcher = cv2.BFMatcher(cv2.NORM_L2)
        forward = matcher.knnMatch(found1.descriptors, found2.descriptors, k=2)
        other_way = matcher.match(found2.descriptors, found1.descriptors)
        backward = {m.queryIdx: m.trainIdx for m in other_way}
        kept = []
        for best, second in forward:
            is_mutual = backward[best.trainIdx] == best.queryIdx
            if is_mutual and best.distance < RATIO * second.distance:
                confidence = 1 - best.distance / max(second.distance, 1e-12)
                kept.append((best.queryIdx, best.trainIdx, confidence))
        table = np.array(kept, dtype=np.float64).reshape(-1, 3)
        return table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2]


class OnnxMatcher(KeyPointMatcher):
    """Mutual nearest neighbours by the cosine of the descriptors, which is the confidence.

    Raises WeightsError if the model cannot be loaded, InputError if it has another layout.
    """

    def __init__(self, path: str | Path, cache: ImageCache | None = None) -> None:
        from dgc_pose.runtime.session import Session  # ONNX Runtime is slow to import

        super().__init__(cache)
        self.path = find_weights(path)
        self.name = self.path.stem
        self._digest = hashlib.sha256(read_bytes(self.path)).hexdigest()[:16]
        self._session = Session(self.path, {})
        inputs = self._session.inputs
        outputs = self._session.outputs
        shape: Shape = inputs[0][1] if len(inputs) == 1 else []
        self._roles = _find_roles([shape for _, shape in outputs])
        if len(shape) != 4 or shape[1] not in (1, 3) or not self._roles:
            raise InputError(
                f"{self.path} has inputs {_described(inputs)} and outputs {_described(outputs)}; "
                "expected an image; descriptors with key points or a grid of logits"
            )
        _, self._channels, *self._sides = shape

    @property
    def fingerprint(self) -> str:
        return self._digest

    def _detect(self, image: Image) -> KeyPoints:
        size = self._size(image)
        pixels = resize(image.pixels, size)
        if self._channels == 1:
            pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)[..., None]
        planes = np.ascontiguousarray(pixels.transpose(2, 0, 1)[None], np.float32) / np.float32(255)
        try:
            outputs = self._session(planes)
        except Exception as error:  # onnxruntime's errors have no common base
            raise InputError(f"{self.path}: {reason(error)}") from error
        role = {name: np.asarray(outputs[index]) for name, index in self._roles.items()}
        decode = _decode_grid if "logits" in role else _decode_points
        points, descriptors, scores = decode(role)
        best = np.argsort(-scores, kind="stable")[:MAX_POINTS]
        lengths = np.linalg.norm(descriptors[best], axis=1, keepdims=True)
        unit = descriptors[best] / np.maximum(lengths, 1e-9)
        return KeyPoints(points[best].astype(np.float64), unit.astype(np.float32), size)

    def _matched(self, found1: KeyPoints, found2: KeyPoints) -> Rows:
        rows1, rows2, cosines = mutual(found1.descriptors @ found2.descriptors.T)
        return rows1, rows2, cosines.clip(0, 1)

    def _size(self, image: Image) -> Size:
        """(width, height) of the model's input."""
        height, width = self._sides
        if isinstance(width, int) and isinstance(height, int):
            return width, height
        return input_size(image.size)


def input_size(size: Size) -> Size:
    """(width, height) at which a model of any size sees an image: at most `LONG_SIDE`."""
    longest = max(size)
    seen = min(longest, LONG_SIDE)
    columns, rows = (max(1, side * seen // longest // _MULTIPLE) for side in size)
    return _MULTIPLE * columns, _MULTIPLE * rows


def mutual(scores: np.ndarray) -> Rows:
    """The entries of a matrix that are the highest of their row and of their column: rows, columns
    and values."""
    nearest = scores.argmax(1)
    rows = np.flatnonzero(scores.argmax(0)[nearest] == np.arange(len(nearest)))
    return rows, nearest[rows], scores[rows, nearest[rows]]


def _find_roles(shapes: Sequence[Shape]) -> dict[str, int]:
    """The indices of the outputs by role; empty if the shapes fit neither layout."""
    rank = next((len(shape) for shape in shapes if shape[-1:] == [2]), 0)  # of points

    def role(shape: Shape) -> str:
        if len(shape) == 4:
            return "logits" if shape[1] == 65 else "scores" if shape[1] == 1 else "descriptors"
        if len(shape) == rank:
            return "points" if shape[-1] == 2 else "descriptors"
        return "scores" if len(shape) == rank - 1 else "unknown"

    roles = {role(shape): index for index, shape in enumerate(shapes)}
    layouts = {"logits", "descriptors"}, {"points", "descriptors"}
    known = len(roles) == len(shapes) and {*roles} - {"scores"} in layouts
    return roles if known else {}


def _decode_grid(role: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 2), descriptors (N, C) and scores (N,): the local maxima of the probability."""
    logits = role["logits"][0]
    logits = np.exp(logits - logits.max(0))
    cells = (logits / logits.sum(0))[:-1]
    rows, columns = cells.shape[1:]
    heat = cells.reshape(_CELL, _CELL, rows, columns).transpose(2, 0, 3, 1)
    heat = np.ascontiguousarray(heat.reshape(_CELL * rows, _CELL * columns))
    window = np.ones((2 * _RADIUS + 1, 2 * _RADIUS + 1))
    y, x = np.nonzero((heat > _LEAST_SCORE) & (heat == cv2.dilate(heat, window)))
    column, row = (((axis + 0.5) / _CELL - 0.5)[:, None] for axis in (x, y))
    planes = list(role["descriptors"][0])
    descriptors = np.concatenate([bilinear_at(plane, column, row) for plane in planes], 1)
    scores = heat[y, x]
    if "scores" in role:
        scores = scores * bilinear_at(role["scores"][0, 0], column, row)[:, 0]
    return np.stack([x, y], -1), descriptors, scores


def _decode_points(role: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `_decode_grid`, for the layout of points; without scores, each score is 1."""
    points = role["points"].reshape(-1, 2)
    descriptors = role["descriptors"].reshape(-1, role["descriptors"].shape[-1])
    if len(descriptors) != len(points):  # (D, N)
        descriptors = descriptors.T
    scores = role["scores"].ravel() if "scores" in role else np.ones(len(points))
    return points, descriptors, scores


def _described(tensors: Sequence[tuple[str, Shape]]) -> str:
    return ", ".join(f"{name} ({', '.join(map(str, shape))})" for name, shape in tensors)
