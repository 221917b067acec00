"""A run's state at a fifth of its size, for machines that only so much may be carried to."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

_SMALL = 4096  # values; smaller tensors (norms, biases, counters) stay as they are
_COMPACT = "compact"  # the key that marks such a state
_STEPS_AN_OCTAVE = 8.0  # of a coded moment: 32 octaves in a byte


def compacted(state: dict[str, Any]) -> dict[str, Any]:
    """What `Trainer.state` gives, smaller: a run goes on from it nearly as from the whole.

    Weights are in half precision. Of AdamW's moments the first, some ten steps' memory, starts
    anew from zero, by which the first steps are small ones; the second is kept to 5 %. The moving
    average starts anew from the weights.
    """
    lean = {key: value for key, value in state.items() if key not in ("average", "optimizer")}
    lean["module"] = _halved(state["module"])
    optimizer = state["optimizer"]
    lean["optimizer"] = {
        "param_groups": optimizer["param_groups"],
        "state": {
            index: {
                "step": moments["step"],
                "exp_avg_sq": _coded(moments["exp_avg_sq"]),
            }
            for index, moments in optimizer["state"].items()
        },
    }
    lean[_COMPACT] = True
    return lean


def expanded(state: dict[str, Any]) -> dict[str, Any]:
    """The inverse of `compacted` as far as there is one; any other state as it is."""
    if _COMPACT not in state:
        return state
    whole = {key: value for key, value in state.items() if key != _COMPACT}
    whole["module"] = _single(state["module"])
    moments = {}
    for index, kept in state["optimizer"]["state"].items():
        second = _decoded(kept["exp_avg_sq"])
        moments[index] = {
            "step": kept["step"],
            "exp_avg": torch.zeros_like(second),
            "exp_avg_sq": second,
        }
    whole["optimizer"] = {
        "param_groups": state["optimizer"]["param_groups"],
        "state": moments,
    }
    return whole


def _halved(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {
        key: value.half() if value.is_floating_point() and value.numel() >= _SMALL else value
        for key, value in tensors.items()
    }


def _single(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {k: v.float() if v.dtype == torch.float16 else v for k, v in tensors.items()}


def _coded(moment: Tensor) -> dict[str, Tensor]:
    """Positive values at a byte each: their logarithms, counted down from the largest's."""
    largest = moment.max().clamp(min=1e-38)
    octaves = (largest / moment.clamp(min=1e-38)).log2()
    return {"largest": largest, "code": (_STEPS_AN_OCTAVE * octaves).round().clamp(0, 255).byte()}


def _decoded(coded: dict[str, Tensor]) -> Tensor:
    return coded["largest"] * torch.exp2(-coded["code"].float() / _STEPS_AN_OCTAVE)
