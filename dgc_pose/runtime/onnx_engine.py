"""The network run by ONNX Runtime and NumPy, on the CPU, without torch."""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image

from dgc_pose.errors import InputError
from dgc_pose.images.image import resize
from dgc_pose.network.config import (
    COARSEST,
    CORRELATED,
    DEFAULT_WEIGHTS,
    EPSILON,
    INPUT_SIZE,
    LEVEL_SIZES,
    PASSES,
    PEAK,
    SECOND_SIZE,
    STRIDE,
    preset,
)
from dgc_pose.network.correlation import consensus, match_scores, peaks, pooled_evidence
from dgc_pose.network.weights import check_state, fingerprint, folded, read_safetensors
from dgc_pose.runtime import engine as graphs
from dgc_pose.runtime.engine import MapFeatures, NativeFeatures
from dgc_pose.runtime.session import Session, Sessions
from dgc_pose.system.parallel import in_threads


class OnnxEngine:
    """An `Engine` with the weights of a safetensors file of ours, whose preset has graphs.

    Sessions are made on first use, and again in a forked process, which loses their threads. Raises
    WeightsError if it is another kind of file or its weights do not fit its preset, InputError if
    the preset has no graphs.
    """

    concurrent = True  # threads that share an image would wait for each other at each layer
    can_resume = True

    def __init__(self, path: Path) -> None:
        name, self._stored = read_safetensors(path)
        if name != DEFAULT_WEIGHTS:
            raise InputError(path, f"is for {name}, which has no ONNX graphs: use --runtime torch")
        self.config = preset(name)
        names: dict[str, Any] = json.loads((graphs.GRAPHS / graphs.WEIGHTS).read_text("utf-8"))
        check_state(path, name, self._stored, names["stored"])
        self._weights = folded(self._stored)
        self.correlation_scales = self._weights["correlation_scales"]  # in no graph
        self._names = names["graphs"]
        self._sessions = Sessions()
        # Source, target, level and state (1, 3, h, w) of the last map: a finer map continues it
        self._begun: tuple[MapFeatures, MapFeatures, int, np.ndarray] | None = None

    @cached_property
    def fingerprint(self) -> str:
        return fingerprint(self._stored.items())

    def encode(self, pixels: np.ndarray) -> MapFeatures:
        size = self.config.input_size((pixels.shape[1], pixels.shape[0]))
        image = resize(pixels, size).astype(np.float32)
        levels = self._session(graphs.LEVELS)(image)
        smaller = self._session(graphs.LEVELS)(_shrunk(image, SECOND_SIZE / INPUT_SIZE))
        resample = self._session(graphs.RESAMPLE)
        levels += [resample(smaller[i], levels[i])[0] for i in CORRELATED]
        return MapFeatures(levels, size)

    def coarsest(self, features: MapFeatures) -> np.ndarray:
        level = features.levels[COARSEST][0].transpose(1, 2, 0)
        length = np.linalg.norm(level, axis=-1, keepdims=True)
        return level / np.maximum(length, np.float32(1e-12))

    def native(self, pixels: np.ndarray, cells: tuple[int, int]) -> NativeFeatures:
        image = resize(pixels, (cells[0] * STRIDE, cells[1] * STRIDE)).astype(np.float32)
        fine, middle, coarse = self._session(graphs.NATIVE)(image)
        return NativeFeatures(coarse, middle, fine)

    def decode(
        self, source: MapFeatures, target: MapFeatures, finest: int
    ) -> tuple[np.ndarray, np.ndarray]:
        last = LEVEL_SIZES.index(finest)
        begun = self._begun
        if begun and begun[0] is source and begun[1] is target and begun[2] >= last:
            above, state = begun[2:]
        else:
            above = COARSEST + 1
            state = self._start(source, target)

        for level in range(above - 1, last - 1, -1):
            previous = state if level == COARSEST else self._session(graphs.UPSAMPLE)(state)[0]
            features1 = source.levels[level]
            features2 = target.levels[level]
            (warped,) = self._session(graphs.WARP)(features1, previous)
            radius = self.config.decoders[level].local_radius
            assert radius is not None  # in a preset that has graphs
            local = local_correlation(l2_normalised(warped[0]), l2_normalised(features2[0]), radius)
            # Corrections are in cells of the source; the mask logit has no unit.
            rows, columns = features1.shape[2:]
            cell = np.array([2 / columns, 2 / rows, 1], np.float32)[:, None, None]
            decoder = self._session(f"reg_{level}.onnx")
            (state,) = decoder(warped, features2, local[None], previous, cell[None])

        self._begun = source, target, last, state
        normalised = np.nan_to_num(state[0, :2].transpose(1, 2, 0), nan=-2.0)  # edges at -1 and 1
        points = ((normalised + 1) * np.array(source.size, np.float32) - 1) / 2
        return points, 1 / (1 + np.exp(-state[0, 2]))

    def _start(self, source: MapFeatures, target: MapFeatures) -> np.ndarray:
        """The coarsest level's map and mask logit (1, 3, h, w), from the correlation's peak."""
        scales1 = self._scales(source)
        scales2 = self._scales(target)
        evidence = pooled_evidence(scales1, scales2, self.correlation_scales)
        grid1, grid2 = (features.levels[COARSEST].shape[2:] for features in (source, target))
        cells, probability = peaks(consensus(match_scores(evidence), PASSES, grid1, grid2), grid1)
        points = (2 * cells + 1) / np.array(grid1[::-1])[:, None] - 1
        probability = probability.clip(*PEAK)
        logits = np.log(probability / (1 - probability))
        state = np.concatenate([points, logits[None]])
        return state.reshape(1, 3, *grid2).astype(np.float32)

    def _scales(self, features: MapFeatures) -> list[list[np.ndarray]]:
        """The correlated levels, the coarsest first: at full scale, and at the second scale."""
        levels = features.levels
        scales = [[levels[level] for level in CORRELATED], levels[len(LEVEL_SIZES) :]]
        return [[l2_normalised(level[0]) for level in levels] for levels in scales]

    def _session(self, graph: str) -> Session:
        def make() -> Session:
            weights = {name: self._weights[name] for name in self._names[graph]}
            return Session(graphs.GRAPHS / graph, weights)

        return self._sessions.get(graph, make)


