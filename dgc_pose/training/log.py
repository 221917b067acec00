"""What a run says of itself: a row every few steps, and the files that keep the rows."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dgc_pose.training.processes import joint_sum
from dgc_pose.training.stopwatch import Mark, mark, seconds_between

Row = dict[str, Any]


class Meter:
    """Rates and figures of the steps since the last row. Nothing waits for a GPU until `row`."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._pairs = 0
        self._marks: list[tuple[Mark, Mark, Mark]] = []
        self._figures: dict[str, Tensor] = {}

    def mark(self) -> Mark:
        return mark(self._device)

    def add(self, pairs: int, marks: tuple[Mark, Mark, Mark], figures: dict[str, Tensor]) -> None:
        """A step: its pairs over all processes; when it began, had them, and ended; its figures."""
        self._pairs += pairs
        self._marks.append(marks)
        self._figures = figures

    def row(self) -> Row:
        """Rates of all processes together since the last row, the last step's figures."""
        making = sum(seconds_between(began, made) for began, made, _ in self._marks)
        training = sum(seconds_between(made, ended) for _, made, ended in self._marks)
        row: Row = {
            "pairs_per_second": _rate(self._pairs, making + training),
            "made_per_second": _rate(self._pairs, making),
            "trained_per_second": _rate(self._pairs, training),
        }
        row |= {name: float(joint_sum(part)) for name, part in self._figures.items()}
        self._pairs, self._marks, self._figures = 0, [], {}
        return row


def _rate(pairs: int, seconds: float) -> float:
    return pairs / seconds if seconds > 0 else float("nan")


def append(path: Path, row: Row) -> None:
    """Add a row to a CSV file, which is made with the row's columns where it is not there."""
    columns = list(row)
    if path.exists():
        with path.open(newline="") as file:
            columns = next(csv.reader(file), columns)
    is_new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore")
        if is_new:
            writer.writeheader()
        writer.writerow(row)
