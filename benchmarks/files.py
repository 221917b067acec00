"""Tables and data that are written."""

import math
from collections.abc import Mapping
from typing import Any

from dgc_pose.system.texts import finite_or_none


def decimals(value: float, digits: int) -> str:
    """The value with so many decimals; "-" for NaN and infinity."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def finite_data(data: Any) -> Any:
    """Data for `json_text`: None in place of every NaN and infinity, however deep."""
    if isinstance(data, Mapping):
        return {key: finite_data(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [finite_data(value) for value in data]
    return finite_or_none(data) if isinstance(data, float) else data


def split_names(text: str) -> list[str]:
    """The names in a comma-separated list, without blanks around them; empty ones are dropped."""
    return [name for name in (part.strip() for part in text.split(",")) if name]
