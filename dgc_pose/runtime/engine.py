"""The interface of a runtime of the network, and its ONNX graphs. Its users need no torch."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dgc_pose.geometry.pixels import Size
from dgc_pose.network.config import DEFAULT_WEIGHTS, NetworkConfig

GRAPHS = Path(__file__).parent / "graphs" / DEFAULT_WEIGHTS  # of the one preset that has them
LEVELS = "levels.onnx"  # the whole pyramid
NATIVE = "native.onnx"  # its coarser levels
# Graphs without weights
WARP = "warp.onnx"
UPSAMPLE = "upsample.onnx"
RESAMPLE = "resample.onnx"
# JSON beside the graphs: "stored" has the shape of each stored weight by name; "graphs" has, for
# each graph, the names of the weights that it takes, with batch norms folded.
WEIGHTS = "weights.json"


@dataclass(frozen=True, eq=False)
class MapFeatures:
    """Features of an image for the dense map; only the engine that made them can use them."""

    # (1, C, h, w) for levels 0 to 4, then for the correlated levels at the second scale, if the
    # network has one: arrays of the engine's library
    levels: list[Any]
    size: Size  # (width, height) of the resized image

    @property
    def nbytes(self) -> int:
        return sum(level.nbytes for level in self.levels)


@dataclass(frozen=True, eq=False)
class NativeFeatures:
    """Features of an image that keeps its shape, of unit length over the channels (last axis)."""

    coarse: np.ndarray  # (h, w, C) float32, stride 16
    middle: np.ndarray  # (2 h, 2 w, C') float32, stride 8
    fine: np.ndarray  # (4 h, 4 w, C'') float32, stride 4

    @property
    def middle_by_cell(self) -> np.ndarray:
        """The features (h * w, 4, C') of stride 8 in each cell of stride 16, both row by row."""
        height, width, channels = self.middle.shape
        split = self.middle.reshape(height // 2, 2, width // 2, 2, channels)
        return split.transpose(0, 2, 1, 3, 4).reshape(-1, 4, channels)

    @property
    def nbytes(self) -> int:
        return self.coarse.nbytes + self.middle.nbytes + self.fine.nbytes


class Engine(Protocol):
    """A frozen network with its weights, run by some library on some device. Images are (H, W, 3)
    uint8 RGB; their features may be kept for later pairs."""

    config: NetworkConfig
    concurrent: bool  # whether several threads encode images faster than one
    can_resume: bool  # whether decoding further reuses the last pair's coarser levels
    correlation_scales: np.ndarray  # (levels,) float32, inverse temperatures, coarsest level first

    @property
    def fingerprint(self) -> str:
        """16 hexadecimal digits that identify the weights, the same for every engine."""

    def encode(self, pixels: np.ndarray) -> MapFeatures:
        """Features of an image, resized to `config.input_size`."""

    def coarsest(self, features: MapFeatures) -> np.ndarray:
        """The coarsest level of `encode` (h, w, C) float32, of unit length over the channels."""

    def decode(
        self, source: MapFeatures, target: MapFeatures, finest: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """The map of a pair: for each target cell, x and y (H, W, 2) float32 in pixels of the
        resized source, no NaN; and the matchability (H, W) float32 in [0, 1], 1 for a network
        without a mask. finest: the last level decoded, by its cells a side for square images, one
        of LEVEL_SIZES."""

    def native(self, pixels: np.ndarray, cells: tuple[int, int]) -> NativeFeatures:
        """Features of an image resized to `cells` (columns, rows) of stride 16."""
