"""Workers: pairs are matched as one at a time, in this process, in others and on Ray; what they
raise, and how they end."""

import multiprocessing
import os
import signal
import sys
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest
from batch_runs import assert_same_result, run_sift
from worlds import SIZE, K

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.pairs import MatchedPair, PairRow, row_of
from dgc_pose.batch.source import STORE, parse_pair_choice
from dgc_pose.batch.workers import (
    FEATURE_BYTES,
    CoreWorker,
    Job,
    Worker,
    local_workers,
    ray_workers,
    tile_order,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import DgcPoseError, InputError, WeightsError
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.images.image import load_image
from dgc_pose.matchers import MatcherOptions, load_matcher
from dgc_pose.matches import Matches
from dgc_pose.pose import solve_pair

COUNT = 3
NAMES = tuple(f"view{i}.png" for i in range(COUNT))
PAIRS = tuple(enumerate(combinations(NAMES, 2)))[:2]
ESTIMATION = EstimationOptions(runs=1, iterations=300)
CAMERA = Camera(K, SIZE)
IMAGE_BYTES = 3 * SIZE[0] * SIZE[1] + FEATURE_BYTES


def _worker(photos, memory_bytes):
    """A worker that has matched all pairs."""
    cameras = dict.fromkeys(NAMES, CAMERA)
    worker = Worker(Job(photos, cameras, {}, MatcherOptions(), ESTIMATION, memory_bytes))
    return worker, worker.match(PAIRS)


def test_a_pair_is_matched_as_alone_and_an_image_is_encoded_once(views, monkeypatch):
    """To the bit, with memory for all images and for hardly one, and matches that are searched
    again as of a pose in doubt."""
    monkeypatch.setattr("dgc_pose.pose.in_doubt", lambda *arguments: True)
    ample, matched = _worker(views, COUNT * IMAGE_BYTES)
    # Of the map and of native resolution, its texture, and squeezed along either axis.
    assert ample.cache.made == 5 * COUNT
    scarce, again = _worker(views, IMAGE_BYTES)
    assert scarce.cache.made > 5 * COUNT
    assert all(pair.row.success for pair in matched)
    images = [load_image(views / name) for name in PAIRS[0][1]]
    matcher = load_matcher()
    assert len(matcher.match(*images).matches) < len(matched[0].matches)
    alone = solve_pair(*images, (CAMERA, CAMERA), matcher, ESTIMATION)
    row = row_of(PAIRS[0][1], alone.pose, alone.matches.error_px)
    assert matched[0].row.to_json() == row.to_json()
    for pair, other in zip(matched, [MatchedPair(row, alone.matches), *again[1:]], strict=True):
        assert pair.row.to_json() == other.row.to_json()
        np.testing.assert_array_equal(pair.matches.points1, other.matches.points1)


def test_a_pose_that_is_estimated_again_has_its_probability(views):
    """What is stored of a pair does not state the network that matched it, the job does."""
    camera = replace(CAMERA, focal_std=0.05)
    job = Job(views, dict.fromkeys(NAMES, camera), {}, MatcherOptions(), ESTIMATION, 2**30)
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

    monkeypatch.setattr("dgc_pose.batch.workers.estimate_pose", estimated)
    cameras = {
        name: replace(CAMERA, focal_std=0.03, identity=identity)
        for name, identity in zip(NAMES, identities, strict=False)
    }
    job = Job(tmp_path, cameras, {}, MatcherOptions(weights="sift"), ESTIMATION, 2**30)
    matches = Matches(np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1), 1.0)
    pair = MatchedPair(PairRow(*NAMES[:2], "no_model", "", pose), matches)
    Worker(job).estimate([pair], cameras, fit_cameras=False)
    assert asked == [fitted]


def test_a_matcher_that_cannot_be_loaded_leaves_nothing(views, tmp_path, capfd):
    """Before a process starts."""
    with pytest.raises(WeightsError, match="none.safetensors"):
        options = MatcherOptions("none.safetensors")
        run_sift(views, tmp_path / "out", matcher=options, workers=2)
    assert not (tmp_path / "out").exists()
    assert capfd.readouterr() == ("", "")


