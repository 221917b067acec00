"""Pools of processes, and how processes ended, in words."""

import os
import signal
import time

import pytest

from dgc_pose.errors import DgcPoseError
from dgc_pose.system.processes import process_end, process_pools


@pytest.mark.parametrize(
    ("codes", "words"),
    [
        ((3,), "exit code 3"),
        ((-6,), f"signal 6, {signal.strsignal(6)}"),
        ((-9, -15), f"signal 9, {signal.strsignal(9)}"),
        ((-15,), f"signal 15, {signal.strsignal(15)}"),
        ((), ""),
    ],
)
def test_a_sigterm_beside_another_end_is_left_out(codes: tuple[int, ...], words: str) -> None:
    assert process_end(*codes) == words


def test_how_the_process_of_a_pool_ended_is_told() -> None:
    with (
        pytest.raises(DgcPoseError, match=r"^a worker process ended \(signal 6, Abort"),
        process_pools([1, 1]) as submit,
    ):
        submit(1, time.sleep, 600)
        submit(0, os.abort).result()
