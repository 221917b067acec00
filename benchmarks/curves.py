"""Errors of methods as curves and histograms: cumulative, PCK."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dgc_pose.viz.figure import new_figure

Unit = Literal["degrees", "pixels"]
LIMITS: Mapping[Unit, Sequence[float]] = {  # where an axis may end
    "degrees": (5.0, 10.0, 20.0, 30.0, 60.0, 90.0, 180.0),
    "pixels": (5.0, 10.0, 20.0, 50.0, 100.0),
}
# By field of a record what a panel is called, and its unit
_PANELS: Mapping[str, tuple[str, Unit]] = {
    "rotation_error_deg": ("rotation error", "degrees"),
    "translation_error_deg": ("translation error", "degrees"),
    "epipolar_all_px": ("median D_e of the map", "pixels"),
    "epipolar_confident_px": ("median D_e of the pose's matches", "pixels"),
}


def plot_errors(methods: Mapping[str, Mapping[str, np.ndarray]]) -> Figure:
    """The paper's histograms (section 4.4): rotation error, translation error from 0 to 180
    degrees, and a pair's median D_e over the map and over the matches of the pose.

    methods: by method, by field of a record, its values (N,); infinite ones count as pairs, and a
    method with NaN is left out of a panel.
    """
    figure = new_figure(12.0, 9.0)
    for axes, (field, (quantity, unit)) in zip(
        figure.subplots(2, 2).ravel(), _PANELS.items(), strict=True
    ):
        errors = {name: values[field] for name, values in methods.items()}
        known = {name: values for name, values in errors.items() if not np.isnan(values).any()}
        if known:
            draw_cumulative(axes, known, quantity=quantity, unit=unit)
        else:
            axes.set_axis_off()
            axes.text(0.5, 0.5, "no method has a map", ha="center", va="center")
    return figure


def draw_cumulative(
    axes: Axes, errors: Mapping[str, np.ndarray], *, quantity: str, unit: Unit
) -> None:
    """Draw the cumulative histogram of each method, its median in the legend. `NAME/all` has the
    colour of `NAME`, and is dashed.

    errors: by method, (N,), N > 0, no NaN; infinite ones count. The axis ends at the least of
    LIMITS that is not below nine tenths of the finite errors of all methods, or at the last one.
    """
    values = np.concatenate(list(errors.values()))
    finite = values[np.isfinite(values)]
    most, limits = np.quantile(finite, 0.9) if len(finite) else 0.0, LIMITS[unit]
    limit = next((limit for limit in limits if limit >= most), limits[-1])
    bases = list(dict.fromkeys(method.removesuffix("/all") for method in errors))
    for method, values in errors.items():
        below = np.sort(values[values <= limit])
        axes.step(
            np.concatenate([[0.0], below, [limit]]),
            100 * np.append(np.arange(len(below) + 1), len(below)) / values.size,
            where="post",
            label=f"{method}, median {np.median(values):.2f}{'°' if unit == 'degrees' else ' px'}",
            color=f"C{bases.index(method.removesuffix('/all')) % 10}",
            linestyle="--" if method.endswith("/all") else "-",
        )
    axes.set(xlim=(0, limit), ylim=(0, 100), xlabel=f"{quantity} ({unit})", ylabel="pairs (%)")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize=9)


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
