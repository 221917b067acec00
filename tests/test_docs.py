"""The documentation names what is there: public names, sub-commands, files that are linked."""

import csv
import importlib.util
import json
import math
import os
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from datetime import datetime
from pathlib import Path
from types import ModuleType

import click
import pytest

import dgc_pose
from dgc_pose.benchmarks.scores import RESULTS, PairScore
from dgc_pose.benchmarks.summary import summarise, summary_data
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


def test_every_public_name_is_in_the_library_reference() -> None:
    reference = (DOCS / "library.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"^::: dgc_pose\.(\w+)$", reference, re.MULTILINE))
    assert documented == set(dgc_pose.__all__)


def test_the_table_of_commands_in_the_readme_is_complete() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    table = readme.split("| command | what it does |")[1].split("\n\n")[0]
    first_cells = re.findall(r"^\|([^|]*)\|", table, re.MULTILINE)
    assert set(re.findall(r"`([\w-]+)`", "".join(first_cells))) == {*SUBCOMMANDS}


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 130


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page: Path) -> None:
    """`make docs` checks the links between pages; this needs no mkdocs, and checks README's too."""
    for target, _ in _LINK.findall(page.read_text(encoding="utf-8")):
        if target and "://" not in target:
            assert (page.parent / target).is_file(), target


def test_commands_in_the_texts_exist() -> None:
    """In code, `dgc-pose NAME` names a sub-command."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        named = set(re.findall(r"(?:^    |`)dgc-pose ([a-z][a-z-]+)", text, re.MULTILINE))
        assert named <= {*SUBCOMMANDS}, page.name


def test_every_page_is_in_the_navigation() -> None:
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    navigation = set(re.findall(r": ([\w-]+\.(?:md|ipynb))$", settings, re.MULTILINE))
    assert navigation == {page.name for kind in ("*.md", "*.ipynb") for page in DOCS.glob(kind)}


def test_the_help_of_every_command_is_in_the_reference() -> None:
    """On the page of the command's section, with each of its options."""
    commands = load("commands")
    for section, names in SECTIONS.items():
        page = DOCS / f"cli-{section.lower().replace(' ', '-')}.md"
        markdown = commands.on_page_markdown(page.read_text(encoding="utf-8"))
        helps = dict(re.findall(r"^## (\S+)\n(.*?)(?=^## |\Z)", markdown, re.MULTILINE | re.DOTALL))
        assert [*helps] == [*names]
        for name, text in helps.items():
            command = main.get_command(click.Context(main), name)
            assert command is not None and f"Usage: dgc-pose {name}" in text
            words = {*re.split(r"[\s,/]+", text)}
            for option in command.params:
                if isinstance(option, click.Option) and not option.hidden:
                    assert {*option.opts} <= words, option


def test_the_overview_of_the_reference_links_every_command() -> None:
    overview = load("commands").on_page_markdown((DOCS / "cli.md").read_text(encoding="utf-8"))
    links = re.findall(r"\[`([\w-]+)`\]\(([\w-]+\.md)#([\w-]+)\)", overview)
    assert [name for name, _, _ in links] == [*SUBCOMMANDS]
    for name, page, anchor in links:
        assert anchor == name and (DOCS / page).is_file()


@pytest.fixture(scope="module")
def figures() -> ModuleType:
    """What `make figures` runs."""
    return load("figures")


def test_quoted_outputs_are_what_the_tool_prints(figures: ModuleType) -> None:
    """Else `make figures` brings them up to date."""
    pages = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
    blocks = [(name, *block) for name, text in pages.items() for block in figures.quoted(text)]
    assert ("quick-start.md", figures.DEMO) in {block[:2] for block in blocks}
    printed = {command: figures.output(command) for command in {block[1] for block in blocks}}
    for name, command, block in blocks:
        assert figures.agree(block, printed[command]), (name, block, printed[command])


@pytest.mark.parametrize(
    ("other", "same"),
    [
        ("  t  [-0.954951 -0.000001]\n601 of 609 inliers\nload 12.16 s, match 0.50 s", True),
        ("  t  [-0.924898 -0.000002]\n602 of 610 inliers\nload 0.16 s, match 0.62 s", False),
        ("  t  [-0.954898 -0.000002]\n642 of 656 inliers\nload 0.16 s, match 0.62 s", False),
        ("  t  [-0.954898 -0.000002]\n602 of 610 matches\nload 0.16 s, match 0.62 s", False),
        ("  t  [-0.954898 -0.000002]\n602 of 610 inliers\nload 0.16 s", False),
    ],
)
def test_outputs_agree_to_what_differs_between_processors(
    figures: ModuleType, other: str, same: bool
) -> None:
    text = "  t  [-0.954898 -0.000002]\n602 of 610 inliers\nload 0.16 s, match 0.62 s"
    assert figures.agree(text, other) == same


