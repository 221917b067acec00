"""Figures of matplotlib by its object interface: no pyplot, so no global state and no display."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dgc_pose.errors import InputError
from dgc_pose.system.files import naming_path

# What matplotlib draws without other programs.
_FORMATS = ("png", "jpg", "jpeg", "webp", "tif", "tiff", "svg", "pdf", "eps")

WIDTH = 10.0  # inches


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
    with naming_path(path):
        figure.savefig(path, format=picture_format(path), dpi=dpi)
