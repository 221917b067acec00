import numpy as np
import pytest

from dgc_pose.benchmarks.curves import draw_cumulative, plot_errors, plot_pck
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


def test_a_method_may_be_called_as_a_formula(tmp_path):
    errors = {"$\\frac{$": np.ones(3), "\udcff": np.array([12.0, 170.0, np.inf])}
    figure = plot_errors(errors, errors)
    assert figure.axes[0].get_xlim() == (0, 180)  # most of the finite errors are shown
    save_figure(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").exists()


def test_a_panel_a_group_and_a_curve_a_method():
    alphas = np.linspace(0.005, 0.1, 5)
    curves = {"I": {"a": np.linspace(0, 1, 5)}, "II": {"a": np.full(5, np.nan)}}
    figure = plot_pck(curves, alphas)
    assert [axes.get_title() for axes in figure.axes] == ["I", "II"]
    (curve,) = figure.axes[0].lines
    assert curve.get_ydata().tolist() == pytest.approx([0, 25, 50, 75, 100])
    assert curve.get_xdata().tolist() == alphas.tolist()
    figure.canvas.draw()
