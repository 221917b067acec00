"""Figures of matplotlib by its object interface: no pyplot, so no global state and no display; and
rows of panels that fill a figure's width, so that no band stays blank."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
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


def row_height(aspects: Sequence[float], width: float) -> float:
    """Height in inches of panels side by side in a row of this width. aspects: width over height of
    each."""
    return min((width - 2 * _MARGIN - GAP * (len(aspects) - 1)) / sum(aspects), _MAX_PANEL)


def panel_rows(
    rows: Sequence[Sequence[tuple[float, str]]], headline: str = ""
) -> tuple[Figure, list[Axes]]:
    """A figure `WIDTH` wide and the axes of its panels, of which each is given by its aspect and
    its title. The panels of a row have one height and fill the width.

    Titles are broken where their panel is narrow; the headline stands above all.
    """
    head = _wrapped(headline, WIDTH - 2 * _MARGIN)
    heights = [row_height([aspect for aspect, _ in row], WIDTH) for row in rows]
    titles = [
        [_wrapped(title, aspect * height) for aspect, title in row]
        for row, height in zip(rows, heights, strict=True)
    ]
    strips = [0.14 + _LINE * max(map(len, of_row)) for of_row in titles]
    top = _MARGIN + _LINE * len(head)
    total = top + sum(heights) + sum(strips) + _MARGIN
    figure = new_figure(WIDTH, total)
    figure.set_layout_engine("none")
    corner = _MARGIN / WIDTH, 1 - _MARGIN / total
    figure.text(*corner, "\n".join(head), va="top", fontsize=10, parse_math=False)
    panels = []
    for row, of_row, height, strip in zip(rows, titles, heights, strips, strict=True):
        top += strip + height
        sizes = [aspect * height for aspect, _ in row]
        left = (WIDTH - sum(sizes) - GAP * (len(row) - 1)) / 2
        for size, title in zip(sizes, of_row, strict=True):
            box = (left / WIDTH, 1 - top / total, size / WIDTH, height / total)
            panels.append(figure.add_axes(box))
            # Without mathematics: the name of a file may be what would be a formula.
            panels[-1].set_title("\n".join(title), fontsize=10, loc="left", parse_math=False, pad=4)
            left += size + GAP
    return figure, panels


def _wrapped(text: str, width: float) -> list[str]:
    most = max(8, int(width / _CHARACTER))
    return [line for part in text.splitlines() for line in textwrap.wrap(part, most)]
