"""Batches of rendered views with SIFT, for tests in which the network is not the point."""

from contextlib import contextmanager
from itertools import count

import cv2
import numpy as np
import pytest
from worlds import SIZE, K_text, render_views, write_views

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.run import run_batch
from dgc_pose.batch.source import open_source, parse_pair_choice
from dgc_pose.batch.store import open_store
from dgc_pose.batch.workers import local_workers
from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions

VIEWS_K = K_text()
SIFT, QUICK = MatcherOptions("sift"), EstimationOptions(runs=1, iterations=300)


def view_folder(folder, number=4):
    """Rendered views in a folder."""
    views = render_views(number)
    write_views(folder, views)
    return views


def write_masks(folder, names, share=0.5):
    """Masks of photographs of `worlds.SIZE`, black in a share on the left."""
    for name in names:
        mask = np.full(SIZE[::-1], 255, np.uint8)
        mask[:, : round(share * SIZE[0])] = 0
        path = folder / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), mask)


def run_sift(
    source,
    out,
    *,
    pairs="exhaustive",
    K=VIEWS_K,
    root=None,
    masks=None,
    resume=False,
    matcher=SIFT,
    estimation=QUICK,
    workers=1,
    engine="local",
    start_workers=local_workers,
):
    """A batch, by default with SIFT and the K of the rendered views."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dgc_pose.batch.run.local_workers", start_workers)
        return run_batch(
            open_source(source, root, masks),
            read_calibration(K, "--K"),  # as the command names it
            None if pairs is None else parse_pair_choice(pairs),
            out,
            matcher=matcher,
            estimation=estimation,
            options=BatchOptions(workers=workers, engine=engine, resume=resume),
        )


class Killed(Exception):
    """What stands for a kill in this process."""


def killed_after(tasks_done):
    """Workers that end after so many tasks, however often tasks are run."""

    @contextmanager
    def start(job, workers):
        numbers = count()
        with local_workers(job, workers) as run:

            def some(*work):
                for outcome in run(*work):
                    if next(numbers) == tasks_done:
                        raise Killed
                    yield outcome

            yield some

    return start


def assert_same_result(out1, out2):
    """The rows, cameras and matches of two batches are the same to the bit."""
    for name in ("pairs.jsonl", "matches.h5", "cameras.csv"):
        one, other = (out / name for out in (out1, out2))
        if name == "cameras.csv" and not one.exists():  # K is known
            assert not other.exists()
        else:
            assert one.read_bytes() == other.read_bytes()


def change_result(out, change):
    """Put other pairs in the place of those of the result of a batch."""
    with open_store(out) as store, store.change():
        pairs = [change(pair) for pair in store.pairs("result")]
        store._database.execute("DELETE FROM result")
        store.add("result", pairs)
