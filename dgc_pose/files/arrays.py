"""Arguments as NumPy arrays: from arrays, lists or torch tensors, without importing torch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dgc_pose.errors import InputError


def is_tensor(value: Any) -> bool:
    """Whether `value` has the methods of a torch tensor."""
    return all(hasattr(value, method) for method in ("detach", "cpu", "numpy"))


def as_numpy(value: Any, name: str) -> np.ndarray:
    """`value` as a NumPy array of booleans, integers or floats; shares memory if possible.

    Raises InputError, naming the argument `name`, if `value` is no array of real numbers.
    """
    try:
        if is_tensor(value):
            value = value.detach().cpu()
            # NumPy has no bfloat16.
            value = (value.float() if "bfloat16" in str(value.dtype) else value).numpy()
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{name} is not an array of numbers") from error
    if array.dtype.kind not in "buif":
        raise InputError(f"{name} is not an array of real numbers but {type(value).__name__}")
    return array


def quantiles(values: np.ndarray, *shares: float) -> list[float]:
    """As `numpy.quantile` of all values, of which there is one at least; without what it checks,
    which takes longer than the quantiles of a row of an image."""
    places = [share * (values.size - 1) for share in shares]
    below = [math.floor(place) for place in places]
    above = [math.ceil(place) for place in places]
    ordered = np.partition(values.ravel(), sorted({*below, *above}))
    return [
        float(ordered[low]) + (place - low) * (float(ordered[high]) - float(ordered[low]))
        for place, low, high in zip(places, below, above, strict=True)
    ]
