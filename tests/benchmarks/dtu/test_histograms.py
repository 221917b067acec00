import dtu_report
import numpy as np
import pytest

from dgc_pose.benchmarks.dtu.histograms import plot_histograms
from dgc_pose.benchmarks.summary import columns


@pytest.fixture(scope="module")
def rows():
    return dtu_report.finished_rows()


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


@pytest.mark.parametrize("name", ["rotation", "translation"])
def test_the_curves_of_angles_are_those_of_the_rows(rows, name) -> None:
    (axes,) = plot_histograms(columns(rows), "native")[name].axes
    limit = axes.get_xlim()[1]
    assert f"{name} error (degrees)" in axes.get_xlabel()
    for method, line in zip(dtu_report.METHODS, axes.lines, strict=True):
        errors = np.array([getattr(r, f"{name}_error_deg") for r in rows if r.method == method])
        assert np.isinf(errors).any()
        assert line.get_ydata()[-1] == pytest.approx(100 * np.mean(errors <= limit))
        assert f"{method}, median {np.median(errors):.2f}°" in legend(axes)


def test_methods_without_a_map_are_left_out_over_all_pixels(rows) -> None:
    everywhere, confident = plot_histograms(columns(rows), "native")["epipolar"].axes
    assert [text.split(",")[0] for text in legend(everywhere)] == ["net", "net/all"]
    assert [text.split(",")[0] for text in legend(confident)] == [*dtu_report.METHODS]
    assert everywhere.get_xlim() == confident.get_xlim()
    median = np.median([row.epipolar_all_px for row in rows if row.method == "net"])
    assert legend(everywhere)[0] == f"net, median {median:.2f} px"
    # One colour a method, in both panels.
    assert everywhere.lines[1].get_color() == confident.lines[1].get_color()
    assert everywhere.lines[0].get_linestyle() != everywhere.lines[1].get_linestyle()
    of_points = [row for row in rows if row.method == "points"]
    everywhere, confident = plot_histograms(columns(of_points), "native")["epipolar"].axes
    assert not everywhere.lines and len(confident.lines) == 1
