"""The comparison of the two runtimes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgc_pose.benchmarks.pair_list import bundled_pair
from dgc_pose.benchmarks.runtimes import Difference, differences, row, summary


def test_the_runtimes_agree_on_the_bundled_pair() -> None:
    (found,) = differences("dgcm-lite0", [bundled_pair()])
    assert 0 < found.map_px < 1e-2 and found.matchability < 1e-2
    assert found.status == ("ok", "ok") and min(found.matches) > 100
    assert found.pose_deg is not None and max(found.pose_deg) < 0.01
    assert row(found).startswith("image1.jpg image2.jpg: map ")


def test_the_summary_counts_poses_apart_and_other_statuses() -> None:
    same = Difference("a", "b", 1e-4, 1e-5, (9, 9), ("ok", "ok"), (0.001, 0.002))
    apart = replace(same, pose_deg=(0.001, 0.5), map_px=3e-4)
    none = replace(same, pose_deg=None, status=("ok", "no_model"))
    text = summary([same, apart, none])
    assert "1 of 2 poses within 0.01 degrees" in text and "differs in 1 of 3 pairs" in text
    values = {line.split("  ")[0]: line.split()[-2:] for line in text.splitlines()[1:5]}
    assert [float(v) for v in values["translation, deg"]] == pytest.approx([0.25, 0.5], abs=0.01)
    assert float(values["map, px"][1]) == np.max([one.map_px for one in (same, apart, none)])
    assert "no pose" in row(none)