def test_quoted_outputs_are_replaced_between_their_fences(figures: ModuleType) -> None:
    """One that differs in its times alone stays."""
    page = "a\n\n<!-- output of: dgc-pose {} -->\n```text\n{}\n```\n\n```\nb\n```\n"
    before = page.format("demo", "old\nold") + page.format("info", "") + page.format("x", "0.12 s")
    after = (
        page.format("demo", "demo\n") + page.format("info", "info\n") + page.format("x", "0.12 s")
    )
    printed = {"demo": "demo\n", "info": "info\n", "x": "3.45 s"}
    assert figures.renewed(before, lambda command: printed[command.split()[1]]) == after
    assert list(figures.quoted(after))[1] == ("dgc-pose info", "info\n")


@pytest.mark.parametrize(
    ("page", "heading", "statuses"),
    [
        ("glossary.md", "| status | meaning |", {*STATUSES}),
        ("quick-start.md", "| status |", {s for s, facts in STATUSES.items() if not facts.has_t}),
    ],
)
def test_the_tables_of_statuses_are_complete(page: str, heading: str, statuses: set[str]) -> None:
    table = (DOCS / page).read_text(encoding="utf-8").split(heading)[1].split("\n\n")[0]
    first_cells = re.findall(r"^\|([^|]*)\|", table, re.MULTILINE)
    assert set(re.findall(r"`(\w+)`", "".join(first_cells))) == statuses


@pytest.fixture
def results() -> ModuleType:
    """What writes the tables of relative poses."""
    return load("results")


def test_the_tables_of_relative_poses_are_those_of_results_csv(results: ModuleType) -> None:
    """Else `make figures` brings them up to date."""
    for page in results.PAGES:
        text = page.read_text(encoding="utf-8")
        assert results.TABLE.search(text), page
        assert results.TABLE.sub(results.table, text) == text, page


def test_the_figures_of_results_csv_come_of_runs(
    results: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, page = tmp_path / "results.csv", tmp_path / "page.md"
    heading = f"run,list,method,readme,{','.join(results.FIGURES)}\n"
    rows = ('a,"A, 1",ours,yes', 'a,"A, 1",sift,yes', "b,B,ours,yes", "b,B,sift,")
    table.write_text(heading + "".join(f"{row}{10 * ',9'}\n" for row in rows))
    page.write_text("<!-- table of: results.csv, in short -->\n\n| old |\n\nend\n")
    errors = {"ours": [(0.5, 178), (1, 2), (0, 12)], "sift": [(4, 3), None, None]}
    for run in ("a", "b"):
        _write_run(tmp_path / run, errors)
    monkeypatch.setattr(results, "RESULTS", table)
    monkeypatch.setattr(results, "PAGES", [page])
    results.main(str(tmp_path))
    ours = "2026-02-03,3,0,2,0.50,12.00,2.00,46.7,56.7,83.3\n"
    sift = "2026-02-03,3,2,0,inf,inf,inf,20.0,26.7,30.0\n"
    found = [row + "," + (ours if "ours" in row else sift) for row in rows]
    assert table.read_text() == heading + "".join(found)
    cells = "`ours` | 3 | 0 | 2 | 0.50 | 2.00 | 46.7 | 56.7 | 83.3 |\n"
    assert page.read_text() == (
        "<!-- table of: results.csv, in short -->\n\n| list, measured 2026-02-03 | method | pairs "
        "| failures | wrong | R | t folded | AUC@5 | AUC@10 | AUC@20 |\n" + 10 * "| --- " + "|\n"
        f"| A, 1 | {cells}|  | `sift` | 3 | 2 | 0 | inf | inf | 20.0 | 26.7 | 30.0 |\n"
        f"| B | {cells}\nend\n"
    )


def _write_run(folder: Path, errors: dict[str, list[tuple[float, float] | None]]) -> None:
    """The files of bench-pairs that are read. errors: of each method those of R and t of each pair,
    None without a pose."""
    scores: dict[str, list[PairScore]] = {}
    for method, pairs in errors.items():
        for pair in pairs:
            rotation, translation = pair or (math.inf, math.inf)
            values = {field.name: 0 for field in fields(PairScore)}
            values |= {"method": method, "success": pair is not None}
            values |= {"rotation_error_deg": rotation, "translation_error_deg": translation}
            values["translation_folded_deg"] = min(translation, abs(180 - translation))
            scores.setdefault(method, []).append(PairScore(**values))
    folder.mkdir()
    with (folder / RESULTS).open("w", newline="") as stream:
        writer = csv.DictWriter(stream, PairScore.tables[RESULTS])
        writer.writeheader()
        writer.writerows(vars(score) for rows in scores.values() for score in rows)
    summary = folder / "summary.json"
    summary.write_text(json.dumps(summary_data([summarise(rows) for rows in scores.values()])))
    noon = datetime(2026, 2, 3, 12).timestamp()
    os.utime(summary, (noon, noon))


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
