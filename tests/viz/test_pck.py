from __future__ import annotations

import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.viz.pck import plot_pck

ALPHAS = np.linspace(0.005, 0.1, 5)


def test_a_panel_a_group_and_a_curve_a_method():
    curves = {
        "I": {"a": np.linspace(0, 1, 5), "b": np.full(5, 0.5)},
        "II": {"a": np.full(5, np.nan), "b": np.full(5, 0.25)},
    }
    figure = plot_pck(curves, ALPHAS, distance="Euclidean")
    assert [axes.get_title() for axes in figure.axes] == ["I", "II"]
    first = figure.axes[0]
    assert first.lines[0].get_ydata().tolist() == pytest.approx([0, 25, 50, 75, 100])
    assert first.lines[0].get_xdata().tolist() == ALPHAS.tolist()
    assert "Euclidean" in first.get_xlabel() and "%" in first.get_ylabel()
    legend = [text.get_text() for text in figure.axes[-1].get_legend().get_texts()]
    assert legend == ["a", "b"]
    figure.canvas.draw()


def test_curves_that_cannot_be_drawn_are_refused():
    with pytest.raises(InputError, match="at least one group"):
        plot_pck({}, ALPHAS, distance="Euclidean")
    with pytest.raises(InputError, match="5 shares"):
        plot_pck({"I": {"a": np.zeros(4)}}, ALPHAS, distance="Euclidean")
