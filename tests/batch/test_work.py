"""The worker: pairs are matched as one at a time, whatever it keeps of images."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from batch_runs import view_folder
from multi_view import SIZE, K

from dgc_pose.batch.rows import row_of
from dgc_pose.batch.work import FEATURE_BYTES, Estimate, Job, Match, Matched, Worker
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import load_image
from dgc_pose.matchers import MatcherOptions, load_matcher
from dgc_pose.pose import solve_pair

COUNT = 3
NAMES = tuple(f"view{i}.png" for i in range(COUNT))
PAIRS = tuple(combinations(NAMES, 2))
ESTIMATION = EstimationOptions(runs=1, iterations=300)
IMAGE_BYTES = 3 * SIZE[0] * SIZE[1] + FEATURE_BYTES


def _worker(photos: Path, memory_bytes: int) -> tuple[Worker, Matched]:
    """A worker that has matched all pairs."""
    cameras = {name: Camera(K, SIZE) for name in NAMES}
    worker = Worker(Job(photos, cameras, {}, MatcherOptions(), ESTIMATION, memory_bytes))
    outcome = worker.do(Match(tuple(range(len(PAIRS))), PAIRS))
    assert isinstance(outcome, Matched)
    return worker, outcome


def test_a_pair_is_matched_as_alone_and_an_image_is_encoded_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit, with memory for all images and for hardly one, and matches that are searched
    again as of a pose in doubt."""
    monkeypatch.setattr("dgc_pose.schedule.in_doubt", lambda *arguments: True)
    view_folder(tmp_path, COUNT)
    ample, matched = _worker(tmp_path, COUNT * IMAGE_BYTES)
    # Of the map and of native resolution, its texture, and squeezed along either axis.
    assert ample.cache.made == 5 * COUNT
    scarce, again = _worker(tmp_path, IMAGE_BYTES)
    assert scarce.cache.made > 5 * COUNT
    assert matched.rows == again.rows and all(row.success for row in matched.rows)
    matcher = load_matcher()
    first = matcher.match(*(load_image(tmp_path / name) for name in PAIRS[0]))
    assert len(first.matches) < len(matched.matches[0].scores)
    for k, names in enumerate(PAIRS):
        images, camera = (load_image(tmp_path / name) for name in names), Camera(K, SIZE)
        alone = solve_pair(*images, (camera, camera), matcher, ESTIMATION)
        assert matched.rows[k] == row_of(names, alone.pose, alone.matches.error_px)
        for stored in (matched.matches[k], again.matches[k]):
            expected = alone.matches.points1.astype(np.float32)
            np.testing.assert_array_equal(stored.points1, expected)


def test_a_pose_that_is_estimated_again_has_its_probability(tmp_path: Path) -> None:
    """What is stored of a pair does not state the network that matched it, the job does."""
    view_folder(tmp_path, COUNT)
    camera = replace(Camera(K, SIZE), focal_std=0.05)
    job = Job(tmp_path, {n: camera for n in NAMES}, {}, MatcherOptions(), ESTIMATION, 2**30)
    worker = Worker(job)
    matched = worker.do(Match((0,), PAIRS[:1]))
    assert isinstance(matched, Matched)
    again = worker.do(Estimate(matched, job.cameras, True))
    assert isinstance(again, Matched)
    (before,), (after,) = matched.rows, again.rows
    assert after.success and after.num_matches == before.num_matches
    assert after.probability == pytest.approx(before.probability, abs=1e-3)
    np.testing.assert_allclose(after.R, before.R, atol=1e-4)
