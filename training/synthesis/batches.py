"""Operations on all tensors of a dataclass at once."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

Batch = TypeVar("Batch")


def combined(parts: Sequence[Batch], combine: Callable[[list[Tensor]], Tensor]) -> Batch:
    """A dataclass of the parts' tensors, each combined; other fields are the first part's."""
    first: Any = parts[0]
    names = [f.name for f in fields(first) if isinstance(getattr(first, f.name), Tensor)]
    tensors = {name: combine([getattr(part, name) for part in parts]) for name in names}
    result: Batch = replace(first, **tensors)
    return result


def changed(batch: Batch, change: Callable[[Tensor], Tensor]) -> Batch:
    """A dataclass with every tensor changed."""
    return combined([batch], lambda tensors: change(tensors[0]))


def joined(parts: Sequence[Batch]) -> Batch:
    """Several batches, one after the other."""
    return combined(parts, torch.cat)
