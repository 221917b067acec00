"""A file of cameras, opened once for all formats."""

import json
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from dgc_pose.errors import InputError
from dgc_pose.system.files import read_text
from dgc_pose.system.texts import toml_data, yaml_data


class CameraFile:
    """A file of cameras, or the folder of a COLMAP model.

    The properties raise InputError, with the path, if the file is empty, or is damaged TOML or
    YAML; ValueError or ElementTree.ParseError for damaged JSON or XML; OSError if it cannot be
    read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ending = path.suffix.lower()

    @cached_property
    def text(self) -> str:
        """The text; "" for a folder or a binary file."""
        if self.path.is_dir() or self.ending in (".npy", ".bin"):
            return ""
        text = read_text(self.path, "a file of cameras")
        if not text.strip():
            raise InputError(self.path, "is empty")
        return text

    @cached_property
    def lines(self) -> list[str]:
        """The lines without comments, at least one."""
        lines = [line.split("#")[0] for line in self.text.splitlines()]
        return [line for line in lines if line.strip()] or [""]

    @property
    def has_data(self) -> bool:
        """Whether the text is TOML, JSON, YAML, or XML of OpenCV."""
        return self._syntax != ""

    @cached_property
    def data(self) -> Any:
        """The data of such a text, mostly a dict; None for another file."""
        if self._syntax == "toml":
            return toml_data(self.text, self.path)
        if self._syntax == "xml":
            return _xml_data(ElementTree.fromstring(self.text))
        if self._syntax == "json":
            return json.loads(self.text)
        if self._syntax == "yaml":
            return yaml_data(self.text, self.path)
        return None

    @cached_property
    def _syntax(self) -> str:
        text = self.text
        if self.ending == ".toml":
            return "toml"
        if "<opencv_storage>" in text:
            return "xml"
        if self.ending == ".json" or text.lstrip().startswith("{"):
            return "json"
        if self.ending in (".yaml", ".yml") or text.startswith("%YAML"):
            return "yaml"
        return ""


def _xml_data(node: ElementTree.Element) -> Any:
    """The values in XML from cv::FileStorage, in the structure of its YAML and JSON."""
    return {child.tag: _xml_data(child) for child in node} if len(node) else node.text
