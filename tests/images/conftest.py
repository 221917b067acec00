"""The picture that the tests write in every format."""

import cv2
import numpy as np
import pytest


@pytest.fixture
def rgb() -> np.ndarray:
    """Smooth enough to survive JPEG, and unlike itself under any flip or change of channels."""
    rng = np.random.default_rng(1)
    return cv2.resize(rng.integers(0, 256, (5, 7, 3), np.uint8), (70, 50))
