"""A detector with descriptors that the user brings as an ONNX model, as a matcher.

The model takes one image (1, 3, H, W) or (1, 1, H, W) in [0, 1]. Two layouts of outputs are known:

- a grid: descriptors (1, C, h, w); logits (1, 65, h, w), of the 8x8 pixels of a cell, row by row,
  and of no key point in it; and optionally a reliability (1, 1, h, w), as XFeat has (Potje et al.,
  CVPR 2024);
- points: key points ([1,] N, 2) in pixels of the model's image, descriptors ([1,] N, D), and
  optionally scores.
"""

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import InputError, reason
from dgc_pose.geometry.pixels import rescale
from dgc_pose.geometry.sampling import bilinear_at
from dgc_pose.images.image import Image, resize
from dgc_pose.matching.cache import ImageCache
from dgc_pose.matching.key_points import KeyPointMatcher, KeyPoints
from dgc_pose.network.stored import find_weights
from dgc_pose.system.files import read_bytes

LONG_SIDE = 1024  # pixels; larger images are shrunk to it, unless the model takes one size alone
ERROR_PX = 1.0  # of a match along one axis, pixels of the model's image
MAX_POINTS = 4096  # of an image, those of the highest scores
_MULTIPLE = 32  # pixels that the sides of the model's image are a multiple of
Shape = list[int | str | None]  # of a tensor; a name for a side that may change
_CELL = 8  # pixels along a cell of the grid
_LEAST_SCORE = 0.05  # probability of a key point
_RADIUS = 2  # pixels around a key point without another one


class OnnxMatcher(KeyPointMatcher):
    """Mutual nearest neighbours by the cosine of the descriptors, which is the confidence.

    Raises WeightsError if the model cannot be loaded, InputError if it has another layout.
    """

    def __init__(self, path: str | Path, cache: ImageCache | None = None) -> None:
        from dgc_pose.runtime.session import Session  # ONNX Runtime takes its time to import

        super().__init__(cache)
        self.path = find_weights(path)
        self.name = self.path.stem
        self._digest = hashlib.sha256(read_bytes(self.path)).hexdigest()[:16]
        self._session = Session(self.path, {})
        inputs, outputs = self._session.inputs, self._session.outputs
        shape: Shape = inputs[0][1] if len(inputs) == 1 else []
        self._roles = _find_roles([shape for _, shape in outputs])
        if len(shape) != 4 or shape[1] not in (1, 3) or not self._roles:
            raise InputError(
                f"{self.path}: expected an image (1, 3, H, W) or (1, 1, H, W), and of it "
                "descriptors and logits (1, 65, h, w), or key points (N, 2) and descriptors, not "
                f"{_described(inputs)}, and {_described(outputs)}"
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
        points = rescale(points[best].astype(np.float64), size, image.size)
        return KeyPoints(points, unit.astype(np.float32))

    def _matched(
        self, descriptors1: np.ndarray, descriptors2: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cosines = descriptors1 @ descriptors2.T
        nearest = cosines.argmax(1)
        rows = np.flatnonzero(cosines.argmax(0)[nearest] == np.arange(len(nearest)))
        return rows, nearest[rows], cosines[rows, nearest[rows]].clip(0, 1)

    def _error_px(self, image1: Image, image2: Image) -> float:
        areas = [math.prod(image.size) / math.prod(self._size(image)) for image in (image1, image2)]
        return ERROR_PX * sum(map(math.sqrt, areas)) / 2

    def _size(self, image: Image) -> tuple[int, int]:
        """(width, height) of the model's image."""
        height, width = self._sides
        if isinstance(width, int) and isinstance(height, int):
            return width, height
        scale = min(1.0, LONG_SIDE / max(image.size))
        columns, rows = (max(1, int(side * scale) // _MULTIPLE) for side in image.size)
        return _MULTIPLE * columns, _MULTIPLE * rows


def _find_roles(shapes: Sequence[Shape]) -> dict[str, int]:
    """The outputs' indices by what they are; none for shapes of neither layout."""
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
    """The same of outputs that hold points; without scores all are equal."""
    points = role["points"].reshape(-1, 2)
    descriptors = role["descriptors"].reshape(-1, role["descriptors"].shape[-1])
    if len(descriptors) != len(points):  # (D, N)
        descriptors = descriptors.T
    scores = role["scores"].ravel() if "scores" in role else np.ones(len(points))
    return points, descriptors, scores


def _described(tensors: Sequence[tuple[str, Shape]]) -> str:
    return ", ".join(f"{name} ({', '.join(map(str, shape))})" for name, shape in tensors)