@contextmanager
def _killing(job, workers):
    """Workers of which each is killed after the first outcome."""
    others = set(multiprocessing.active_children())
    with local_workers(job, workers) as run:

        def some(*work):
            for outcome in run(*work):
                for process in set(multiprocessing.active_children()) - others:
                    os.kill(process.pid, signal.SIGKILL)
                yield outcome

        yield some


def test_a_worker_that_is_killed_is_told_by_its_signal(views, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(
        DgcPoseError, match=r"^a worker process ended \(SIGKILL\): resume continues"
    ):
        run_sift(views, out, workers=2, start_workers=_killing)
    assert (out / STORE).exists()


def test_what_a_worker_raises_is_raised_here(views, monkeypatch):
    """Not the end of a process: here the weights are gone once the processes start."""
    monkeypatch.setattr(MatcherOptions, "load", lambda self, cache=None: None)  # in this process
    job = Job(views, {}, {}, MatcherOptions("gone.safetensors"), EstimationOptions(), 2**20)
    with pytest.raises(WeightsError, match="gone.safetensors"), local_workers(job, 2) as run:
        list(run(Worker.describe, [(["view0.png"],), (["view1.png"],)]))


@pytest.mark.slow  # starts a cluster
def test_on_ray_the_result_is_the_same_and_an_actor_that_ends_ends_the_batch(
    views, whole, tmp_path, monkeypatch
):
    """The batch resumes after that. A cluster that was there before stays."""
    ray = pytest.importorskip("ray")

    class Ending:
        """An actor that ends at its second task; pickled with its code."""

        def __init__(self, job):
            self.worker, self.done = CoreWorker(job), 0

        def do(self, *task):
            if self.done:
                os._exit(1)
            self.done = 1
            return self.worker.do(*task)

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        out = tmp_path / "ray"
        with monkeypatch.context() as patch, pytest.raises(DgcPoseError, match="Ray worker end"):
            patch.setattr("dgc_pose.batch.workers.CoreWorker", Ending)
            run_sift(views, out, workers=2, start_workers=ray_workers)
        batch = run_sift(views, out, workers=2, start_workers=ray_workers, resume=True)
        assert 0 < batch.summary["matched_now"] < 6
        assert_same_result(whole, out)
        assert ray.is_initialized()
    finally:
        ray.shutdown()


def test_the_engine_starts_the_workers_and_ray_is_asked_for(views, whole, tmp_path, monkeypatch):
    """Without Ray too: nothing is written where it is missing."""
    started = []

    @contextmanager
    def start(job, workers):
        started.append(workers)
        with local_workers(job, 1) as run:
            yield run

    with monkeypatch.context() as patch:
        patch.setattr("dgc_pose.batch.run.ray_workers", start)
        run_sift(views, tmp_path / "ray", engine="ray", workers=3)
        run_sift(views, tmp_path / "local", engine="local", workers=2)
    assert started == [3]
    for folder in ("ray", "local"):
        assert_same_result(tmp_path / folder, whole)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(DgcPoseError, match="ray"):
        run_sift(views, tmp_path / "none", engine="ray")
    assert not (tmp_path / "none").exists()
    with pytest.raises(InputError, match="^engine must be one of local, ray, not 'spark'$"):
        BatchOptions(engine="spark")


@pytest.mark.parametrize(
    ("way", "count", "capacity", "loads"),
    [
        ("sequential:3", 60, 12, 60),
        # In tiles of 5 images, each of 8 tiles is loaded with each other: some 8 * 8 / 2 * 5.
        ("exhaustive", 40, 10, 200),
        ("exhaustive", 9, 1, 81),
        ("exhaustive", 1, 4, 0),
    ],
)
def test_pairs_are_worked_through_in_tiles(way: str, count: int, capacity: int, loads: int) -> None:
    pairs = np.array(parse_pair_choice(way).pairs(count), np.int64).reshape(-1, 2)
    pairs = np.random.default_rng(1).permutation(pairs)
    order = tile_order(pairs, capacity)
    assert sorted(order) == list(range(len(pairs)))
    load = lru_cache(capacity)(lambda image: None)
    for image in pairs[order].ravel().tolist():
        load(image)
    assert load.cache_info().misses <= loads
