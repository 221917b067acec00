"""How processes ended, in words."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time

from dgc_pose.system.processes import process_end, process_ends


def _killed(number: int) -> multiprocessing.process.BaseProcess:
    process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600,))
    process.start()
    assert process.pid is not None
    os.kill(process.pid, number)
    process.join()
    return process


def test_exit_codes_and_signals() -> None:
    assert process_end(3) == "exit code 3"
    assert process_end(-signal.SIGABRT) == f"signal 6, {signal.strsignal(6)}"


def test_a_sigterm_beside_another_end_is_left_out() -> None:
    killed, stopped = _killed(signal.SIGKILL), _killed(signal.SIGTERM)
    assert process_ends([killed, stopped]) == process_end(-signal.SIGKILL)
    assert process_ends([stopped]) == process_end(-signal.SIGTERM)
    assert process_ends([]) == ""
