"""Errors of methods as curves and histograms: cumulative, PCK."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dgc_pose.errors import InputError
from dgc_pose.viz.figure import new_figure

LIMITS = (5.0, 10.0, 20.0, 30.0, 60.0, 90.0, 180.0)  # where an axis may end, degrees
_SIGNS = {"degrees": "°", "pixels": " px"}


def draw_cumulative(
    axes: Axes,
    errors: Mapping[str, np.ndarray],
    *,
    quantity: str,
    limit: float,
    unit: str = "degrees",
    styles: Mapping[str, Mapping[str, Any]] | None = None,
) -> None:
    """Draw the cumulative histogram of each method from 0 to `limit`, its median in the legend.

    errors: by method, (N,), N > 0; infinite ones count as pairs. unit: of the errors, degrees or
    pixels. styles: by method, matplotlib's properties of the line; None for matplotlib's choice.
    Raises InputError for an empty array or one with NaN.
    """
    for method, values in errors.items():
        if values.size == 0 or np.isnan(values).any():
            raise InputError("errors must hold at least one number, and no NaN")
        below = np.sort(values[values <= limit])
        x = np.concatenate([[0.0], below, [limit]])
        share = np.append(np.arange(len(below) + 1), len(below)) / values.size
        label = f"{method}, median {np.median(values):.2f}{_SIGNS[unit]}"
        style = {} if styles is None else styles[method]
        axes.step(x, 100 * share, where="post", label=label, **style)
    axes.set(xlim=(0, limit), ylim=(0, 100), xlabel=f"{quantity} ({unit})", ylabel="pairs (%)")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize=9)


def plot_errors(
    rotation: Mapping[str, np.ndarray], translation: Mapping[str, np.ndarray]
) -> Figure:
    """Histograms of rotation error and of folded translation error, a curve a method, degrees."""
    figure = new_figure(12.0, 4.5)
    panels = (("rotation error", rotation), ("folded translation error", translation))
    for axes, (quantity, errors) in zip(figure.subplots(1, 2), panels, strict=True):
        draw_cumulative(axes, errors, quantity=quantity, limit=shown_limit(errors))
    return figure


def shown_limit(errors: Mapping[str, np.ndarray], limits: Sequence[float] = LIMITS) -> float:
    """The least of the limits that is not below nine tenths of the finite errors of all methods;
    the last if there is none."""
    values = np.concatenate(list(errors.values()))
    finite = values[np.isfinite(values)]
    most = np.quantile(finite, 0.9) if len(finite) else 0.0
    return next((limit for limit in limits if limit >= most), limits[-1])


def plot_pck(curves: Mapping[str, Mapping[str, np.ndarray]], alphas: np.ndarray) -> Figure:
    """PCK: the share of pixels whose error is at most a share alpha of the image's side.

    A panel a group, in it a curve a method. curves: by group, by method, the shares (K,) in [0, 1]
    at `alphas` (K,); NaN for a group without pixels.
    """
    figure = new_figure(4.0 * len(curves), 4.4)
    panels = np.ravel(figure.subplots(1, len(curves), sharey=True, squeeze=False))
    for axes, (group, by_method) in zip(panels, curves.items(), strict=True):
        for method, shares in by_method.items():
            axes.plot(alphas, 100 * shares, label=method)
        axes.set(xlim=(alphas[0], alphas[-1]), ylim=(0, 100), xlabel="alpha")
        axes.set_title(group, fontsize=10)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("pixels within alpha x side (%)")
    panels[-1].legend(loc="lower right", fontsize=9)
    return figure
