"""For the API reference: fields and properties as a table, doctest lines as code.

A Griffe extension, loaded by mkdocs.yml. The docstring's section "Attributes" describes the fields;
the table adds the help text of fields that are options of the commands.
"""

import importlib
import re
from dataclasses import MISSING, Field, fields
from typing import Any

import griffe

from dgc_pose.system.options import option_info

_ENTRY = re.compile(r"^    (?:    )?(\w+): (.*(?:\n {8,}\S.*)*)", re.MULTILINE)
_SECTION = "\n\nAttributes:\n"
_DOCTEST = re.compile(r"^>>> .*(?:\n.+)*", re.MULTILINE)  # with its output, to an empty line


class Attributes(griffe.Extension):
    """Completes the section of a dataclass's docstring with its fields and properties."""

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        if "dataclass" not in cls.labels or cls.docstring is None:
            return
        text, _, section = cls.docstring.value.partition(_SECTION)
        described = {name: " ".join(words.split()) for name, words in _ENTRY.findall(section)}
        module = importlib.import_module(cls.module.path)
        known = {field.name: field for field in fields(getattr(module, cls.name))}
        lines = []
        for name, attribute in cls.attributes.items():
            if name.startswith("_"):
                continue
            if name in known:
                field = known[name]
                info = option_info(field)
                words = info and info.help, described.get(name), _default(field)
                lines.append(f"    {name}: {' '.join(filter(None, words))}")
            elif "property" in attribute.labels and attribute.docstring is not None:
                lines.append(f"    {name}: {' '.join(attribute.docstring.value.split())}")
                attribute.docstring = None  # else the page lists the property twice
        cls.docstring.value = text + _SECTION + "\n".join(lines)

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = _DOCTEST.sub(_as_code, obj.docstring.value)


def _default(field: Field[Any]) -> str:
    if field.default is not MISSING:
        return f"(default `{field.default!r}`)"
    if field.default_factory is not MISSING:
        return f"(default `{field.default_factory.__name__}()`)"
    return ""


def _as_code(lines: re.Match[str]) -> str:
    """Doctest lines as a fenced block, without doctest's directives."""
    code = re.sub(r" *# doctest:.*", "", lines[0]).rstrip("\n")
    return f"```pycon\n{code}\n```\n"
