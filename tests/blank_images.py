"""Pairs of images that no pose may be made up from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dgc_pose.benchmarks.probability.blank import BLANKS, BlankKind, blank
from dgc_pose.images.image import Image

SIZE = (320, 240)


def blank_image(kind: BlankKind, seed: int = 0) -> Image:
    """A seeded image without structure."""
    return Image(blank(kind, SIZE, np.random.default_rng([seed, BLANKS.index(kind)])))


def blank_pairs(photograph: Image) -> Iterator[tuple[str, Image, Image]]:
    """Each kind with itself and with a photograph, and their names."""
    for kind in BLANKS:
        yield f"{kind}, identical", blank_image(kind), Image(blank_image(kind).pixels.copy())
        yield f"{kind}, photograph", blank_image(kind), photograph
