"""The documentation names what is there: public names, sub-commands, files that are linked."""

import ast
import configparser
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
from dgc_pose.estimation.camera_model import MODELS
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


def test_tables_of_the_code_continue_a_table_of_their_page() -> None:
    """Each row has as many cells as the heading above the mark; no row stands twice."""
    hooks = load("hooks")
    marks = [(page, mark) for page, text in PAGES.items() for mark in hooks.MARK.findall(text)]
    assert sorted(mark for _, mark in marks) == sorted(hooks.TABLES)
    for page, mark in marks:
        above, below = PAGES[page].split(f"<!-- table: {mark} -->")
        rows = hooks.on_page_markdown(f"<!-- table: {mark} -->").splitlines()
        heading = above.split("\n\n")[-1].splitlines()[0]
        assert below.startswith("\n\n") and heading.startswith("|")
        assert {line.count("|") for line in rows} == {heading.count("|")}
        assert len({line.split("|")[1] for line in rows}) == len(rows)
    described = {model.name for model in MODELS.values() if model.opens and model.odds}
    assert described == MODELS.keys() - {"assumed"}


def test_the_picture_of_the_floors_has_the_layers_of_the_linter() -> None:
    """From above, and on a floor from the left."""
    settings = configparser.ConfigParser()
    settings.read(ROOT / "setup.cfg")
    layers = settings["importlinter:contract:layers"]["layers"]
    drawn = re.findall(r'class="package">(\w+)<', (DOCS / "floors.svg").read_text("utf-8"))
    assert ["__main__", *drawn] == re.findall(r"\w+", layers)


def test_the_architecture_names_what_is_in_the_code() -> None:
    """`FILE.py: NAME`, `FILE.py` and `CLASS.METHOD`; names in capitals stand for others."""
    page = PAGES[DOCS / "architecture.md"]
    named = re.findall(r"`([\w/]+\.py)(?:: ([\w.]+))?`", page)
    assert len(named) > 50
    methods = set[str]()
    for path, name in named:
        if "NAME" in path:
            continue
        file = next(p for p in (ROOT / "dgc_pose" / path, ROOT / path) if p.is_file())
        names = defined(file)
        methods |= names
        assert not name or name in names, (path, name)
    assert {*re.findall(r"`([A-Z]\w+\.[a-z_]\w+)`", page)} <= methods


def test_the_first_change_of_a_contributor_is_one_line_that_a_test_holds() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    change = re.search(r"sed -i 's/(\^.*?)/.*' (\S+)", text)
    failing = re.search(r"FAILED (\S+)::(\w+)", text)
    assert change is not None and failing is not None
    code = (ROOT / change[2]).read_text("utf-8")
    assert len(re.findall(change[1], code, re.MULTILINE)) == 1
    assert failing[2] in defined(ROOT / failing[1])


def defined(path: Path) -> set[str]:
    """The names at the top of a module, and the methods of its classes as CLASS.METHOD."""
    names = set[str]()
    for node in ast.parse(path.read_text("utf-8")).body:
        if isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            methods = [item for item in node.body if isinstance(item, ast.FunctionDef)]
            names |= {f"{node.name}.{method.name}" for method in methods}
    return names


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
