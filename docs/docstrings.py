"""For the API reference: fields and properties of dataclasses as a list, doctest lines as code.

A Griffe extension, loaded by mkdocs.yml. The code documents a field by the comment behind it or by
the comment lines above it, where shapes and units are.
"""

import re
from typing import Any

import griffe

_BEHIND = re.compile(r"\s{2}# (.*)$")
_ABOVE = re.compile(r"^\s*# ?(.*)$")
_FACTORY = re.compile(r"field\(default_factory=(\w+)\)")
_DOCTEST = re.compile(r"(?:^>>> .*\n?)+", re.MULTILINE)


class SourceComments(griffe.Extension):
    """Adds to the docstring of each dataclass a section with its fields and properties."""

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        if "dataclass" not in cls.labels or cls.docstring is None:
            return
        lines = []
        for name, attribute in cls.attributes.items():
            if name.startswith("_"):
                continue
            if "property" not in attribute.labels:
                lines.append(f"    {name}: {_comment(attribute)}")
            elif attribute.docstring is not None:
                lines.append(f"    {name}: {' '.join(attribute.docstring.value.split())}")
                attribute.docstring = None  # else the property would be listed once more
        cls.docstring.value += "\n\nAttributes:\n" + "\n".join(lines)

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = _DOCTEST.sub(_as_code, obj.docstring.value)


def _comment(attribute: griffe.Attribute) -> str:
    """The comment lines above a field, then the comment behind it, then the default."""
    assert attribute.lineno is not None and attribute.endlineno is not None
    lines = attribute.lines_collection[attribute.filepath]  # type: ignore[index]
    comment: list[str] = []
    row = attribute.lineno - 2
    while row >= 0 and (above := _ABOVE.match(lines[row])):
        comment.insert(0, above[1])
        row -= 1
    if behind := _BEHIND.search(lines[attribute.endlineno - 1]):
        comment.append(behind[1])
    if attribute.value is not None:
        default = _FACTORY.sub(r"\1()", str(attribute.value))
        comment.append(f"(default `{default}`)")
    return " ".join(comment)


def _as_code(lines: re.Match[str]) -> str:
    """Doctest lines as a fenced block, without doctest's own directives."""
    code = re.sub(r" *# doctest:.*", "", lines[0]).rstrip("\n")
    return f"```pycon\n{code}\n```\n"
