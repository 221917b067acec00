"""TOML, by the standard library; before Python 3.11 by tomli, which became it."""

import re
import sys
from pathlib import Path
from typing import Any

from dgc_pose.files.inputs import read_as

_MAX_TEXT = 2**20  # characters, as of YAML
_MAX_DOTS = 100  # in a key: its time grows with their square
_STRINGS = re.compile(r'"(?:\\.|[^"\\\n])*"|' + r"'[^'\n]*'")


def toml_data(text: str, path: Path) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises InputError, with the path and the line, for no TOML; also for a text of over a million
    characters, and for a key of many parts.
    """
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    with read_as("TOML", path):
        if len(text) > _MAX_TEXT:
            raise ValueError(f"{len(text)} characters, at most {_MAX_TEXT} are read")
        pieces = re.split(r"[,\n]", _STRINGS.sub("", text))  # a number has one dot, and a comma
        if max(piece.count(".") for piece in pieces) > _MAX_DOTS:
            raise ValueError(f"a key of over {_MAX_DOTS} parts")
        return tomllib.loads(text)
