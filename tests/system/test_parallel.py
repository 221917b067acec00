"""Work in threads is the same work: its order, its errors, and what is made of it."""

import signal
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import NoReturn

import cv2
import numpy as np
import pytest
from scenes import two_view_scene
from threadpoolctl import threadpool_info, threadpool_limits

from dgc_pose import (
    Image,
    Matcher,
    Matches,
    estimate_pose,
    solve_pair,
)
from dgc_pose.system.parallel import in_threads, one_blas_thread


@pytest.fixture(autouse=True)
def threads_as_before() -> Iterator[None]:
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def test_work_is_side_by_side_in_as_many_threads_as_opencv_has() -> None:
    """And work within it in turn."""
    cv2.setNumThreads(3)
    assert in_threads(lambda x: x * x, range(7)) == [x * x for x in range(7)]
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda x: 1 // x, [1, 0, 1])
    together = threading.Barrier(3, timeout=20)
    assert sorted(in_threads(lambda _: together.wait(), range(3))) == [0, 1, 2]

    def inner(_: int) -> set[int]:
        return set(in_threads(lambda _: threading.get_ident(), range(3)))

    assert all(len(within) == 1 for within in in_threads(inner, range(3)))
    assert len(in_threads(lambda _: in_threads(inner, range(2)), range(1))[0]) == 2  # by its own
    cv2.setNumThreads(1)
    assert len(inner(0)) == 1


@pytest.mark.usefixtures("default_signals")
def test_an_interrupt_does_not_wait_for_the_work() -> None:
    """As in a long call of a library, which handles no signal."""
    cv2.setNumThreads(2)
    begun, ended = threading.Event(), threading.Event()

    def work(item: int) -> None:
        if item == 0:
            begun.set()
            signal.raise_signal(signal.SIGINT)
        ended.wait(60)

    with pytest.raises(KeyboardInterrupt):
        in_threads(work, range(2))
    assert begun.is_set() and not ended.is_set()
    ended.set()


def test_a_pose_is_the_same_for_any_number_of_threads() -> None:
    scene = two_view_scene("general", count=400, outliers=0.4)
    matches = Matches(scene.points1, scene.points2, np.ones(400), error_px=0.5)
    poses = []
    for threads in (1, 4):
        cv2.setNumThreads(threads)
        poses.append(replace(estimate_pose(matches, *scene.cameras), seconds={}))
    assert poses[0].success
    assert np.array_equal(poses[0].R, poses[1].R) and np.array_equal(poses[0].t, poses[1].t)
    assert np.array_equal(poses[0].inliers, poses[1].inliers)


def _blas_threads() -> set[int]:
    """Of NumPy's BLAS, or of all where NumPy does not bring its own."""
    pools = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    own = [pool for pool in pools if "numpy" in pool["filepath"]]
    return {int(pool["num_threads"]) for pool in own or pools}


def test_products_run_in_one_thread_and_then_in_as_many_as_before() -> None:
    with threadpool_limits(limits=2, user_api="blas"):
        assert one_blas_thread()(_blas_threads)() == {1} and _blas_threads() == {2}
        assert in_threads(lambda _: one_blas_thread()(_blas_threads)(), range(2)) == [{2}, {2}]


def test_the_products_of_a_pose_run_in_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    def seen(*_: object, **__: object) -> NoReturn:
        raise RuntimeError(f"{_blas_threads()}")

    scene = two_view_scene("general", count=60)
    first, second = (Image(np.zeros((48, 64, 3), np.uint8)) for _ in range(2))
    monkeypatch.setattr(Matcher, "_match", seen)
    with (
        threadpool_limits(limits=2, user_api="blas"),
        pytest.raises(RuntimeError, match=r"^\{1\}$"),
    ):
        solve_pair(first, second, scene.cameras, Matcher())
