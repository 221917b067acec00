"""The CSV files of a run's figures, and the progress line."""

import csv
import sys
from pathlib import Path
from typing import Any

from dgc_pose.files.outputs import writing
from dgc_pose.training.options import TrainingOptions

_PROGRESS_MINUTES = 0.5  # between progress lines

Row = dict[str, Any]


def append(path: Path, row: Row) -> None:
    """Add a row to a CSV file; a new file gets the row's columns."""
    columns, is_new = list(row), not path.exists()
    if not is_new:
        with path.open(newline="") as file:
            columns = next(csv.reader(file), columns)
    with writing(path), path.open("a", newline="") as file:
        writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore")
        if is_new:
            writer.writeheader()
        writer.writerow(row)


class ProgressLine:
    """Prints the stage, the rate, the losses and, when measured, the validation of a run."""

    def __init__(self, options: TrainingOptions) -> None:
        self._minutes = "" if options.minutes is None else f"/{options.minutes:g}"
        self._steps = "" if options.steps is None else f"/{options.steps}"
        self._next = 0.0

    def __call__(self, row: Row) -> None:
        validation = {k[4:]: v for k, v in row.items() if k.startswith("val_")}
        if row["minutes"] < self._next and not validation:
            return
        self._next = row["minutes"] + _PROGRESS_MINUTES
        text = (
            f"{row['minutes']:6.1f}{self._minutes} min  {row['stage']:8s} "
            f"step {row['step']:6d}{self._steps}  "
        )
        if row["step"] > 0:
            details = {k: v for k, v in row.items() if k.startswith(("found", "epe"))}
            text += f"{row['pairs_per_second']:6.1f} pairs/s  loss {row['loss']:.3f}  "
            text += _join(details)
        if validation:
            text += "\n    validation  " + _join(validation)
        print(text, file=sys.stderr, flush=True)


def _join(figures: dict[str, float]) -> str:
    return "  ".join(f"{name} {value:.3f}" for name, value in figures.items())
