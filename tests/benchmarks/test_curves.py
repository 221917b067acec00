import numpy as np
import pytest

from dgc_pose.benchmarks.curves import (
    draw_cumulative,
    plot_errors,
    plot_pck,
    plot_reliability,
)
from dgc_pose.metrics import Reliability
from dgc_pose.viz.figure import new_figure, save_figure


def test_a_curve_a_method_with_its_median():
    axes = new_figure(4, 3).subplots()
    errors = {"a": np.array([3.0, np.inf, 1.0, 12.0, 3.0]), "b": np.full(3, np.inf)}
    draw_cumulative(axes, errors, quantity="rotation error", limit=10)
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["a, median 3.00°", "b, median inf°"]
    # At each value the share of errors not above it.
    assert axes.lines[0].get_xdata().tolist() == [0, 1, 3, 3, 10]
    assert axes.lines[0].get_ydata().tolist() == [0, 20, 40, 60, 60]
    assert axes.lines[1].get_ydata().tolist() == [0, 0]


def test_both_histograms_show_most_of_the_finite_errors():
    rotation = {"a": np.full(9, 1.0), "b": np.array([12.0, np.inf])}
    translation = {"a": np.full(9, 7.0), "b": np.array([170.0, 170.0, np.inf])}
    figure = plot_errors(rotation, translation)
    assert [axes.get_xlim() for axes in figure.axes] == [(0, 5), (0, 180)]
    assert "rotation" in figure.axes[0].get_xlabel()
    assert "folded translation" in figure.axes[1].get_xlabel()


def test_a_panel_a_group_and_a_curve_a_method():
    alphas = np.linspace(0.005, 0.1, 5)
    curves = {
        "I": {"a": np.linspace(0, 1, 5), "b": np.full(5, 0.5)},
        "II": {"a": np.full(5, np.nan), "b": np.full(5, 0.25)},
    }
    figure = plot_pck(curves, alphas, distance="Euclidean")
    assert [axes.get_title() for axes in figure.axes] == ["I", "II"]
    first = figure.axes[0]
    assert first.lines[0].get_ydata().tolist() == pytest.approx([0, 25, 50, 75, 100])
    assert first.lines[0].get_xdata().tolist() == alphas.tolist()
    assert "Euclidean" in first.get_xlabel() and "%" in first.get_ylabel()
    legend = [text.get_text() for text in figure.axes[-1].get_legend().get_texts()]
    assert legend == ["a", "b"]
    figure.canvas.draw()


def test_shares_stand_over_the_mean_confidence_and_counts_below():
    confidence = np.array([0.02, 0.06, 0.55, 0.57, 0.53, 0.51])
    reliability = Reliability.of(confidence, np.array([False, False, True, True, True, False]))
    figure = plot_reliability({"net": reliability}, right="within 3 px")
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


def test_a_method_may_be_called_as_a_formula(tmp_path):
    figure = new_figure(4, 3)
    errors = {"$\\frac{$": np.ones(3), "\udcff": np.ones(3)}
    draw_cumulative(figure.subplots(), errors, quantity="error", limit=10)
    save_figure(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").exists()
