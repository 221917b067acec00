"""YAML, by PyYAML."""

from pathlib import Path
from typing import Any

from dgc_pose.files.inputs import read_as

_MAX_TEXT = 2**20  # characters: a calibration has a few thousand


def yaml_data(text: str, path: Path) -> Any:
    """The first document of a YAML text, also of cv::FileStorage, whose matrices are mappings.

    Raises InputError, with the path, for no YAML, and for a text of over a million characters.
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
        if len(text) > _MAX_TEXT:
            raise ValueError(f"{len(text)} characters, at most {_MAX_TEXT} are read")
        if text.startswith("%YAML:"):
            text = text.partition("\n")[2]
        # A few lines of aliases of aliases would be lists of any length.
        if "*" in text and any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text)):
            raise ValueError("an alias, which no calibration has")
        return next(yaml.load_all(text, Loader=Loader), None)
