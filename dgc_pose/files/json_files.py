"""JSON, which has no NaN and no infinity."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dgc_pose.files.inputs import read_as, read_text
from dgc_pose.files.outputs import write_text


def read_json(path: str | Path, what: str) -> Any:
    """The content of a JSON file. Raises as `read_text` does, and InputError for no JSON."""
    text = read_text(path, what)
    with read_as(what, path):
        return json.loads(text)


def json_text(data: Mapping[str, Any]) -> str:
    """Strict JSON, a newline at its end. Raises ValueError for NaN and infinity."""
    return json.dumps(data, indent=2, allow_nan=False) + "\n"


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a JSON file whole or not at all. Raises as `json_text` and `staged` do."""
    write_text(path, json_text(data))


def finite_or_none(value: float | None) -> float | None:
    """The value as a float; None for NaN and infinity."""
    return None if value is None or not math.isfinite(value) else float(value)