def l2_normalised(features: np.ndarray) -> np.ndarray:
    """Features (C, H, W) of unit length over the channels: f / sqrt(sum f^2 + 1e-6)."""
    squares = np.einsum("chw,chw->hw", features, features)
    return features * (1 / np.sqrt(squares + np.float32(EPSILON)))


def local_correlation(warped: np.ndarray, target: np.ndarray, radius: int) -> np.ndarray:
    """As `network.net.local_correlation`, from (C, H, W) to ((2 radius + 1)^2, H, W) float32. One
    pass over the features for each offset, without arrays of products, is fastest."""
    height, width = target.shape[1:]
    padded = np.pad(warped, ((0, 0), (radius, radius), (radius, radius)))
    side = 2 * radius + 1
    scores = np.empty((side**2, height, width), np.float32)

    def correlate(index: int) -> None:
        y, x = divmod(index, side)
        shifted = padded[:, y : y + height, x : x + width]
        np.einsum("chw,chw->hw", shifted, target, out=scores[index])

    in_threads(correlate, range(side**2))
    return scores


def _shrunk(image: np.ndarray, ratio: float) -> np.ndarray:
    """An image (H, W, 3) float32 at a smaller scale, its sides multiples of 16, by a triangle
    filter, as torch's bilinear interpolation with antialiasing."""
    height, width = (STRIDE * max(1, round(side * ratio / STRIDE)) for side in image.shape[:2])
    planes = [
        PIL.Image.fromarray(plane).resize((width, height), PIL.Image.Resampling.BILINEAR)
        for plane in np.ascontiguousarray(image.transpose(2, 0, 1))
    ]
    return np.stack([np.asarray(plane) for plane in planes], -1)
