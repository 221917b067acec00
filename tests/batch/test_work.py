"""The worker: what it keeps of images, and that pairs are matched as one at a time."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from batch_runs import view_folder
from multi_view import SIZE, K

from dgc_pose.batch.rows import row_of
from dgc_pose.batch.work import FEATURE_BYTES, Job, Match, Matched, Worker
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.images.image import load_image
from dgc_pose.matchers import MatcherOptions, load_matcher

COUNT = 3
NAMES = tuple(f"view{i}.png" for i in range(COUNT))
PAIRS = tuple(combinations(NAMES, 2))
ESTIMATION = EstimationOptions(runs=1, iterations=300)
IMAGE_BYTES = 3 * SIZE[0] * SIZE[1] + FEATURE_BYTES


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    view_folder(folder, COUNT)
    return folder


def _worker(photos: Path, memory_bytes: int) -> tuple[Worker, Matched]:
    """A worker that has matched all pairs."""
    cameras = {name: Camera(K, SIZE) for name in NAMES}
    worker = Worker(Job(photos, cameras, {}, MatcherOptions(), ESTIMATION, memory_bytes))
    outcome = worker.do(Match(tuple(range(len(PAIRS))), PAIRS))
    assert isinstance(outcome, Matched)
    return worker, outcome


def test_a_pair_is_matched_as_alone_and_an_image_is_encoded_once(photos: Path) -> None:
    """To the bit, with memory for all images and for hardly one."""
    worker, found = _worker(photos, COUNT * IMAGE_BYTES)
    assert worker.caches.features.made == worker.caches.native.made == COUNT
    scarce, again = _worker(photos, IMAGE_BYTES)
    assert scarce.caches.features.made > COUNT
    plain = load_matcher()
    for names, row, matches, other_row, other in zip(
        PAIRS, found.rows, found.matches, again.rows, again.matches, strict=True
    ):
        alone = plain.match(*(load_image(photos / name) for name in names))
        camera = Camera(K, SIZE)
        pose = estimate_pose(
            alone.matches, camera, camera, ESTIMATION, map_matches=alone.map_matches
        )
        assert row == other_row == row_of(names, pose, alone.matches.error_px, False)
        assert row.success
        expected = alone.matches.points1.astype(np.float32)
        np.testing.assert_array_equal(matches.points1, expected)
        np.testing.assert_array_equal(other.points1, expected)


def test_features_of_an_image_that_is_dropped_are_dropped(photos: Path) -> None:
    """They would keep its pixels in memory."""
    worker, _ = _worker(photos, 2 * IMAGE_BYTES)
    assert worker._images.held_bytes == 2 * IMAGE_BYTES
    kept = {worker._images.get(name, lambda: "none") for name in PAIRS[-1]}
    for cache in (worker.caches.features, worker.caches.native):
        assert {key[0] for key in cache._kept} == kept
    assert "none" not in kept
