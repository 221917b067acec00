"""Draws wrong_k.png: what a wrong focal length does to poses.

    python docs/wrong_k.py RUN/results.csv docs/wrong_k.png

results.csv is of `bench-pairs` with the methods NAME:K_scale=F and NAME:K=auto:shared, see
cameras.md.
"""

import csv
import sys

import numpy as np

from dgc_pose.viz.figure import new_figure, save_figure

TICKS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.25, 1.5, 2.0)
FAR_OFF_DEG = 10
_ERRORS = {"R": "rotation_error_deg", "t": "translation_error_deg"}


class Pairs:
    """The rows of a method."""

    def __init__(self, rows: list[dict[str, str]]) -> None:
        self.errors = {
            label: np.array([float(row[name]) for row in rows]) for label, name in _ERRORS.items()
        }
        self.claimed = np.array([row["success"] == "True" for row in rows])
        self.doubted = np.array([row["doubts_camera"] == "True" for row in rows])

    def median(self, label: str) -> float:
        return float(np.median(self.errors[label][self.claimed])) if self.claimed.any() else np.nan

    @property
    def told(self) -> np.ndarray:
        return self.doubted | ~self.claimed

    @property
    def far_off(self) -> np.ndarray:
        return self.claimed & (np.maximum(*self.errors.values()) > FAR_OFF_DEG)


def main(results: str, picture: str) -> None:
    rows: dict[str, list[dict[str, str]]] = {}
    with open(results, newline="") as stream:
        for row in csv.DictReader(stream):
            rows.setdefault(row["method"].partition(":K")[2], []).append(row)
    withheld = Pairs(rows.pop("=auto:shared"))
    scaled = {float(name.partition("=")[2]): Pairs(rows[name]) for name in rows}
    factors = sorted(scaled)
    figure = new_figure(10, 3.8)
    left, right = figure.subplots(1, 2)
    for label, colour in (("R", "C0"), ("t", "C1")):
        medians = [scaled[factor].median(label) for factor in factors]
        left.plot(factors, medians, "o-", color=colour, label=f"{label}, K wrong")
        left.axhline(
            withheld.median(label), linestyle=":", color=colour, label=f"{label}, --K auto:shared"
        )
    left.set(yscale="log", ylabel="median error of the poses claimed (degrees)")
    shares = {
        "told: a warning, or no pose": (lambda pairs: pairs.told, "o-"),
        f"over {FAR_OFF_DEG} degrees off": (lambda pairs: pairs.far_off, "s--"),
        f"over {FAR_OFF_DEG} degrees off, not told": (
            lambda pairs: pairs.far_off & ~pairs.told,
            "^-",
        ),
    }
    for label, (members, style) in shares.items():
        percent = [100 * members(scaled[factor]).mean() for factor in factors]
        right.plot(factors, percent, style, label=label)
    right.set(ylabel="pairs (%)", ylim=(-3, 103))
    for axes in (left, right):
        axes.set(xscale="log", xlabel="focal length of K over the true one")
        axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend(fontsize=9)
    save_figure(figure, picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
