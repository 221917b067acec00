"""The camera files of MVSNet and those who followed it, as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dgc_pose.errors import InputError


def parse_cam(text: str, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The camera-from-world matrix (4, 4) and K (3, 3), float64, of a `NNNNNNNN_cam.txt`.

    The file holds the word `extrinsic`, a 4x4 matrix, the word `intrinsic`, a 3x3 one, and a line
    of depth limits, which is passed over. Raises InputError, naming `path`, where it does not.
    """
    words = text.split()
    if len(words) < 27 or words[0] != "extrinsic" or words[17] != "intrinsic":
        raise InputError(
            f"{path}: expected the word extrinsic, 4 rows of 4 numbers, "
            "the word intrinsic, 3 rows of 3 numbers"
        )
    return parse_matrix(words[1:17], (4, 4), path), parse_matrix(words[18:27], (3, 3), path)


def parse_matrix(words: Sequence[str], shape: tuple[int, int], path: Path) -> np.ndarray:
    """Words as a float64 matrix, row by row. Raises InputError, naming `path`, for other words."""
    try:
        return np.array([float(word) for word in words]).reshape(shape)
    except ValueError:
        raise InputError(f"{path}: expected numbers, found something else") from None
