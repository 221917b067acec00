"""The frozen network as a matcher: images of any size in, matches in their own pixels out."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.matching.selection import MatchingOptions, select_matches
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.device import choose_device
from dgc_pose.network.net import DGCNet, Prediction
from dgc_pose.network.statistics import normalise
from dgc_pose.network.weights import DEFAULT, load_network


class DenseMatcher:
    """Matches by a frozen `DGCNet`; image 1 is its source, image 2 its target."""

    def __init__(self, net: DGCNet, options: MatchingOptions | None = None) -> None:
        self.net = net.eval().requires_grad_(False)
        self.options = options or MatchingOptions()

    @property
    def name(self) -> str:
        return self.net.config.name

    def match(self, image1: Image, image2: Image) -> Matches:
        """The matches that pass the options, in pixels of the original images."""
        return self.select(self.correspond(image1, image2))

    @torch.no_grad()
    def correspond(self, image1: Image, image2: Image) -> CorrespondenceMap:
        """The dense map at 240x240 cells; with the way back where the options ask for a cycle."""
        source = self.net.pyramid(self._input(image1.pixels))
        found = self._at_roll(source, image1, image2, 0)
        if found.matchability.mean() < self.options.roll_share:
            turned = [self._at_roll(source, image1, image2, roll) for roll in (1, 2, 3)]
            found = max((found, *turned), key=lambda c: float(c.matchability.mean()))
        return found

    def select(self, correspondences: CorrespondenceMap) -> Matches:
        """The cells of a map that pass the options."""
        return select_matches(correspondences, self.options)

    def _at_roll(
        self, source: list[Tensor], image1: Image, image2: Image, roll: int
    ) -> CorrespondenceMap:
        """The map to image 2 turned by `roll` times 90 degrees, on the grid of image 2 as it is."""
        turned = np.ascontiguousarray(np.rot90(image2.pixels, roll))
        target = self.net.pyramid(self._input(turned))
        there = self.net.decode(source, target)
        place = self._cells(there)
        cycle = None
        if self.options.cycle_px is not None:
            size = (turned.shape[1], turned.shape[0])
            cycle = self._cycle(place, self._cells(self.net.decode(target, source)), size)
            cycle = np.rot90(cycle, -roll)
        axis = np.arange(INPUT_SIZE, dtype=np.float64)
        return CorrespondenceMap(
            map=_to_original(np.rot90(place[0].cpu().numpy(), -roll), image1.size),
            grid=_to_original(np.stack(np.meshgrid(axis, axis), -1), image2.size),
            matchability=np.ascontiguousarray(np.rot90(_matchability(there), -roll)),
            size1=image1.size,
            size2=image2.size,
            cycle=cycle,
        )

    def _input(self, image: np.ndarray) -> Tensor:
        pixels = torch.from_numpy(resize(image, (INPUT_SIZE, INPUT_SIZE)))
        device = next(self.net.parameters()).device
        planes = pixels.to(device).permute(2, 0, 1)[None].float() / 255
        return normalise(planes).contiguous(memory_format=torch.channels_last)

    def _cells(self, prediction: Prediction) -> Tensor:
        """The finest map (1, S, S, 2) in cells of the source."""
        size = (INPUT_SIZE, INPUT_SIZE)
        place = prediction.maps[-1].movedim(1, -1).float()
        return to_pixels(place.nan_to_num(-2.0), size, self.net.config.align_corners)

    def _cycle(self, there: Tensor, back: Tensor, size2: tuple[int, int]) -> np.ndarray:
        """How far each cell of image 2 (size2) comes back off, in its pixels: (S, S)."""
        normalised = 2 * there / (INPUT_SIZE - 1) - 1
        sampled = F.grid_sample(back.movedim(-1, 1), normalised, align_corners=True)
        returned = sampled[0].movedim(0, -1).cpu().numpy()
        axis = np.arange(INPUT_SIZE, dtype=np.float32)
        off = returned - np.stack(np.meshgrid(axis, axis), -1)
        return np.linalg.norm(off * np.divide(size2, INPUT_SIZE), axis=-1).astype(np.float32)


def load_matcher(
    weights: str | Path = DEFAULT,
    *,
    device: str = "auto",
    options: MatchingOptions | None = None,
) -> DenseMatcher:
    """A matcher with shipped weights, by name, or with those of a file (see `load_network`).

    Raises WeightsError where the weights cannot be had, InputError where the device cannot.
    """
    return DenseMatcher(load_network(weights, choose_device(device)), options)


def resize(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """An image (H, W, 3) at `size` (width, height): means of areas where it shrinks, else bilinear.

    Both keep the outer edges of the image in place, as the half-pixel rule wants.
    """
    height, width = pixels.shape[:2]
    shrunk = (min(size[0], width), min(size[1], height))
    if shrunk != (width, height):
        pixels = cv2.resize(pixels, shrunk, interpolation=cv2.INTER_AREA)
    if shrunk != size:
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR)
    return pixels


def _to_original(cells: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Places in cells of the 240 grid to pixels of the original image, by the half-pixel rule."""
    scale = np.divide(size, INPUT_SIZE)
    return ((cells + 0.5) * scale - 0.5).astype(np.float32)


def _matchability(prediction: Prediction) -> np.ndarray:
    if not prediction.logits:
        return np.ones((INPUT_SIZE, INPUT_SIZE), np.float32)
    return prediction.logits[-1][0, 0].float().sigmoid().cpu().numpy()
