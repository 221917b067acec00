"""Figures of matplotlib by its object interface: no pyplot, so no global state and no display; and
rows of panels that fill a figure's width, so that no band stays blank."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dgc_pose.errors import InputError
from dgc_pose.files.outputs import writing

# What matplotlib draws without other programs.
_FORMATS = ("png", "jpg", "jpeg", "webp", "tif", "tiff", "svg", "pdf", "eps")

WIDTH = 10.0  # inches
GAP = 0.1  # inches, between the panels of a row
_MARGIN = 0.08  # inches, around the figure
_LINE = 0.19  # inches, of a line of text
_CHARACTER = 0.078  # inches, the mean width in a title
_BAR = 2.4  # inches that a colour bar and its label take beside a title
_BAR_LINE = 0.24  # inches, of a colour bar below a title
_MAX_PANEL = 20.0  # inches; the height of a row at most


def new_figure(width: float, height: float) -> Figure:
    """An empty figure with its canvas and a constrained layout, sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def picture_format(path: str | Path) -> str:
    """The format of a file name's ending. Raises InputError if no picture is written in it."""
    suffix = Path(path).suffix.lower().lstrip(".")
    if suffix not in _FORMATS:
        raise InputError(f"{path}: a plot is written as one of {', '.join(_FORMATS)}")
    return suffix


def save_figure(figure: Figure, path: str | Path, dpi: float = 200) -> None:
    """Write the figure in the format of the path's ending (see `picture_format`).

    dpi: pixels to an inch. Titles and legends are shown as they are: names of files may hold what
    would be a formula. Raises OSError, with the path.
    """
    for axes in figure.axes:
        legend = axes.get_legend()
        for text in (axes.title, *axes.texts, *(legend.get_texts() if legend else ())):
            text.set_parse_math(False)
            text.set_text(text.get_text().encode("utf-8", "replace").decode())
    with writing(path):
        figure.savefig(path, format=picture_format(path), dpi=dpi)


@dataclass(frozen=True)
class Panel:
    """The space that a panel needs."""

    aspect: float  # width over height of what is drawn
    title: str
    bar: bool = False  # whether a colour bar stands beside its title, or below a long one


def row_height(row: Sequence[Panel], width: float) -> float:
    """Height in inches of panels side by side in a row of this width."""
    inside = width - 2 * _MARGIN - GAP * (len(row) - 1)
    return min(inside / sum(panel.aspect for panel in row), _MAX_PANEL)


def panel_rows(
    rows: Sequence[Sequence[Panel]], headline: str = "", *, width: float = WIDTH
) -> tuple[Figure, list[list[Axes]]]:
    """A figure and its axes, a list a row. The panels of a row have one height and fill the width.

    Titles are set, broken where their panel is narrow; the headline stands above all.
    """
    head = _wrapped(headline, width - 2 * _MARGIN)
    heights = [row_height(row, width) for row in rows]
    strips = [*map(_strip, rows, heights)]
    top = _MARGIN + _LINE * len(head)
    total = top + sum(heights) + sum(strips) + _MARGIN
    figure = new_figure(width, total)
    figure.set_layout_engine("none")
    corner = _MARGIN / width, 1 - _MARGIN / total
    figure.text(*corner, "\n".join(head), va="top", fontsize=10, parse_math=False)
    axes_of_rows: list[list[Axes]] = []
    for row, height, strip in zip(rows, heights, strips, strict=True):
        top += strip + height
        sizes = [panel.aspect * height for panel in row]
        left = (width - sum(sizes) - GAP * (len(row) - 1)) / 2
        axes_of_rows.append([])
        for panel, size in zip(row, sizes, strict=True):
            place = (left / width, 1 - top / total, size / width, height / total)
            axes = figure.add_axes(place)
            axes.set_title(
                "\n".join(_wrapped(panel.title, size)),
                fontsize=10,
                loc="left",
                parse_math=False,  # of a file's name
                y=1.0,  # or matplotlib would lift it above the colour bar
                pad=72 * (0.05 + _bar_below(panel, size)),
            )
            axes_of_rows[-1].append(axes)
            left += size + GAP
    return figure, axes_of_rows


def _bar_below(panel: Panel, width: float) -> float:
    """Height in inches of a colour bar that has no room beside the title."""
    room = width - len(panel.title) * _CHARACTER
    return _BAR_LINE if panel.bar and room < _BAR else 0.0


def _strip(row: Sequence[Panel], height: float) -> float:
    """Height in inches of the titles of a row of this height, and of the colour bars below them."""
    sizes = [(panel, panel.aspect * height) for panel in row]
    return 0.14 + max(_LINE * len(_wrapped(p.title, w)) + _bar_below(p, w) for p, w in sizes)


def _wrapped(text: str, width: float) -> list[str]:
    most = max(8, int(width / _CHARACTER))
    return [line for part in text.splitlines() for line in textwrap.wrap(part, most)]
