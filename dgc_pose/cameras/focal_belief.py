"""What is known of a focal length that no K states: the usual one, a tail of others, and what the
lines of the images state."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

# Logarithms of the focal lengths that lines are evidence of, over the longer side.
LOG_FOCALS = np.linspace(math.log(0.3), math.log(8.0), 42)
_LOGS = np.arange(math.log(0.1), math.log(25.0), 0.01)  # of f over the longer side


class Part(NamedTuple):
    """A normal distribution of ln f, f over the longer side of the image."""

    log_weight: float  # logarithm of its probability, up to a constant
    log_focal: float
    std: float

    def given(self, lines: np.ndarray) -> Part:
        """The part after the lines of images, whose log-likelihoods (G,) are of `LOG_FOCALS`; its
        weight has the evidence."""
        odds = np.interp(_LOGS, LOG_FOCALS, lines)
        odds -= ((_LOGS - self.log_focal) / self.std) ** 2 / 2
        density = np.exp(odds - odds.max())
        total = float(density.sum())
        mean = float(density @ _LOGS) / total
        std = math.sqrt(float(density @ (_LOGS - mean) ** 2) / total)
        evidence = float(odds.max()) + math.log(total * (_LOGS[1] - _LOGS[0]) / self.std)
        return Part(self.log_weight + evidence - math.log(2 * math.pi) / 2, mean, std)


@dataclass(frozen=True, eq=False)
class FocalBelief:
    """The distribution of ln f before the matches, and the lines of the camera's image."""

    usual: Part  # by EXIF data, or of most photographs
    tail: Part  # of other lenses; of a file whose EXIF data are of another image
    lines: np.ndarray  # (G,) log-likelihoods of `LOG_FOCALS`

    def parts(self, lines: Sequence[np.ndarray]) -> tuple[Part, Part]:
        """The parts, the likelier first, by the lines (G,) of all images of the camera. Lines of
        many images of one place err alike: they count by the root of their number."""
        of_all = np.sum(lines, axis=0) / math.sqrt(max(1.0, len(lines) / 2))
        first, second = sorted(
            (part.given(of_all) for part in (self.usual, self.tail)),
            key=lambda part: -part.log_weight,
        )
        return first, second
