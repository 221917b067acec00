"""Pose errors of a data set: cumulative histograms, and errors against the true motion."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dgc_pose.benchmarks.curves import draw_cumulative, shown_limit
from dgc_pose.viz.figure import new_figure

EPIPOLAR_LIMITS = (5.0, 10.0, 20.0, 50.0, 100.0)  # where an axis may end, pixels
WORST = 180.0  # degrees; where a pair without a pose is drawn
_SMALLEST_DRAWN_DEG = 0.01  # degrees; where smaller errors are drawn
_BINS = 8
_LEAST_PER_BIN = 5  # pairs

Styles = Mapping[str, Mapping[str, Any]]
# By method, then by quantity, a value a pair: rotation_error_deg, translation_error_deg (0 to 180),
# translation_folded_deg (min(e, 180 - e)), true_rotation_deg, true_baseline_mm, and the medians of
# D_e epipolar_all_px and epipolar_confident_px. Errors are infinite without a pose, NaN if a method
# has no such figure.
Columns = Mapping[str, Mapping[str, np.ndarray]]


def method_styles(methods: Sequence[str]) -> Styles:
    """A colour for each method; `NAME/all` is drawn in the colour of `NAME`, and dashed."""
    bases = list(dict.fromkeys(method.removesuffix("/all") for method in methods))
    return {
        method: {
            "color": f"C{bases.index(method.removesuffix('/all')) % 10}",
            "linestyle": "--" if method.endswith("/all") else "-",
            "linewidth": 1.4,
        }
        for method in methods
    }


def plot_histograms(methods: Columns, protocol: str) -> dict[str, Figure]:
    """The paper's three figures (section 4.4) by name: rotation, translation and epipolar.

    Each is the share of pairs whose error is not above a value, a curve a method, the median in the
    legend; a pair without a pose has an infinite error. Translation is the angle from 0 to 180
    degrees. Epipolar is a pair's median D_e, to the left over all pixels of image 2 for methods
    with a dense map, to the right over the matches that the pose was estimated from. protocol: what
    D_e is measured in, for the label.
    """
    styles = method_styles(list(methods))
    figures = {}
    for name in ("rotation", "translation"):
        errors = {method: values[f"{name}_error_deg"] for method, values in methods.items()}
        figures[name] = new_figure(6.5, 4.5)
        limit, axes = shown_limit(errors), figures[name].subplots()
        draw_cumulative(axes, errors, quantity=f"{name} error", limit=limit, styles=styles)
    return figures | {"epipolar": _epipolar(methods, styles, protocol)}


def plot_against_motion(methods: Columns) -> Figure:
    """Rotation and folded translation error against the true rotation and the baseline.

    A dot a pair and a line through the medians of pairs of similar motion, a colour a method; pairs
    without a pose are drawn at 180 degrees and count in the medians.
    """
    figure = new_figure(9.0, 7.0)
    errors = (("rotation_error_deg", "rotation"), ("translation_folded_deg", "folded translation"))
    motions = (
        ("true_rotation_deg", "true rotation (degrees)"),
        ("true_baseline_mm", "baseline (mm)"),
    )
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    for row, (error, name) in zip(panels, errors, strict=True):
        row[0].set_ylabel(f"{name} error (degrees; no pose: {WORST:g})")
        for axes, (motion, _) in zip(row, motions, strict=True):
            _draw_against(axes, methods, motion, error)
    for axes, (_, label) in zip(panels[-1], motions, strict=True):
        axes.set_xlabel(label)
    panels[0, 0].legend(loc="upper left", fontsize=8)
    return figure


def _draw_against(axes: Axes, methods: Columns, motion: str, error: str) -> None:
    for method, style in method_styles(list(methods)).items():
        x, y = methods[method][motion], np.clip(methods[method][error], _SMALLEST_DRAWN_DEG, WORST)
        axes.scatter(x, y, s=8, alpha=0.35, color=style["color"], linewidths=0)
        axes.plot(*binned_medians(x, y), marker="o", markersize=3, label=method, **style)
    axes.set_yscale("log")
    axes.set_ylim(top=1.25 * WORST)
    axes.grid(alpha=0.3)


def binned_medians(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Medians of x and y over bins of equally many pairs, as many bins as have five pairs or more.

    x, y: (N,), N > 0. Returns two arrays (B,), x increasing.
    """
    bins = min(_BINS, max(1, len(x) // _LEAST_PER_BIN))
    groups = np.array_split(np.argsort(x, kind="stable"), bins)
    x_medians, y_medians = ([np.median(v[group]) for group in groups] for v in (x, y))
    return np.array(x_medians), np.array(y_medians)


def _epipolar(methods: Columns, styles: Styles, protocol: str) -> Figure:
    panels = {"epipolar_all_px": "all pixels", "epipolar_confident_px": "the pose's matches"}
    errors = [{method: values[field] for method, values in methods.items()} for field in panels]
    known = [{k: v for k, v in group.items() if not np.isnan(v).any()} for group in errors]
    limit = max(shown_limit(group, EPIPOLAR_LIMITS) for group in known if group)
    quantity = f"median D_e of a pair, {protocol} protocol"
    figure = new_figure(9.0, 4.5)
    for axes, group, title in zip(figure.subplots(1, 2), known, panels.values(), strict=True):
        axes.set_title(title, fontsize=10)
        if group:
            draw_cumulative(
                axes, group, quantity=quantity, limit=limit, unit="pixels", styles=styles
            )
        else:
            axes.set_axis_off()
            axes.text(0.5, 0.5, "no method maps all pixels", ha="center", va="center")
    return figure
