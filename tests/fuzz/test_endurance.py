"""Many calls in one process, four threads at once: the same bits, and no memory that is kept."""

from concurrent.futures import ThreadPoolExecutor

import dense_scene
import numpy as np
import pytest
from fuzz.test_readers import resident
from hypothesis import settings

from dgc_pose import EstimationOptions, estimate_relative_pose, load_matcher

pytestmark = pytest.mark.slow

CALLS = settings.default.max_examples // 4
GROWTH = 100 * 2**20  # bytes; the first calls fill the libraries' own pools


def test_calls_keep_no_memory_and_give_the_same_bits() -> None:
    images, matcher = dense_scene.pictures(), load_matcher(refinement=None)
    options = EstimationOptions(runs=2, iterations=200)

    def digest(_: int) -> tuple[bytes, int]:
        pose = estimate_relative_pose(*images, dense_scene.K, matcher=matcher, options=options)
        arrays = (pose.R, pose.t, pose.inliers)
        return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays), resident(
            "VmRSS"
        )

    with ThreadPoolExecutor(4) as threads:
        digests, held = zip(*threads.map(digest, range(CALLS)), strict=True)
    assert len(set(digests)) == 1
    assert np.median(held[-CALLS // 4 :]) - np.median(held[CALLS // 4 : CALLS // 2]) < GROWTH
