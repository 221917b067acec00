"""The progress line of a run."""

from __future__ import annotations

import sys

from dgc_pose.training.log import Row
from dgc_pose.training.options import RunOptions


class ProgressLine:
    """A line every half minute: the stage, the rates, the losses and, when measured, validation."""

    def __init__(self, options: RunOptions) -> None:
        self._minutes = "" if options.minutes is None else f"/{options.minutes:g}"
        self._steps = "" if options.steps is None else f"/{options.steps}"
        self._next = 0.0

    def __call__(self, row: Row) -> None:
        validation = {k[4:]: v for k, v in row.items() if k.startswith("val_")}
        if row["minutes"] < self._next and not validation:
            return
        self._next = row["minutes"] + 0.5
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
