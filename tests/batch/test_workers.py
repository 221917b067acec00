"""Workers of this machine and of Ray: the same result, what they raise, and how they end."""

import multiprocessing
import os
import signal
from contextlib import contextmanager
from functools import lru_cache

import numpy as np
import pytest
from batch_runs import assert_same_result, run_sift

from dgc_pose.batch.pair_choice import parse_pair_choice
from dgc_pose.batch.source import STORE
from dgc_pose.batch.work import Job, Worker
from dgc_pose.batch.workers import CoreWorker, local_workers, ray_workers, tile_order
from dgc_pose.errors import DgcPoseError, WeightsError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions


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
    with pytest.raises(DgcPoseError, match=r"^a worker process ended \(SIGKILL\): resume goes on"):
        run_sift(views, out, workers=2, start_workers=_killing)
    assert (out / STORE).exists()


def test_what_a_worker_raises_is_raised_here(views, monkeypatch):
    """Not the end of a process: here the weights are gone once the processes start."""
    monkeypatch.setattr(MatcherOptions, "load", lambda self, cache=None: None)  # in this process
    job = Job(views, {}, {}, MatcherOptions("gone.safetensors"), EstimationOptions(), 2**20)
    with pytest.raises(WeightsError, match="gone.safetensors"), local_workers(job, 2) as run:
        list(run(Worker.describe, [(["view0.png"],), (["view1.png"],)]))


def test_on_ray_the_result_is_the_same_and_an_actor_that_ends_ends_the_batch(
    views, tmp_path, monkeypatch
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

    run_sift(views, tmp_path / "local", workers=2)
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        out = tmp_path / "ray"
        with monkeypatch.context() as patch, pytest.raises(DgcPoseError, match="worker of Ray end"):
            patch.setattr("dgc_pose.batch.workers.CoreWorker", Ending)
            run_sift(views, out, workers=2, start_workers=ray_workers)
        batch = run_sift(views, out, workers=2, start_workers=ray_workers, resume=True)
        assert 0 < batch.summary["matched_now"] < 6
        assert_same_result(tmp_path / "local", out)
        assert ray.is_initialized()
    finally:
        ray.shutdown()


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
