"""Figures of matplotlib by its object interface: no pyplot, so no global state and no display."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dgc_pose.errors import InputError


def new_figure(
    width: float, height: float, *, layout: Literal["constrained"] | None = "constrained"
) -> Figure:
    """An empty figure with its canvas, sizes in inches."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def picture_format(path: str | Path) -> str:
    """The format of a file name's ending. Raises InputError if matplotlib cannot write it."""
    suffix = Path(path).suffix.lower().lstrip(".")
    known = FigureCanvasAgg.get_supported_filetypes()
    if suffix not in known:
        raise InputError(f"{path}: a plot is written as .png, .svg or .pdf")
    return suffix


def save_figure(figure: Figure, path: str | Path, *, picture_format: str = "png") -> None:
    """Write the figure in the given format, whatever the ending of the path."""
    figure.savefig(path, format=picture_format, dpi=100)
