"""Pools of processes, and how processes ended, in words."""

import multiprocessing
import os
import signal
import time

import pytest

from dgc_pose.errors import DgcPoseError
from dgc_pose.system.processes import process_end, process_ends, process_pools


def _killed(number: int) -> multiprocessing.process.BaseProcess:
    process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600,))
    process.start()
    assert process.pid is not None
    os.kill(process.pid, number)
    process.join()
    return process


def test_a_sigterm_beside_another_end_is_left_out() -> None:
    killed, stopped = _killed(signal.SIGKILL), _killed(signal.SIGTERM)
    assert process_ends([killed, stopped]) == process_end(-signal.SIGKILL)
    assert process_ends([stopped]) == process_end(-signal.SIGTERM)
    assert process_ends([]) == ""


def test_how_the_process_of_a_pool_ended_is_told() -> None:
    with (
        pytest.raises(DgcPoseError, match=r"^a worker process ended \(signal 6, Abort"),
        process_pools([1, 1]) as submit,
    ):
        submit(1, time.sleep, 600)
        submit(0, os.abort).result()
