import numpy as np

from dgc_pose.benchmarks.curves import draw_cumulative, plot_errors
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
    *_, everywhere, confident = figure.axes
    assert (len(everywhere.lines), len(confident.lines)) == (2, 3)
    save_figure(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").exists()
