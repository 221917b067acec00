"""Reliability diagrams: how often a match of some matchability is right."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dgc_pose.metrics import Reliability
from dgc_pose.viz.figure import new_figure


def plot_reliability(reliabilities: Mapping[str, Reliability], *, right: str) -> Figure:
    """The share of right matches by bin of matchability, a curve a method, and below it the share
    of all matches in each bin. A calibrated method follows the diagonal. Empty bins are left out.

    right: which matches are right, for the label, such as "within 3 px".
    """
    figure = new_figure(5.5, 6.5)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    draw_reliability(upper, reliabilities, right=right)
    for own in reliabilities.values():
        shares = own.counts / max(own.counts.sum(), 1)
        lower.stairs(100 * shares, own.edges, baseline=0)
    lower.set(xlabel="matchability", ylabel="matches (%)", xticks=np.linspace(0, 1, 6))
    lower.grid(alpha=0.3)
    return figure


def draw_reliability(axes: Axes, reliabilities: Mapping[str, Reliability], *, right: str) -> None:
    """Draw the share of right matches by bin of confidence, a curve a method, and the diagonal.

    right: which matches are right, for the label.
    """
    axes.plot([0, 1], [0, 1], color="grey", linestyle="--", linewidth=1)
    for method, own in reliabilities.items():
        filled = own.counts > 0
        label = f"{method}, calibration error {100 * own.calibration_error:.1f} %"
        axes.plot(
            own.mean_confidence[filled], own.share_correct[filled], marker="o", ms=4, label=label
        )
    axes.set(xlim=(0, 1), ylim=(0, 1), ylabel=f"share of matches {right}")
    axes.grid(alpha=0.3)
    if reliabilities:
        axes.legend(loc="lower right", fontsize=9)
