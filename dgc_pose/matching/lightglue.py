"""ALIKED's key points (Zhao et al., IEEE TIM 2023), matched by LightGlue (Lindenberger et al., ICCV
2023), on ONNX Runtime. The graphs and weights are a distribution of their own, in `lightglue/`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dgc_pose.errors import ArgumentName, WeightsError, is_installed, reason, require
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image, resize
from dgc_pose.matching.key_points import KeyPointMatcher, KeyPoints, Rows, input_size, mutual
from dgc_pose.network.weights import check_state, fingerprint, read_tensors, reading

if TYPE_CHECKING:
    from dgc_pose.runtime.session import Session

NAME = "aliked-lightglue"
PACKAGE = "dgc_pose_lightglue"
FORMAT = 1  # of the graphs and weights
ALIKED = "aliked.onnx"
LAYER = "layer.onnx"
WEIGHTS = "weights.safetensors"
SHAPES = "weights.json"
LAYERS = 9
_STOP = 0.95  # share of confident key points from which the remaining layers are left out
_MATCHABLE = 0.01  # a confident key point whose probability of a match is lower is left out
_LEAST_SCORE = 0.1  # of a match


class LightGlueMatcher(KeyPointMatcher):
    """ALIKED's 2048 best key points, matched by LightGlue; the confidence is its score.

    Raises InputError if the distribution is missing, WeightsError, with the file, if it has another
    format or is damaged.
    """

    name = NAME

    def __init__(self, cache: ImageCache | None = None) -> None:
        from dgc_pose.runtime.session import Sessions  # ONNX Runtime is slow to import

        super().__init__(cache)
        self._folder = installed()
        self._weights = read_weights(self._folder)
        self._sessions = Sessions()
        for part in ("aliked", *(f"layers.{index}" for index in range(LAYERS))):
            self._session(part)

    @cached_property
    def _digest(self) -> str:
        return fingerprint(self._weights.items())

    @property
    def fingerprint(self) -> str:
        return self._digest

    def _detect(self, image: Image) -> KeyPoints:
        size = input_size(image.size)
        pixels = resize(image.pixels, size).astype(np.float32)
        points, descriptors, scores = self._session("aliked")(pixels)
        found = scores > 0
        return KeyPoints(points[found].astype(np.float64), descriptors[found], size)

    def _matched(self, found1: KeyPoints, found2: KeyPoints) -> Rows:
        left = [self._entry(found) for found in (found1, found2)]
        count = sum(len(one.rows) for one in left)
        layer = 0
        for layer in range(LAYERS):
            left = self._attended(layer, left)
            if layer == LAYERS - 1:
                break
            limit = np.float32(0.8 + 0.1 * np.exp(-4 * layer / LAYERS))
            confidences = [self._probability(layer, "confident", one) for one in left]
            doubtful = sum(int((confidence < limit).sum()) for confidence in confidences)
            if 1 - doubtful / count > _STOP:
                break
            left = [
                one.of((self._probability(layer, "matchable", one) > _MATCHABLE) | (sure <= limit))
                for one, sure in zip(left, confidences, strict=True)
            ]
            if not all(len(one.rows) for one in left):
                return np.zeros(0, int), np.zeros(0, int), np.zeros(0)
        rows1, rows2, scores = mutual(self._scores(layer, left))
        kept = scores > np.log(_LEAST_SCORE)
        confidence = np.exp(scores[kept]).astype(np.float64)
        return left[0].rows[rows1[kept]], left[1].rows[rows2[kept]], confidence

    def _entry(self, found: KeyPoints) -> _Left:
        descriptors = self._affine("input", found.descriptors)
        size = np.array(found.size)
        positions = ((found.points - size / 2) / (size.max() / 2)).astype(np.float32)
        angles = positions @ self._weights["angles"]
        return _Left(np.arange(len(angles)), descriptors, np.cos(angles), np.sin(angles))

    def _attended(self, layer: int, left: list[_Left]) -> list[_Left]:
        first, second = left
        descriptors = self._session(f"layers.{layer}")(
            first.descriptors,
            second.descriptors,
            first.cosines,
            first.sines,
            second.cosines,
            second.sines,
        )
        return [
            replace(one, descriptors=value) for one, value in zip(left, descriptors, strict=True)
        ]

    def _scores(self, layer: int, left: list[_Left]) -> np.ndarray:
        """Logarithms (N, M) of the probability that two key points match, by the descriptors after
        a layer."""
        projected1, projected2 = (
            self._affine(f"decisions.{layer}.project", one.descriptors) for one in left
        )
        similarity = projected1 @ projected2.T / np.float32(np.sqrt(projected1.shape[1]))
        first, second = (_log_sigmoid(self._logit(layer, "matchable", one)) for one in left)
        rows = _log_softmax(similarity, 1)
        columns = _log_softmax(similarity, 0)
        rows += columns
        rows += first[:, None]
        rows += second
        return rows

    def _probability(self, layer: int, part: str, left: _Left) -> np.ndarray:
        return np.exp(_log_sigmoid(self._logit(layer, part, left)))

    def _logit(self, layer: int, part: str, left: _Left) -> np.ndarray:
        return self._affine(f"decisions.{layer}.{part}", left.descriptors)[:, 0]

    def _affine(self, name: str, values: np.ndarray) -> np.ndarray:
        return values @ self._weights[f"{name}.weight"] + self._weights[f"{name}.bias"]

    def _session(self, part: str) -> Session:
        """The session of the graph for the weights whose names begin with `part`."""
        from dgc_pose.runtime.session import Session

        def make() -> Session:
            graph = self._folder / (ALIKED if part == "aliked" else LAYER)
            names = [name for name in self._weights if name.startswith(f"{part}.")]
            weights = {name.removeprefix(f"{part}."): self._weights[name] for name in names}
            with reading("a graph", graph):
                return Session(graph, weights)

        return self._sessions.get(part, make)


@dataclass(frozen=True)
class _Left:
    """The key points of an image that may still match."""

    rows: np.ndarray  # (N,) among those detected
    descriptors: np.ndarray  # (N, 256)
    cosines: np.ndarray  # (N, 32), of the angles that stand for the position
    sines: np.ndarray  # (N, 32)

    def of(self, kept: np.ndarray) -> _Left:
        """Those where a mask (N,) is true."""
        parts = self.rows, self.descriptors, self.cosines, self.sines
        return _Left(*(part[kept] for part in parts))


def _log_sigmoid(logits: np.ndarray) -> np.ndarray:
    return -np.logaddexp(np.float32(0), -logits)


def _log_softmax(logits: np.ndarray, axis: int) -> np.ndarray:
    shifted = logits - logits.max(axis, keepdims=True)
    shifted -= np.log(np.exp(shifted).sum(axis, keepdims=True))
    return shifted


def is_available() -> bool:
    """Whether the graphs and weights are installed."""
    return is_installed(PACKAGE)


def installed() -> Path:
    """The folder of the installed graphs and weights. Raises InputError if they are missing,
    WeightsError if they have another format."""
    require({NAME: "lightglue"})
    try:
        package = import_module(PACKAGE)
    except Exception as error:  # whatever is in it
        raise WeightsError(f"{PACKAGE} cannot be imported ({reason(error)})") from error
    folder = Path(str(package.__file__)).parent
    if (found := getattr(package, "FORMAT", None)) != FORMAT:
        raise WeightsError(folder, f"has format {found}; {NAME} needs format {FORMAT}")
    return folder


@contextmanager
def as_second() -> Iterator[None]:
    """An error of weights within the block names the option that leaves out the second matcher."""
    try:
        yield
    except WeightsError as error:
        *parts, last = error.args
        without = ArgumentName("second"), "none leaves out the second matcher"
        raise WeightsError(*parts, f"{last};", *without) from error


def installed_fingerprint() -> str:
    """`LightGlueMatcher.fingerprint`, without the graphs. Raises as `installed` and
    `read_weights`."""
    return fingerprint(read_weights(installed()).items())


def read_weights(folder: Path) -> Mapping[str, np.ndarray]:
    """The weights in single precision. Raises WeightsError, with the file, if it is damaged."""
    with reading("a table of shapes", folder / SHAPES):
        table = json.loads((folder / SHAPES).read_bytes())
        shapes = {key: tuple(map(int, shape)) for key, shape in table.items()}
    _, state = read_tensors(folder / WEIGHTS)
    check_state(folder / WEIGHTS, NAME, state, shapes)
    return {key: value.astype(np.float32) for key, value in state.items()}
