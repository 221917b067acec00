"""Texts: JSON without NaN and infinity, YAML by PyYAML, TOML, and aligned tables."""

import json
import math
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dgc_pose.system.files import read_as, read_text, write_text

_MAX_TEXT = 2**20  # characters of YAML and TOML; a calibration has a few thousand
_MAX_DOTS = 100  # in a key of TOML: the time to parse it grows with their square
_STRINGS = re.compile(r'"(?:\\.|[^"\\\n])*"|' + r"'[^'\n]*'")


def read_json(path: str | Path, what: str) -> Any:
    """The content of a JSON file. Raises as `read_text` does, and InputError if it is not JSON."""
    text = read_text(path, what)
    with read_as(what, path):
        return json.loads(text)


def json_text(data: Mapping[str, Any]) -> str:
    """Strict JSON with a newline at its end. Raises ValueError for NaN and infinity."""
    return json.dumps(data, indent=2, allow_nan=False) + "\n"


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a JSON file whole or not at all. Raises as `json_text` and `staged` do."""
    write_text(path, json_text(data))


def finite_or_none(value: float | None) -> float | None:
    """The value as a float; None for NaN and infinity."""
    return None if value is None or not math.isfinite(value) else float(value)


def yaml_data(text: str, path: Path) -> Any:
    """The first document of a YAML text. Matrices of cv::FileStorage become mappings.

    Raises InputError, with the path, if it is not YAML, has aliases or over a million characters.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        """A loader that also reads OpenCV's YAML."""

    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        Loader.add_constructor(
            f"tag:yaml.org,2002:{tag}",
            lambda loader, node: loader.construct_mapping(node, deep=True),
        )
    with read_as("YAML", path):
        _require_short(text)
        if text.startswith("%YAML:"):
            text = text.partition("\n")[2]
        # A few lines of aliases of aliases could become lists of any length.
        if "*" in text and any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text)):
            raise ValueError("it contains an alias, which is not supported")
        return next(yaml.load_all(text, Loader=Loader), None)


def toml_data(text: str, path: Path) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises InputError, with the path and the line, if the text is not TOML; also if it has over a
    million characters or a key of many parts.
    """
    # tomli became the standard library's tomllib.
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    with read_as("TOML", path):
        _require_short(text)
        pieces = re.split(r"[,\n]", _STRINGS.sub("", text))  # a number has one dot, and a comma
        if max(piece.count(".") for piece in pieces) > _MAX_DOTS:
            raise ValueError(f"a key of over {_MAX_DOTS} parts")
        return tomllib.loads(text)


def _require_short(text: str) -> None:
    if len(text) > _MAX_TEXT:
        raise ValueError(f"{len(text)} characters, and the limit is {_MAX_TEXT}")


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of equal length as lines: the first column aligned left, all others right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = (
        [row[0].ljust(widths[0])]
        + [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        for row in rows
    )
    return "\n".join("  ".join(line).rstrip() for line in lines)
