"""The documentation names what is there: public names, sub-commands, files that are linked."""

import importlib.util
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import click
import pytest

import dgc_pose
from dgc_pose.cli.main import SECTIONS, SUBCOMMANDS, main
from dgc_pose.estimation.status import STATUSES

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
_LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(#[^)\s]*)?\)")


def load(name: str) -> ModuleType:
    """A module of docs/, which is no package."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def first_cells(page: Path, heading: str) -> set[str]:
    """The names in code in the first column of the table with this heading."""
    table = page.read_text(encoding="utf-8").split(heading)[1].split("\n\n")[0]
    cells = re.findall(r"^\|([^|]*)\|", table, re.MULTILINE)
    return set(re.findall(r"`([\w-]+)`", "".join(cells)))


def test_every_public_name_command_and_status_is_documented() -> None:
    reference = (DOCS / "library.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"^::: dgc_pose\.(\w+)$", reference, re.MULTILINE))
    assert documented == set(dgc_pose.__all__)
    assert first_cells(PAGES[0], "| command | what it does |") == {*SUBCOMMANDS}
    assert first_cells(DOCS / "glossary.md", "| status | meaning |") == {*STATUSES}
    without_t = {status for status, facts in STATUSES.items() if not facts.has_t}
    assert first_cells(DOCS / "quick-start.md", "| status |") == without_t


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_commands_exist(page: Path) -> None:
    """`make docs` checks the links between pages; this needs no mkdocs, and checks README's too. In
    code, `dgc-pose NAME` names a sub-command."""
    text = page.read_text(encoding="utf-8")
    for target, _ in _LINK.findall(text):
        if target and "://" not in target:
            assert (page.parent / target).is_file(), target
    named = set(re.findall(r"(?:^    |`)dgc-pose ([a-z][a-z-]+)", text, re.MULTILINE))
    assert named <= {*SUBCOMMANDS}


def test_the_help_of_every_command_is_in_the_reference() -> None:
    """On the page of the command's section, with each of its options."""
    hooks = load("hooks")
    for section, names in SECTIONS.items():
        page = DOCS / f"cli-{section.lower().replace(' ', '-')}.md"
        markdown = hooks.on_page_markdown(page.read_text(encoding="utf-8"))
        helps = dict(re.findall(r"^## (\S+)\n(.*?)(?=^## |\Z)", markdown, re.MULTILINE | re.DOTALL))
        assert [*helps] == [*names]
        for name, text in helps.items():
            command = main.get_command(click.Context(main), name)
            assert command is not None and f"Usage: dgc-pose {name}" in text
            words = {*re.split(r"[\s,/]+", text)}
            for option in command.params:
                if isinstance(option, click.Option) and not option.hidden:
                    assert {*option.opts} <= words, option


def test_quoted_outputs_are_what_the_tool_prints() -> None:
    """Else `make figures` brings them up to date."""
    figures = load("figures")
    pages = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
    blocks = [(name, *block) for name, text in pages.items() for block in figures.quoted(text)]
    assert [block[:2] for block in blocks] == [
        ("quick-start.md", marker) for marker in ("words", "output")
    ]
    printed = {command: figures.output(command) for command in {block[2] for block in blocks}}
    for name, marker, command, block in blocks:
        assert figures.agree(block, printed[command], marker), (name, block, printed[command])


def test_the_tables_of_relative_poses_are_those_of_results_csv() -> None:
    """Else `make figures` brings them up to date."""
    results = load("results")
    for page in results.PAGES:
        text = page.read_text(encoding="utf-8")
        assert results.TABLE.search(text), page
        assert results.TABLE.sub(results.table, text) == text, page


def test_the_first_pose_of_the_readme_runs_as_printed() -> None:
    """The command and the Python lines, in the repository's folder; both have the same pose."""
    section = (ROOT / "README.md").read_text(encoding="utf-8").split("## A first pose")[1]
    command = re.search(r"^    dgc-pose (.*?)\n\n", section, re.DOTALL | re.MULTILINE)
    snippet = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert command is not None and snippet is not None
    words = shlex.split(command[1].replace("\\\n", ""))
    json_text, printed = (
        subprocess.run(
            [sys.executable, *arguments], cwd=ROOT, check=True, capture_output=True, text=True
        ).stdout
        for arguments in (
            ["-m", "dgc_pose", *words, "--json", "-"],
            ["-c", snippet[1] + "print(pose.R.tolist(), pose.t.tolist())"],
        )
    )
    data = json.loads(json_text)
    assert data["success"] and data["probability"] > 0.9
    assert printed.splitlines()[-1] == f"{data['R']} {data['t']}"
