"""The documentation names what is there: public names, sub-commands, files that are linked."""

import importlib.util
import json
import re
import shlex
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import pytest
from command_line import run

import dgc_pose
from dgc_pose.cli.main import SECTIONS, SUBCOMMANDS, main
from dgc_pose.estimation.status import STATUSES

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = {page: page.read_text("utf-8") for page in (ROOT / "README.md", *DOCS.glob("*.md"))}


def load(name: str) -> ModuleType:
    """A module of docs/, which is no package."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def first_cells(page: Path, heading: str) -> set[str]:
    """The names in code in the first column of the table with this heading."""
    table = PAGES[page].split(heading)[1].split("\n\n")[0]
    cells = re.findall(r"^\|([^|]*)\|", table, re.MULTILINE)
    return set(re.findall(r"`([\w-]+)`", "".join(cells)))


def test_every_public_name_command_and_status_is_documented() -> None:
    documented = re.findall(r"^::: dgc_pose\.(\w+)$", PAGES[DOCS / "library.md"], re.MULTILINE)
    assert {*documented} == {*dgc_pose.__all__}
    assert first_cells(ROOT / "README.md", "| command | what it does |") == {*SUBCOMMANDS}
    assert first_cells(DOCS / "quick-start.md", "| status |") == {*STATUSES}


def test_links_lead_to_files_and_commands_exist() -> None:
    """`make docs` checks the links between pages; this needs no mkdocs, and checks README's too. In
    code, `dgc-pose NAME` names a sub-command."""
    for page, text in PAGES.items():
        for target in re.findall(r"\[[^\]]*\]\(([^)#\s]+)", text):
            assert "://" in target or (page.parent / target).is_file(), (page, target)
        named = re.findall(r"(?:^    |`)dgc-pose ([a-z][a-z-]+)", text, re.MULTILINE)
        assert {*named} <= {*SUBCOMMANDS}, page


def test_the_help_of_every_command_is_in_the_reference() -> None:
    """On the page of the command's section, with each of its options."""
    hooks = load("hooks")
    for section, names in SECTIONS.items():
        page = DOCS / f"cli-{section.lower().replace(' ', '-')}.md"
        markdown = hooks.on_page_markdown(PAGES[page])
        helps = dict(re.findall(r"^## (\S+)\n(.*?)(?=^## |\Z)", markdown, re.MULTILINE | re.DOTALL))
        assert [*helps] == [*names]
        for name, text in helps.items():
            command = main.get_command(click.Context(main), name)
            assert command is not None and f"Usage: dgc-pose {name}" in text
            words = {*re.split(r"[\s,/]+", text)}
            for option in command.params:
                if isinstance(option, click.Option) and not option.hidden:
                    assert {*option.opts} <= words, option


def test_quoted_outputs_and_the_first_pose_of_the_readme_are_what_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the repository's folder, but for numbers, which differ between processors (`make figures`
    brings them up to date); the Python lines have the pose of the command."""
    monkeypatch.chdir(ROOT)
    figures = load("figures")
    blocks = [block for text in PAGES.values() for block in figures.BLOCK.findall(text)]
    (_, first, quoted), (_, second, quoted2) = blocks
    section = PAGES[ROOT / "README.md"].split("## A first pose")[1]
    assert f"    {first}\n\n" in section
    done = run(*shlex.split(first)[1:], "--json", tmp_path / "pose.json")
    assert figures.words(done.stdout.strip()) == figures.words(quoted), done.stderr
    assert figures.words(figures.output(second)) == figures.words(quoted2)
    data = json.loads((tmp_path / "pose.json").read_text())
    assert data["success"] and data["probability"] > 0.9
    snippet = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert snippet is not None
    names: dict[str, Any] = {}
    exec(snippet[1], names)
    assert (names["pose"].R.tolist(), names["pose"].t.tolist()) == (data["R"], data["t"])
