"""The curves of the histograms, against shares counted by hand."""

import numpy as np

from dgc_pose.benchmarks.dtu.histograms import plot_errors
from dgc_pose.viz.figure import save_figure


def test_a_panel_has_a_curve_of_each_method_that_has_the_quantity(tmp_path):
    """A method may be called as a formula."""
    errors = np.array([3.0, np.inf, 1.0, 9.0, 3.0])
    lost = np.full(5, np.inf)
    fields = ("rotation_error_deg", "translation_error_deg", "epipolar_confident_px")
    methods = {
        name: {**dict.fromkeys(fields, own), "epipolar_all_px": everywhere}
        for name, own, everywhere in (
            ("$\\frac{$", errors, errors),
            ("$\\frac{$/all", lost, lost),
            ("\udcff", errors, np.array([np.nan])),
        )
    }
    figure = plot_errors(methods)
    rotation, _, everywhere, confident = figure.axes
    first, second, _ = (text.get_text() for text in rotation.get_legend().get_texts())
    assert (first, second) == ("$\\frac{$, median 3.00°", "$\\frac{$/all, median inf°")
    # At each value the share of errors not above it.
    assert rotation.lines[0].get_xdata().tolist() == [0, 1, 3, 3, 9, 10]
    assert rotation.lines[0].get_ydata().tolist() == [0, 20, 40, 60, 80, 80]
    assert rotation.lines[1].get_ydata().tolist() == [0, 0]
    assert (len(everywhere.lines), len(confident.lines)) == (2, 3)
    save_figure(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").exists()
