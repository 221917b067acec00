"""Objects for a worker's process."""

import os
import time

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.serve.worker import Report


class Tasks:
    """What a worker can be asked for."""

    def add(self, report: Report, one: int, two: int) -> int:
        report(f"adding {one}")
        report(f"and {two}")
        return one + two

    def process(self, report: Report) -> int:
        return os.getpid()

    def hang(self, report: Report) -> None:
        report("hanging")
        while True:
            time.sleep(60)

    def crash(self, report: Report) -> None:
        os.abort()

    def refuse(self, report: Report) -> None:
        raise InputError("this\n will not do")

    def fail(self, report: Report) -> None:
        raise ZeroDivisionError

    def fill(self, report: Report, count: int) -> int:
        return len(bytearray(count))


def no_tasks() -> Tasks:
    raise WeightsError("no such weights")


def broken_tasks() -> Tasks:
    raise KeyError("a library's own error")
