"""Pose errors of a data set as cumulative histograms."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.benchmarks.curves import draw_cumulative, shown_limit
from dgc_pose.viz.figure import new_figure

EPIPOLAR_LIMITS = (5.0, 10.0, 20.0, 50.0, 100.0)  # where an axis may end, pixels

Styles = Mapping[str, Mapping[str, Any]]
# By method, then by quantity, a value a pair: rotation_error_deg, translation_error_deg (0 to 180),
# and the medians of D_e epipolar_all_px and epipolar_confident_px. Errors are infinite without a
# pose, NaN if a method has no such figure.
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
