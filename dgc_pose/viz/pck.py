"""PCK curves: the share of pixels whose error is at most a share alpha of the image's side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.errors import InputError
from dgc_pose.viz.figure import new_figure

_PANEL = 4.0  # inches a side


def plot_pck(
    curves: Mapping[str, Mapping[str, np.ndarray]], alphas: np.ndarray, *, distance: str
) -> Figure:
    """A panel a group, in it a curve a method.

    curves: by group, by method, the shares (K,) in [0, 1] at `alphas` (K,), shares of the image's
    side; NaN for a group without pixels. distance: the measure of the error, for the label.

    Raises InputError if there are no groups, or a curve has another length than alphas.
    """
    if not curves:
        raise InputError("curves must hold at least one group")
    figure = new_figure(_PANEL * len(curves), _PANEL + 0.4)
    panels = np.ravel(figure.subplots(1, len(curves), sharey=True, squeeze=False))
    for axes, (group, by_method) in zip(panels, curves.items(), strict=True):
        for method, shares in by_method.items():
            if np.shape(shares) != np.shape(alphas):
                raise InputError(f"{method}: a curve must have {len(alphas)} shares, one an alpha")
            axes.plot(alphas, 100 * shares, label=method)
        axes.set(xlim=(alphas[0], alphas[-1]), ylim=(0, 100), xlabel=f"alpha ({distance})")
        axes.set_title(group, fontsize=10)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("pixels within alpha x side (%)")
    panels[-1].legend(loc="lower right", fontsize=9)
    return figure
