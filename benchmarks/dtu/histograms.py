"""The paper's three cumulative histograms (section 4.4): errors of R, of t, and D_e."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.viz.figure import new_figure

_DEGREES = (5.0, 10.0, 20.0, 30.0, 60.0, 90.0, 180.0)
_PIXELS = (5.0, 10.0, 20.0, 50.0, 100.0)
# By field of a record: quantity of the panel, its unit, and the candidates for the axis limit
_PANELS = {
    "rotation_error_deg": ("rotation error", "°", _DEGREES),
    "translation_error_deg": ("translation error", "°", _DEGREES),
    "epipolar_all_px": ("median D_e of the map", " px", _PIXELS),
    "epipolar_confident_px": ("median D_e of the pose's matches", " px", _PIXELS),
}


def plot_errors(methods: Mapping[str, Mapping[str, np.ndarray]]) -> Figure:
    """Plot the share of pairs below each rotation error, translation error (0 to 180 degrees), and
    median D_e of a pair, which has two panels: over the map, and over the matches of the pose.

    methods: values (N,) by method, then by field of a record. Infinite values count as pairs; a
    panel skips methods with NaN. The legend has the median. `NAME/all` is dashed, in the colour of
    `NAME`. An axis ends at the smallest of its limits that is at least the 0.9 quantile of all
    methods' finite errors, else at the largest limit.
    """
    figure = new_figure(12.0, 9.0)
    panels = zip(figure.subplots(2, 2).ravel(), _PANELS.items(), strict=True)
    for axes, (field, (quantity, unit, limits)) in panels:
        errors = {name: values[field] for name, values in methods.items()}
        errors = {name: values for name, values in errors.items() if not np.isnan(values).any()}
        if not errors:
            axes.set_axis_off()
            axes.text(0.5, 0.5, "no method has a map", ha="center", va="center")
            continue
        finite = np.concatenate([values[np.isfinite(values)] for values in errors.values()])
        most = np.quantile(finite, 0.9) if len(finite) else 0.0
        limit = next((limit for limit in limits if limit >= most), limits[-1])
        bases = list(dict.fromkeys(method.removesuffix("/all") for method in errors))
        for method, values in errors.items():
            below = np.sort(values[values <= limit])
            axes.step(
                np.concatenate([[0.0], below, [limit]]),
                100 * np.append(np.arange(len(below) + 1), len(below)) / values.size,
                where="post",
                label=f"{method}, median {np.median(values):.2f}{unit}",
                color=f"C{bases.index(method.removesuffix('/all')) % 10}",
                linestyle="--" if method.endswith("/all") else "-",
            )
        words = f"{quantity} ({'degrees' if unit == '°' else 'pixels'})"
        axes.set(xlim=(0, limit), ylim=(0, 100), xlabel=words, ylabel="pairs (%)")
        axes.grid(alpha=0.3)
        axes.legend(loc="lower right", fontsize=9)
    return figure
