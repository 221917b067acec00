"""The worker: pairs are matched as one at a time, whatever it keeps of images."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from batch_runs import view_folder
from multi_view import SIZE, K

from dgc_pose.batch.rows import MatchedPair, PairRow, row_of
from dgc_pose.batch.work import FEATURE_BYTES, Job, Worker
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.images.image import load_image
from dgc_pose.matchers import MatcherOptions, load_matcher
from dgc_pose.matches import Matches
from dgc_pose.pose import solve_pair

COUNT = 3
NAMES = tuple(f"view{i}.png" for i in range(COUNT))
PAIRS = tuple(enumerate(combinations(NAMES, 2)))
ESTIMATION = EstimationOptions(runs=1, iterations=300)
CAMERA = Camera(K, SIZE)
IMAGE_BYTES = 3 * SIZE[0] * SIZE[1] + FEATURE_BYTES


def _worker(photos, memory_bytes):
    """A worker that has matched all pairs."""
    cameras = dict.fromkeys(NAMES, CAMERA)
    worker = Worker(Job(photos, cameras, {}, MatcherOptions(), ESTIMATION, memory_bytes))
    return worker, worker.match(PAIRS)


def test_a_pair_is_matched_as_alone_and_an_image_is_encoded_once(tmp_path, monkeypatch):
    """To the bit, with memory for all images and for hardly one, and matches that are searched
    again as of a pose in doubt."""
    monkeypatch.setattr("dgc_pose.pose.in_doubt", lambda *arguments: True)
    view_folder(tmp_path, COUNT)
    ample, matched = _worker(tmp_path, COUNT * IMAGE_BYTES)
    # Of the map and of native resolution, its texture, and squeezed along either axis.
    assert ample.cache.made == 5 * COUNT
    scarce, again = _worker(tmp_path, IMAGE_BYTES)
    assert scarce.cache.made > 5 * COUNT
    assert all(pair.row.success for pair in matched)
    matcher = load_matcher()
    first = matcher.match(*(load_image(tmp_path / name) for name in PAIRS[0][1]))
    assert len(first.matches) < len(matched[0].matches)
    for k, names in PAIRS:
        images = (load_image(tmp_path / name) for name in names)
        alone = solve_pair(*images, (CAMERA, CAMERA), matcher, ESTIMATION)
        row = row_of(names, alone.pose, alone.matches.error_px)
        for pair in (matched[k], again[k]):
            assert pair.row.to_json() == row.to_json()
            np.testing.assert_array_equal(pair.matches.points1, alone.matches.points1)


def test_a_pose_that_is_estimated_again_has_its_probability(tmp_path):
    """What is stored of a pair does not state the network that matched it, the job does."""
    view_folder(tmp_path, COUNT)
    camera = replace(CAMERA, focal_std=0.05)
    job = Job(tmp_path, {n: camera for n in NAMES}, {}, MatcherOptions(), ESTIMATION, 2**30)
    worker = Worker(job)
    matched = worker.match(PAIRS[:1])
    (before,), (after,) = matched, worker.estimate(matched, job.cameras, fit_cameras=True)
    assert after.row.success and after.row.num_matches == before.row.num_matches
    assert after.row.probability == pytest.approx(before.row.probability, abs=1e-3)
    assert before.row.pose is not None and after.row.pose is not None
    np.testing.assert_allclose(after.row.pose.R, before.row.pose.R, atol=1e-4)


@pytest.mark.parametrize(
    ("identities", "fitted"), [("aa", False), ("ab", True), ([None] * 2, True)]
)
def test_two_cameras_are_fitted_anew_unless_they_are_one(tmp_path, monkeypatch, identities, fitted):
    """A camera without an identity is one of its own."""
    asked = []
    pose = RelativePose("no_model", "", np.zeros(1, bool), 1)

    def estimated(*arguments, fit_cameras, **more):
        asked.append(fit_cameras)
        return pose

    monkeypatch.setattr("dgc_pose.batch.work.estimate_pose", estimated)
    cameras = {
        name: replace(CAMERA, focal_std=0.03, identity=identity)
        for name, identity in zip(NAMES, identities, strict=False)
    }
    job = Job(tmp_path, cameras, {}, MatcherOptions(weights="sift"), ESTIMATION, 2**30)
    matches = Matches(np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1), 1.0)
    pair = MatchedPair(PairRow(*NAMES[:2], "no_model", "", pose), matches)
    Worker(job).estimate([pair], cameras, fit_cameras=False)
    assert asked == [fitted]
