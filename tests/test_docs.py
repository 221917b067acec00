"""The documentation names what is there: public names, sub-commands, files that are linked."""

import ast
import configparser
import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import numpy as np
import pytest
from command_line import run

import dgc_pose
from dgc_pose.cameras.pair_list import rendered_pair
from dgc_pose.cli.main import SECTIONS, SUBCOMMANDS, main
from dgc_pose.estimation.camera_model import MODELS
from dgc_pose.estimation.status import STATUSES
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

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
    described = {model.name for model in MODELS.values() if model.opens}
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


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What `demo` prints of the bundled pairs, with paths as from the repository."""
    picture = tmp_path_factory.mktemp("demo") / "p.png"
    result = run("demo", "--plot", picture)
    assert result.exit_code == 0 and picture.stat().st_size > 10_000
    folder = Path(dgc_pose.__file__).parents[1]
    text = result.stdout.replace(f"{folder}/", "").replace(f" --plot {picture}", "")
    return "\n".join(line.rstrip() for line in text.splitlines())


def poses_of(demo: str) -> np.ndarray:
    """R, and t as a fourth row, (N, 4, 3), of each pose that is printed."""
    rows = re.findall(r"^  [Rt]  \[(.*?)\]", demo, re.MULTILINE)
    return np.array([row.split() for row in rows], float).reshape(-1, 4, 3)


def test_quoted_outputs_are_what_the_tool_prints(demo: str) -> None:
    """But for numbers, which differ between processors; `make figures` brings them up to date."""
    figures = load("figures")
    blocks = [block for text in PAGES.values() for block in figures.BLOCK.findall(text)]
    assert len(blocks) == 2
    for _, command, block in blocks:
        assert figures.words(f"\n{command}\n\n{block}\n") in figures.words(demo)


def test_the_known_pose_of_the_rendered_pair_is_printed_and_found(demo: str) -> None:
    _, found, known = poses_of(demo)
    pair = rendered_pair()
    np.testing.assert_allclose(known[:3], pair.R, atol=1e-6)
    assert rotation_error_deg(found[:3], pair.R) < 0.5
    assert translation_error_deg(found[3], known[3]) < 2
    for name, camera in (("K1", pair.camera1), ("K2", pair.camera2)):
        numbers = re.search(rf"--{name} (\S+)", demo)
        assert numbers is not None
        fx, fy, cx, cy = map(float, numbers[1].split(","))
        assert np.array_equal(camera.K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def test_the_first_pose_of_the_readme_is_that_of_the_demo(
    demo: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the command, and by the Python lines in the repository's folder."""
    section = PAGES[ROOT / "README.md"].split("## A first pose")[1]
    command = re.search(r"^    (dgc-pose .*?)\n\n", section, re.DOTALL | re.MULTILINE)
    snippet = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert command is not None and snippet is not None
    assert f"\n{command[1]}\n" in demo
    monkeypatch.chdir(ROOT)
    names: dict[str, Any] = {}
    exec(snippet[1], names)
    pose = names["pose"]
    assert pose.success and pose.probability > 0.9
    np.testing.assert_allclose([*pose.R, pose.t], poses_of(demo)[0], atol=1e-6)
