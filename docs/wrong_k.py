"""Draws wrong_k.png: what a wrong focal length does to poses.

    python docs/wrong_k.py RUN/results.csv docs/wrong_k.png

results.csv is of `bench-pairs` with the methods NAME:K_scale=F, see cameras.md.
"""

import csv
import sys

import numpy as np

from dgc_pose.viz.figure import new_figure, save_figure

TICKS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.25, 1.5, 2.0)


def main(results: str, picture: str) -> None:
    rows: dict[float, list[dict[str, str]]] = {}
    with open(results, newline="") as stream:
        for row in csv.DictReader(stream):
            rows.setdefault(float(row["method"].rpartition("=")[2]), []).append(row)
    factors = sorted(rows)

    def column(name: str) -> list[np.ndarray]:
        return [np.array([float(row[name]) for row in rows[factor]]) for factor in factors]

    def flags(name: str) -> list[np.ndarray]:
        return [np.array([row[name] == "True" for row in rows[factor]]) for factor in factors]

    rotation, translation = column("rotation_error_deg"), column("translation_error_deg")
    claimed, doubted = flags("success"), flags("doubts_camera")
    figure = new_figure(10, 3.8)
    left, right = figure.subplots(1, 2)
    for label, errors in (("R", rotation), ("t", translation)):
        medians = [
            np.median(e[c]) if c.any() else np.nan for e, c in zip(errors, claimed, strict=True)
        ]
        left.plot(factors, medians, "o-", label=label)
    left.set(yscale="log", ylabel="median error of the poses claimed (degrees)")
    shares = {
        "told: a warning, or no pose": [d | ~c for c, d in zip(claimed, doubted, strict=True)],
        "more than 10 degrees off": [
            c & (np.maximum(R, t) > 10)
            for c, R, t in zip(claimed, rotation, translation, strict=True)
        ],
        "more than 10 degrees off, not told": [
            c & ~d & (np.maximum(R, t) > 10)
            for c, d, R, t in zip(claimed, doubted, rotation, translation, strict=True)
        ],
    }
    for (label, members), style in zip(shares.items(), ("o-", "s--", "^-"), strict=True):
        right.plot(factors, [100 * m.mean() for m in members], style, label=label)
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
