from __future__ import annotations

import os

import pytest

from dgc_pose.benchmarks.pool import pose_pool
from dgc_pose.benchmarks.scores import PairScore
from dgc_pose.errors import DgcPoseError


class Abort:
    """A job that ends the process that it is sent to."""

    def __reduce__(self):
        return os.abort, ()


def test_how_a_process_ended_is_told():
    with (
        pytest.raises(DgcPoseError, match="a process that estimates poses ended: signal 6, Abort"),
        pose_pool(PairScore, 2) as submit,
    ):
        submit(Abort()).result()
