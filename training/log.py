"""Rates and figures of a run's steps: the CSV files that keep them, and the progress line."""

import csv
import sys
import time
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dgc_pose.files.outputs import writing
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.processes import joint_sum

_LONGEST_ROW = 4096  # bytes
_PROGRESS_MINUTES = 0.5  # between progress lines

Row = dict[str, Any]
Mark = float | torch.cuda.Event


class Meter:
    """Rates and figures of the steps since the last row. Nothing waits for a GPU until `row`."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._pairs = 0
        self._marks: list[tuple[Mark, Mark, Mark]] = []
        self._figures: dict[str, Tensor] = {}

    def mark(self) -> Mark:
        """A moment, by the clock of the GPU if the work is there."""
        if self._device.type != "cuda":
            return time.perf_counter()
        event = torch.cuda.Event(enable_timing=True)
        event.record()
        return event

    def add(self, pairs: int, marks: tuple[Mark, Mark, Mark], figures: dict[str, Tensor]) -> None:
        """A step: its pairs over all processes; when it began, had them, and ended; its figures."""
        self._pairs += pairs
        self._marks.append(marks)
        self._figures = figures

    def row(self) -> Row:
        """Rates of all processes together since the last row, the last step's figures."""
        making = sum(_seconds_between(began, made) for began, made, _ in self._marks)
        training = sum(_seconds_between(made, ended) for _, made, ended in self._marks)
        row: Row = {
            "pairs_per_second": _rate(self._pairs, making + training),
            "made_per_second": _rate(self._pairs, making),
            "trained_per_second": _rate(self._pairs, training),
        }
        row |= {name: float(joint_sum(part)) for name, part in self._figures.items()}
        self._pairs, self._marks, self._figures = 0, [], {}
        return row


def _seconds_between(first: Mark, second: Mark) -> float:
    """Waits until the GPU's work before the second mark is done."""
    if isinstance(first, torch.cuda.Event):
        assert isinstance(second, torch.cuda.Event)
        second.synchronize()
        return first.elapsed_time(second) / 1000
    assert isinstance(second, float)
    return second - first


def _rate(pairs: int, seconds: float) -> float:
    return pairs / seconds if seconds > 0 else float("nan")


def append(path: Path, row: Row) -> None:
    """Add a row to a CSV file; a new file gets the row's columns."""
    columns, is_new = list(row), not path.exists()
    if not is_new:
        _drop_half_row(path)
        with path.open(newline="") as file:
            columns = next(csv.reader(file), columns)
    with writing(path), path.open("a", newline="") as file:
        writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore")
        if is_new:
            writer.writeheader()
        writer.writerow(row)


def _drop_half_row(path: Path) -> None:
    """Cut off the end of a table that a kill left without its line break."""
    with path.open("rb+") as file:
        end = file.seek(0, 2)
        file.seek(max(0, end - _LONGEST_ROW))
        start, rows = file.tell(), file.read()
        if rows and not rows.endswith(b"\n"):
            file.truncate(start + rows.rfind(b"\n") + 1)


class ProgressLine:
    """Prints the stage, the rates, the losses and, when measured, the validation of a run."""

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
            text += (
                f"{row['pairs_per_second']:6.1f} pairs/s "
                f"(made {row['made_per_second']:.1f}, trained {row['trained_per_second']:.1f})  "
                f"loss {row['loss']:.3f}  " + _join(details)
            )
        if validation:
            text += "\n    validation  " + _join(validation)
        print(text, file=sys.stderr, flush=True)


def _join(figures: dict[str, float]) -> str:
    return "  ".join(f"{name} {value:.3f}" for name, value in figures.items())
