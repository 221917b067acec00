"""The network run by ONNX Runtime and NumPy, on the CPU, without torch."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image

from dgc_pose.errors import InputError, WeightsError
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
from dgc_pose.system.files import open_file
from dgc_pose.system.onnx_library import SHARED_ARENA, onnxruntime
from dgc_pose.system.parallel import in_threads

_QUIET = 4  # log level: errors are raised, and need not be printed
_MOST_THREADS = 8  # the graphs are small: more threads would only wait for each other
_MAKING = threading.Lock()  # held while a session is made: two threads may need the same one


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
        self._sessions: dict[tuple[int, str], Session] = {}
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
        last, begun = LEVEL_SIZES.index(finest), self._begun
        if begun and begun[0] is source and begun[1] is target and begun[2] >= last:
            above, state = begun[2:]
        else:
            above, state = COARSEST + 1, self._start(source, target)
        for level in range(above - 1, last - 1, -1):
            previous = state if level == COARSEST else self._session(graphs.UPSAMPLE)(state)[0]
            features1, features2 = source.levels[level], target.levels[level]
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
        scales1, scales2 = self._scales(source), self._scales(target)
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
        key = os.getpid(), graph
        with _MAKING:
            if key not in self._sessions:
                weights = {name: self._weights[name] for name in self._names[graph]}
                self._sessions[key] = Session(graphs.GRAPHS / graph, weights)
            return self._sessions[key]


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


class Session:
    """A graph, called with arrays in the order of its inputs, from any thread.

    weights: exactly the graph's initializers, by name. Raises WeightsError if weights are missing
    or do not fit, OSError, with the path, if the graph cannot be read.
    """

    def __init__(self, path: Path, weights: Mapping[str, np.ndarray]) -> None:
        open_file(path, WeightsError).close()  # ONNX Runtime hides the system's message
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = session_threads()
        options.inter_op_num_threads = 1
        options.log_severity_level = _QUIET
        options.add_session_config_entry(SHARED_ARENA, "1")
        # Threads without work must not take the processor from other processes.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        # The values must outlive the session.
        self._values = [
            onnxruntime.OrtValue.ortvalue_from_numpy(value) for value in weights.values()
        ]
        options.add_external_initializers(list(weights), self._values)
        try:
            self._session = onnxruntime.InferenceSession(
                str(path),
                options,
                providers=["CPUExecutionProvider"],
                enable_fallback=0,  # would try the same again, and print
            )
        except Exception as error:  # onnxruntime's errors have no common base
            raise WeightsError(f"{path.name}: {str(error).splitlines()[0]}") from error
        self.inputs, self.outputs = (
            [(tensor.name, tensor.shape) for tensor in tensors]
            for tensors in (self._session.get_inputs(), self._session.get_outputs())
        )

    def __call__(self, *arrays: np.ndarray) -> list[np.ndarray]:
        inputs = {name: array for (name, _), array in zip(self.inputs, arrays, strict=True)}
        return self._session.run(None, inputs)


def session_threads() -> int:
    """As many threads as OpenCV uses, but at most `_MOST_THREADS` and OMP_NUM_THREADS."""
    most = min(_MOST_THREADS, max(1, cv2.getNumThreads()))
    allowed = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    return min(most, int(allowed)) if allowed.isdigit() and int(allowed) > 0 else most
