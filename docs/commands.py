"""For the command-line reference: the help of each command as a terminal shows it.

A hook, loaded by mkdocs.yml. In a page `<!-- commands: SECTION -->` stands for the commands of a
section of `dgc-pose --help`, and `<!-- sections -->` for a table of all.
"""

import re
from typing import Any

import click

from dgc_pose.cli.main import SECTIONS, main

WIDTH = 88  # characters of a line
_COMMANDS = re.compile(r"<!-- commands: (.+) -->")
_SECTIONS = "<!-- sections -->"


def on_page_markdown(markdown: str, **_: Any) -> str:
    markdown = _COMMANDS.sub(lambda mark: "\n".join(map(_reference, SECTIONS[mark[1]])), markdown)
    return markdown.replace(_SECTIONS, _table())


def _table() -> str:
    """Each command with a link to its help."""
    lines = ["| section | command | what it does |", "|---|---|---|"]
    for section, commands in SECTIONS.items():
        page = f"cli-{section.lower().replace(' ', '-')}.md"
        title = f"[{section}]({page})"
        for name, text in commands.items():
            lines.append(f"| {title} | [`{name}`]({page}#{name}) | {text} |")
            title = ""
    return "\n".join(lines)


def _reference(name: str) -> str:
    """A command under a heading."""
    settings = {**main.context_settings, "terminal_width": WIDTH}
    parent = click.Context(main, info_name="dgc-pose", **settings)
    command = main.get_command(parent, name)
    assert command is not None
    text = command.get_help(click.Context(command, parent, name))
    return f"## {name}\n\n```text\n{text}\n```\n"
