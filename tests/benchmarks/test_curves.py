import numpy as np
import pytest

from dgc_pose.benchmarks.curves import draw_cumulative, plot_errors, plot_pck
from dgc_pose.viz.figure import new_figure, save_figure


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_curve_a_method_with_its_median():
    axes = new_figure(4, 3).subplots()
    errors = {"a": np.array([3.0, np.inf, 1.0, 9.0, 3.0]), "b": np.full(3, np.inf)}
    draw_cumulative(axes, errors, quantity="rotation error", unit="degrees")
    assert legend(axes) == ["a, median 3.00°", "b, median inf°"]
    # At each value the share of errors not above it.
    assert axes.lines[0].get_xdata().tolist() == [0, 1, 3, 3, 9, 10]
    assert axes.lines[0].get_ydata().tolist() == [0, 20, 40, 60, 80, 80]
    assert axes.lines[1].get_ydata().tolist() == [0, 0]


def test_a_panel_a_quantity_without_the_methods_that_have_it_not(tmp_path):
    """A method may be called as a formula."""
    errors = np.array([12.0, 170.0, np.inf])
    fields = ("rotation_error_deg", "translation_error_deg", "epipolar_confident_px")
    methods = {
        name: {**dict.fromkeys(fields, errors), "epipolar_all_px": of_map}
        for name, of_map in (("$\\frac{$", errors), ("$\\frac{$/all", errors), ("\udcff", [np.nan]))
    }
    figure = plot_errors(methods)
    rotation, _, everywhere, confident = figure.axes
    assert rotation.get_xlim() == (0, 180)  # most of the finite errors are shown
    assert (len(everywhere.lines), len(confident.lines)) == (2, 3)
    assert legend(everywhere)[1] == "$\\frac{$/all, median 170.00 px"
    net, every = everywhere.lines
    assert net.get_color() == every.get_color() and net.get_linestyle() != every.get_linestyle()
    save_figure(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").exists()
    of_points = plot_errors({"sift": methods["\udcff"]}).axes[2]
    assert not of_points.lines and of_points.texts[0].get_text() == "no method has a map"


def test_a_panel_a_group_and_a_curve_a_method():
    alphas = np.linspace(0.005, 0.1, 5)
    curves = {"I": {"a": np.linspace(0, 1, 5)}, "II": {"a": np.full(5, np.nan)}}
    figure = plot_pck(curves, alphas)
    assert [axes.get_title() for axes in figure.axes] == ["I", "II"]
    (curve,) = figure.axes[0].lines
    assert curve.get_ydata().tolist() == pytest.approx([0, 25, 50, 75, 100])
    assert curve.get_xdata().tolist() == alphas.tolist()
    figure.canvas.draw()
