"""For the command-line reference: the help of each command as Markdown, its options as tables.

A hook, loaded by mkdocs.yml. In a page `<!-- commands: SECTION -->` stands for the commands of a
section of `dgc-pose --help`, and `<!-- sections -->` for a table of all.
"""

import html
import re
from collections.abc import Sequence
from typing import Any

import click

from dgc_pose.cli.main import SECTIONS, main

_COMMANDS = re.compile(r"<!-- commands: (.+) -->")
_SECTIONS = "<!-- sections -->"
_FLAG = re.compile(r"(?<![\w-])--?[A-Za-z][\w-]*")
_EXTRA = re.compile(r"\s*\[([^\[\]]+)\]$")  # such as [default: 5; x>=1]


class MarkdownFormatter(click.HelpFormatter):
    """Writes what click writes of a command for a terminal."""

    def write_usage(self, prog: str, args: str = "", prefix: str | None = None) -> None:
        self.write(f"```bash\n{prog} {args}\n```\n")

    def write_heading(self, heading: str) -> None:
        self.write(f"**{heading}**\n\n")

    def write_paragraph(self) -> None:
        self.write("\n")

    def write_text(self, text: str) -> None:
        for paragraph in text.split("\n\n"):
            if paragraph.startswith("\b"):  # click's mark of lines that stay as they are
                self.write(f"```text\n{paragraph[1:].strip()}\n```\n\n")
            else:
                self.write(f"{_words(paragraph)}\n\n")

    def write_dl(self, rows: Sequence[tuple[str, str]], *_: Any, **__: Any) -> None:
        self.write('<table class="options">\n')
        for option, meaning in rows:
            extra = _EXTRA.search(meaning)
            text = _words(meaning if extra is None else meaning[: extra.start()])
            text += "" if extra is None else f" {_code(extra[1])}"
            self.write(f'<tr><th scope="row">{_code(option.strip())}</th><td>{text}</td></tr>\n')
        self.write("</table>\n")


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
    parent = click.Context(main, info_name="dgc-pose", **main.context_settings)
    command = main.get_command(parent, name)
    assert command is not None
    formatter = MarkdownFormatter()
    command.format_help(click.Context(command, parent, name), formatter)
    return f"## {name}\n\n{formatter.getvalue()}"


def _words(text: str) -> str:
    """A text of a help, with its options as code."""
    parts, end = [], 0
    for flag in _FLAG.finditer(text):
        parts += [_plain(text[end : flag.start()]), _code(flag[0])]
        end = flag.end()
    return "".join([*parts, _plain(text[end:])])


def _plain(text: str) -> str:
    """A text without anything that Markdown would read."""
    return re.sub(r"[*_|`\[\]]", lambda mark: f"&#{ord(mark[0])};", html.escape(text, quote=False))


def _code(text: str) -> str:
    return f"<code>{_plain(text)}</code>"
