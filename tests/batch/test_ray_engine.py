"""The batch on Ray: the local result, also if a worker is killed while it runs."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
from batch_runs import assert_same_result, run_sift, view_folder

from dgc_pose.batch.local import RunTasks
from dgc_pose.batch.work import Job, Outcome, Task

ray = pytest.importorskip("ray")

from dgc_pose.batch.ray_engine import ray_workers  # noqa: E402


@pytest.fixture
def cluster() -> Iterator[None]:
    """Ray on this machine. It waits 30 s for its own start, which a busy machine may exceed."""
    for remaining in (2, 1, 0):
        try:
            ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
            break
        except Exception:  # of no class of Ray's
            ray.shutdown()
            if not remaining:
                raise
    yield
    ray.shutdown()


@contextmanager
def _one_is_killed(job: Job, workers: int) -> Iterator[RunTasks]:
    """Actors of which one is killed after the first outcome, as by a lack of memory."""
    with ray_workers(job, workers) as run:

        def killing(tasks: Sequence[Task]) -> Iterator[Outcome]:
            for number, outcome in enumerate(run(tasks)):
                if number == 0:
                    name = ray.util.list_named_actors()[0]
                    ray.kill(ray.get_actor(name), no_restart=False)
                    killed.append(name)
                yield outcome

        killed: list[str] = []
        yield killing
        assert killed


@pytest.mark.usefixtures("cluster")
def test_two_workers_one_of_them_killed(tmp_path: Path) -> None:
    """A cluster that was there before stays."""
    photos = tmp_path / "photos"
    view_folder(photos, 4)
    run_sift(photos, tmp_path / "local")
    run_sift(photos, tmp_path / "ray", workers=2, start_workers=_one_is_killed)
    assert_same_result(tmp_path / "local", tmp_path / "ray")
    assert ray.is_initialized()
