"""The pairs that a method got worst, as a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.benchmarks.samples import MatchSample
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.viz.figure import new_figure
from dgc_pose.viz.panels import draw_matches

COUNT = 10
_COLUMNS = 2
_WIDTH = 14.0  # inches


def worst_pairs(rows: Sequence[DtuScore], count: int = COUNT) -> list[DtuScore]:
    """The rows of one method with the largest error (the larger of rotation and folded translation
    error, infinite without a pose), the worst first; equal ones in the order of their keys."""

    def rank(row: DtuScore) -> tuple[object, ...]:
        return -max(row.rotation_error_deg, row.translation_folded_deg), row.key

    return sorted(rows, key=rank)[:count]


def plot_worst(
    rows: Sequence[DtuScore], shown: Sequence[PosedPair], samples: Sequence[MatchSample]
) -> Figure:
    """Pairs of one method side by side with what it matched: yellow for inliers of the
    estimated pose, dark for outliers. rows, shown and samples: one each a pair, at least one."""
    lines = -(-len(rows) // _COLUMNS)
    height = max(_WIDTH / _COLUMNS / _aspect(pair) for pair in shown)
    # A very tall picture would make a figure that no screen shows.
    figure = new_figure(_WIDTH, lines * (min(height, 6.0) + 0.45) + 0.5)
    figure.suptitle(f"{rows[0].method}: the {len(rows)} worst pairs, {rows[0].protocol} protocol")
    panels = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
    for axes in panels[len(rows) :]:
        axes.set_axis_off()
    for axes, row, pair, sample in zip(panels, rows, shown, samples, strict=False):
        draw_matches(
            axes,
            pair.image1.pixels,
            pair.image2.pixels,
            sample.points1,
            sample.points2,
            sample.inliers.astype(np.float64),
            _title(row),
        )
    return figure


def _title(row: DtuScore) -> str:
    motion = f"{row.true_rotation_deg:.0f}°, {row.true_baseline_mm:.0f} mm"
    error = f"R off {row.rotation_error_deg:.1f}°, t off {row.translation_error_deg:.1f}°"
    if not row.success:
        error = f"no pose ({row.status})"
    counts = f"{row.num_inliers} of {row.num_matches} matches are inliers"
    return f"scan{row.scene}, views {row.view1} and {row.view2} ({motion}): {error}\n{counts}"


def _aspect(pair: PosedPair) -> float:
    """Width over height of both images side by side at one height."""
    return sum(image.size[0] / image.size[1] for image in (pair.image1, pair.image2))
