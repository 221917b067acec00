"""Images that no pose can be found from: blank, smooth, noise, stripes."""

from __future__ import annotations

from typing import Literal, get_args

import cv2
import numpy as np

BlankKind = Literal["even", "gradient", "vignette", "noise", "lens cap", "stripes", "sky"]
BLANKS: tuple[BlankKind, ...] = get_args(BlankKind)


def blank(kind: BlankKind, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """An image (H, W, 3) uint8 of `size` (width, height), as a camera stores it: as JPEG."""
    width, height = size
    y, x = np.mgrid[:height, :width] / max(size)
    angle = rng.uniform(0, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    if kind == "even":
        grey = np.full((height, width), rng.choice([0.0, 255.0, rng.uniform(0, 255)]))
    elif kind == "gradient":
        grey = rng.uniform(0, 128) + rng.uniform(10, 127) * (1 + along) / 2
    elif kind == "vignette":
        squared = (x - x.mean()) ** 2 + (y - y.mean()) ** 2
        grey = rng.uniform(60, 250) * np.exp(-rng.uniform(0.3, 2) * squared)
    elif kind == "noise":
        grey = 128 + rng.uniform(5, 60) * rng.standard_normal((height, width))
    elif kind == "lens cap":
        grey = rng.uniform(0, 4) + rng.uniform(0.5, 6) * rng.standard_normal((height, width))
    elif kind == "stripes":
        wave = np.sin(2 * np.pi * rng.uniform(8, 60) * along)
        grey = 128 + rng.uniform(20, 120) * (wave if rng.random() < 0.5 else np.sign(wave))
    else:  # burnt-out above, a smooth field below
        horizon = height * rng.uniform(0.3, 0.7) + 0.05 * width * (x - 0.5)
        grey = np.where(y * max(size) < horizon, 255.0, rng.uniform(20, 120) + 40 * y)
    tint = rng.uniform(0.8, 1.0, 3)
    pixels = (grey[..., None] * tint).clip(0, 255).round().astype(np.uint8)
    quality = int(rng.integers(60, 100))
    encoded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.ascontiguousarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))
