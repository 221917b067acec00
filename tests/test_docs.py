"""The documentation names what is there: public names, sub-commands, files that are linked."""

import re
from pathlib import Path

import pytest

import dgc_pose
from dgc_pose.cli.main import SUBCOMMANDS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
_LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(#[^)\s]*)?\)")


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
    navigation = set(re.findall(r": ([\w-]+\.md)$", settings, re.MULTILINE))
    assert navigation == {page.name for page in DOCS.glob("*.md")}
