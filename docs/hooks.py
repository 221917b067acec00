"""Hooks of mkdocs, loaded by mkdocs.yml.

In a page, the commands of a section of `dgc-pose --help`, with their help texts, replace
`<!-- commands: SECTION -->`. A table of all commands replaces `<!-- sections -->`. The rows of a
table of the code replace `<!-- table: NAME -->`, below a heading in the page.
"""

import html
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from dgc_pose.cameras.formats.recognise import FORMATS
from dgc_pose.cli.main import SECTIONS, main
from dgc_pose.estimation.camera_model import MODELS, odds_text
from dgc_pose.matchers import MATCHERS

WIDTH = 88  # characters of a line
_COMMANDS = re.compile(r"<!-- commands: (.+) -->")
_SECTIONS = "<!-- sections -->"
MARK = re.compile(r"<!-- table: (.+) -->")
_NONE = 'alt="No description has been provided for this image"'


def on_page_markdown(markdown: str, **_: Any) -> str:
    markdown = _COMMANDS.sub(lambda mark: "\n".join(map(_reference, SECTIONS[mark[1]])), markdown)
    markdown = MARK.sub(lambda mark: "\n".join(map(_row, TABLES[mark[1]]())), markdown)
    return markdown.replace(_SECTIONS, _commands())


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _formats() -> Iterator[Sequence[str]]:
    for row in FORMATS:
        centre = "(0.5, 0.5)" if row.half_pixel else "(0, 0)"
        yield row.files, f"`{row.example}`", centre


def _matchers() -> Iterator[Sequence[str]]:
    for matcher in MATCHERS:
        yield f"`{matcher.name}`", matcher.about


def _camera_models() -> Iterator[Sequence[str]]:
    for model in MODELS.values():
        if model.opens:
            odds = model.odds.format(odds_text(model.log_odds))
            yield f"`{model.name}`", model.opens, odds


TABLES: Mapping[str, Callable[[], Iterator[Sequence[str]]]] = {
    "formats": _formats,
    "matchers": _matchers,
    "camera models": _camera_models,
}


def _commands() -> str:
    """A table of the commands, with links to their help."""
    lines = ["| section | command | what it does |", "|---|---|---|"]
    for section, commands in SECTIONS.items():
        page = f"cli-{section.lower().replace(' ', '-')}.md"
        title = f"[{section}]({page})"
        for name, text in commands.items():
            lines.append(f"| {title} | [`{name}`]({page}#{name}) | {text} |")
            title = ""
    return "\n".join(lines)


def _reference(name: str) -> str:
    """The help of a command under a heading."""
    settings = {**main.context_settings, "terminal_width": WIDTH}
    parent = click.Context(main, info_name="dgc-pose", **settings)
    command = main.get_command(parent, name)
    assert command is not None
    text = command.get_help(click.Context(command, parent, name))
    return f"## {name}\n\n```text\n{text}\n```\n"


def on_page_content(content: str, *, page: Any, **_: Any) -> str:
    """Add the alternative texts of a notebook's figures to its page.

    Jupyter keeps the texts in the metadata of the cells' outputs; the nbconvert template of
    mkdocs-jupyter ignores them.
    """
    path = Path(page.file.abs_src_path)
    if path.suffix == ".ipynb":
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        for output in (output for cell in cells for output in cell.get("outputs", [])):
            if picture := output.get("metadata", {}).get("image/jpeg"):
                content = content.replace(_NONE, f'alt="{html.escape(picture["alt"])}"', 1)
    return content
