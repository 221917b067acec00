"""Pose errors of a data set: cumulative histograms, and errors against the true motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dgc_pose.viz.figure import new_figure
from dgc_pose.viz.histograms import draw_cumulative, shown_limit

EPIPOLAR_LIMITS = (5.0, 10.0, 20.0, 50.0, 100.0)  # where an axis may end, pixels
WORST = 180.0  # degrees; where a pair without a pose is drawn
_LEAST = 0.01  # degrees; where smaller errors are drawn
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
    colours: dict[str, str] = {}
    styles = {}
    for method in methods:
        engine = method.removesuffix("/all")
        colours.setdefault(engine, f"C{len(colours) % 10}")
        dashes = "--" if engine != method else "-"
        styles[method] = {"color": colours[engine], "linestyle": dashes, "linewidth": 1.4}
    return styles


def plot_histograms(methods: Columns, protocol: str) -> dict[str, Figure]:
    """The paper's three figures (section 4.4) by name: rotation, translation and epipolar.

    Each is the share of pairs whose error is not above a value, a curve a method, the median in the
    legend; a pair without a pose has an infinite error. Translation is the angle from 0 to 180
    degrees. Epipolar is a pair's median D_e, to the left over all pixels of image 2 for methods
    with a dense map, to the right over the matches that the pose was estimated from. protocol: what
    D_e is measured in, for the label.
    """
    styles = method_styles(list(methods))
    return {
        "rotation": _angles(methods, "rotation_error_deg", "rotation error", styles),
        "translation": _angles(methods, "translation_error_deg", "translation error", styles),
        "epipolar": _epipolar(methods, styles, protocol),
    }


def plot_against_motion(methods: Columns) -> Figure:
    """Rotation and folded translation error against the true rotation and the baseline.

    A dot a pair and a line through the medians of pairs of similar motion, a colour a method; pairs
    without a pose are drawn at 180 degrees and count in the medians.
    """
    styles = method_styles(list(methods))
    figure = new_figure(9.0, 7.0)
    errors = (("rotation_error_deg", "rotation"), ("translation_folded_deg", "folded translation"))
    motions = (
        ("true_rotation_deg", "true rotation (degrees)"),
        ("true_baseline_mm", "baseline (mm)"),
    )
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    for line, (error, of) in zip(panels, errors, strict=True):
        line[0].set_ylabel(f"{of} error (degrees; no pose: {WORST:g})")
        for axes, (motion, _) in zip(line, motions, strict=True):
            _draw_against(axes, methods, motion, error, styles)
    for axes, (_, label) in zip(panels[-1], motions, strict=True):
        axes.set_xlabel(label)
    panels[0, 0].legend(loc="upper left", fontsize=8)
    return figure


def binned_medians(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Medians of x and y over bins of equally many pairs, as many bins as have five pairs or more.

    x, y: (N,), N > 0. Returns two arrays (B,), x increasing.
    """
    bins = min(_BINS, max(1, len(x) // _LEAST_PER_BIN))
    groups = np.array_split(np.argsort(x, kind="stable"), bins)
    medians = [(np.median(x[group]), np.median(y[group])) for group in groups]
    return np.array([m[0] for m in medians]), np.array([m[1] for m in medians])


def _angles(methods: Columns, field: str, quantity: str, styles: Styles) -> Figure:
    errors = {method: own[field] for method, own in methods.items()}
    figure = new_figure(6.5, 4.5)
    limit = shown_limit(errors)
    draw_cumulative(figure.subplots(), errors, quantity=quantity, limit=limit, styles=styles)
    return figure


def _epipolar(methods: Columns, styles: Styles, protocol: str) -> Figure:
    panels = (("epipolar_all_px", "all pixels"), ("epipolar_confident_px", "the pose's matches"))
    figure = new_figure(9.0, 4.5)
    columns = [
        {method: own[field] for method, own in methods.items() if not np.isnan(own[field]).any()}
        for field, _ in panels
    ]
    limit = max(shown_limit(c, EPIPOLAR_LIMITS) for c in columns if c)
    quantity = f"median D_e of a pair, {protocol} protocol"
    for axes, errors, (_, title) in zip(figure.subplots(1, 2), columns, panels, strict=True):
        axes.set_title(title, fontsize=10)
        if errors:
            draw_cumulative(
                axes, errors, quantity=quantity, limit=limit, unit="pixels", styles=styles
            )
        else:
            axes.set_axis_off()
            axes.text(0.5, 0.5, "no method maps all pixels", ha="center", va="center")
    return figure


def _draw_against(axes: Axes, methods: Columns, motion: str, error: str, styles: Styles) -> None:
    for method, own in methods.items():
        x = own[motion]
        y = np.clip(own[error], _LEAST, WORST)
        style = styles[method]
        axes.scatter(x, y, s=8, alpha=0.35, color=style["color"], linewidths=0)
        axes.plot(*binned_medians(x, y), marker="o", markersize=3, label=method, **style)
    axes.set_yscale("log")
    axes.set_ylim(top=1.25 * WORST)
    axes.grid(alpha=0.3)
