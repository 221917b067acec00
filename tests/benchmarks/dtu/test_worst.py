from __future__ import annotations

import dtu_report
import numpy as np
import pytest

from dgc_pose.benchmarks.dtu.worst import plot_worst, worst_pairs


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return dtu_report.finished_run(tmp_path_factory.mktemp("run"), methods=("net",))


def test_failures_come_first_and_then_the_larger_of_both_errors(run) -> None:
    worst = worst_pairs(run.rows, 6)
    failed = [row.key for row in run.rows if not row.success]
    assert len(failed) == 2
    assert [row.key for row in worst[:2]] == sorted(failed)
    errors = {
        row.key: max(row.rotation_error_deg, row.translation_folded_deg)
        for row in run.rows
        if row.success
    }
    assert [row.key for row in worst[2:]] == sorted(errors, key=lambda key: -errors[key])[:4]


def test_fewer_pairs_than_asked_for(run) -> None:
    assert len(worst_pairs(run.rows[:3], 10)) == 3


@pytest.mark.parametrize("count", [1, 3])
def test_each_pair_is_drawn_with_its_matches(run, count) -> None:
    worst = worst_pairs(run.rows, count)
    pairs = run.pairs()
    shown = [pairs.by_key(row.key[1:]) for row in worst]
    samples = [run.samples[row.key] for row in worst]
    figure = plot_worst(worst, shown, samples)
    panels = [axes for axes in figure.axes if axes.axison]
    assert len(panels) == count
    for axes, row, sample in zip(panels, worst, samples, strict=True):
        segments = axes.collections[0].get_segments()
        assert np.allclose([segment[0] for segment in segments], sample.points1)
        colours = axes.collections[0].get_colors()
        assert (colours[sample.inliers] == colours[-1]).all()
        assert not np.allclose(colours[0], colours[-1])
        assert f"views {row.view1} and {row.view2}" in axes.get_title()
        assert ("no pose (no_model)" in axes.get_title()) == (not row.success)
    assert "native" in figure.get_suptitle()
