import dtu_report
import numpy as np
import pytest

from dgc_pose.benchmarks.dtu.motion import (
    WORST,
    binned_medians,
    plot_against_motion,
    plot_histograms,
)
from dgc_pose.benchmarks.summary import columns


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return dtu_report.finished_run(tmp_path_factory.mktemp("run")).rows


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


def test_medians_of_equally_many_pairs_by_increasing_x() -> None:
    rng = np.random.default_rng(3)
    x = rng.permutation(np.arange(80.0))
    y = 2 * x
    y[x >= 75] = np.inf  # half of the last ten pairs have no pose
    at, median = binned_medians(x, np.minimum(y, WORST))
    assert at == pytest.approx(np.arange(8) * 10 + 4.5)
    assert median[:7] == pytest.approx(2 * at[:7])
    assert median[7] == pytest.approx((148 + 180) / 2)
    assert [len(part) for part in binned_medians(x[:4], y[:4])] == [1, 1]


def test_errors_are_drawn_against_both_motions_and_failures_at_the_top(rows) -> None:
    figure = plot_against_motion(columns(rows))
    top_left, top_right, bottom_left, _ = figure.axes
    of_net = [row for row in rows if row.method == "net"]
    dots = np.asarray(top_right.collections[0].get_offsets())
    assert dots[:, 0] == pytest.approx([row.true_baseline_mm for row in of_net])
    expected = [min(row.rotation_error_deg, WORST) for row in of_net]
    assert dots[:, 1] == pytest.approx(expected)
    assert top_left.get_ylim()[1] > WORST
    folded = np.asarray(bottom_left.collections[0].get_offsets())[:, 1]
    assert folded == pytest.approx([min(row.translation_folded_deg, WORST) for row in of_net])
