"""Noise and colours of the procedural textures."""

from __future__ import annotations

import colorsys

import numpy as np
import torch
from torch.nn.functional import interpolate

_HUES = (0.02, 0.06, 0.09, 0.12, 0.15, 0.28, 0.35, 0.55, 0.6, 0.65)  # earth, plants, sky


def fractal_noise(
    rng: np.random.Generator,
    size: int,
    *,
    first: int,
    octaves: int = 5,
    persistence: float = 0.6,
    stretch: int = 1,
) -> np.ndarray:
    """Smooth noise (size, size) of mean 0 and deviation 1.

    first: cells of the coarsest octave across the image; each further octave has twice as many.
    persistence: amplitude of an octave over the one before. stretch: how much longer cells are
    down the image than across.
    """
    total = np.zeros((size, size))
    cells, amplitude = first, 1.0
    for _ in range(octaves):
        if cells > size:
            break
        knots = rng.standard_normal((max(1, cells // stretch) + 1, cells + 1))
        smooth = interpolate(
            torch.from_numpy(knots)[None, None], (size, size), mode="bicubic", align_corners=True
        )
        total += amplitude * smooth[0, 0].numpy()
        cells, amplitude = 2 * cells, amplitude * persistence
    return (total - total.mean()) / total.std()


def grain(rng: np.random.Generator, size: int) -> np.ndarray:
    """Fine noise (size, size), so that no surface is without detail."""
    return fractal_noise(rng, size, first=max(2, size // 8), octaves=2, persistence=0.8)


def ramp(values: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Colours (..., 3) along a row of colours (k, 3); values 0 and 1 are its ends."""
    stops = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(values, stops, colours[:, k]) for k in range(3)], axis=-1)


def shades(
    rng: np.random.Generator, count: int, *, hue: float | None = None, saturation: float = 0.45
) -> np.ndarray:
    """`count` colours (count, 3) around one hue, from dark to bright; some are of another hue."""
    base = float(rng.choice(_HUES)) if hue is None else hue
    colours = []
    for _ in range(count):
        shifted = base + 0.06 * rng.standard_normal() + (0.5 if rng.uniform() < 0.15 else 0.0)
        strength = float(np.clip(saturation * rng.uniform(0.4, 1.5), 0, 1))
        colours.append(colorsys.hsv_to_rgb(shifted % 1, strength, rng.uniform(0.25, 0.95)))
    return np.array(colours)
