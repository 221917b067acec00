"""Tables of text with aligned columns."""

import math
from collections.abc import Iterable, Mapping, Sequence


def table(columns: Mapping[str, str], rows: Iterable[object]) -> str:
    """A line for each row below the headings; a column's text, such as "{0.seconds:.2f}", is
    formatted with the row."""
    cells = ([text.format(row) for text in columns.values()] for row in rows)
    return aligned([[*columns], *cells])


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of one length as lines: the first column to the left, all others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = (
        [row[0].ljust(widths[0])]
        + [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        for row in rows
    )
    return "\n".join("  ".join(line).rstrip() for line in lines)


def decimals(value: float, digits: int) -> str:
    """The value with so many decimals; "-" for NaN and infinity."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
