from __future__ import annotations

import numpy as np
import pytest

from dgc_pose.metrics import Reliability
from dgc_pose.viz.reliability import plot_reliability


def test_shares_stand_over_the_mean_confidence_and_counts_below():
    confidence = np.array([0.02, 0.06, 0.55, 0.57, 0.53, 0.51])
    own = Reliability.of(confidence, np.array([False, False, True, True, True, False]))
    figure = plot_reliability({"net": own}, right="within 3 px")
    upper, lower = figure.axes
    diagonal, curve = upper.lines
    assert list(diagonal.get_xdata()) == list(diagonal.get_ydata()) == [0, 1]
    assert curve.get_xdata().tolist() == pytest.approx([0.04, 0.54])  # empty bins are left out
    assert curve.get_ydata().tolist() == pytest.approx([0, 0.75])
    error = 100 * (2 * 0.04 + 4 * 0.21) / 6
    assert curve.get_label() == f"net, calibration error {error:.1f} %"
    assert "within 3 px" in upper.get_ylabel()
    values, edges, _ = lower.patches[0].get_data()
    assert values[0] == pytest.approx(100 / 3) and values[5] == pytest.approx(200 / 3)
    assert len(edges) == 11
    figure.canvas.draw()


def test_nothing_to_draw_leaves_the_diagonal():
    figure = plot_reliability({}, right="within 3 px")
    assert len(figure.axes[0].lines) == 1
    figure.canvas.draw()
