"""Ordinary variety: names of folders and files, and what lies beside photographs."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pycolmap
import pytest
from batch_runs import view_folder
from click.testing import CliRunner, Result
from multi_view import K_text

from dgc_pose.batch.run import read_batch
from dgc_pose.cli.main import main

SIFT = ("--weights", "sift", "--runs", "1", "--iterations", "300", "--workers", "1")
LATIN_1 = os.fsdecode("h\xfctte".encode("latin-1"))  # no UTF-8
NAMES = ("shoot #3", "herz?", "100%20real", "guess", "a name", "hütte", "[1]", LATIN_1)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("views")
    view_folder(folder, 3)
    return folder


def run(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_a_folder_may_have_any_name(views: Path, tmp_path: Path, name: str) -> None:
    """That of the photographs, and that of the results."""
    photos, out = tmp_path / name, tmp_path / "results" / name
    shutil.copytree(views, photos)
    words = ("--pairs", "exhaustive", "--K", K_text(), *SIFT)
    done = run("batch", photos, "--out", out, *words)
    assert (done.exit_code, done.stderr) == (0, ""), done.output
    assert read_batch(out).summary["poses"] == 3
    again = run("batch", photos, "--out", out, *words, "--resume")
    assert again.exit_code == 0, again.output
    database = out.parent / f"{name}.db"
    exported = run("export-colmap", out, "--database", database, "--hloc", out.parent / "hloc")
    assert exported.exit_code == 0, exported.output
    shutil.copy(database, tmp_path / "plain.db")
    with pycolmap.Database.open(tmp_path / "plain.db") as opened:
        assert opened.num_verified_image_pairs() == 3


def _latin_1(photos: Path) -> None:
    shutil.copy(photos / "view0.png", photos / f"{LATIN_1}.png")


def _text(photos: Path) -> None:
    (photos / "notes.txt").write_text("of the shoot")


def _subfolder(photos: Path) -> None:
    (photos / "more").mkdir()
    (photos / "view2.png").rename(photos / "more" / "view2.png")


def _link(photos: Path) -> None:
    elsewhere = photos.with_name("elsewhere")
    elsewhere.mkdir()
    (photos / "view2.png").rename(elsewhere / "view2.png")
    (photos / "more").symlink_to(elsewhere, target_is_directory=True)
    (elsewhere / "back").symlink_to(photos, target_is_directory=True)


def _no_ending(photos: Path) -> None:
    (photos / "view2.png").rename(photos / "view2")


def _empty(photos: Path) -> None:
    (photos / "copying.jpg").touch()


@pytest.mark.parametrize(
    ("arrange", "told"),
    [
        (_latin_1, "1 file left out (first: h\\udcfctte.png): a name that is not UTF-8"),
        (_text, "1 file left out (first: notes.txt): not an image of a known format"),
        (_subfolder, None),
        (_link, None),
        (_no_ending, None),
        (_empty, "1 file left out (first: copying.jpg): empty"),
    ],
)
def test_what_lies_in_a_folder(
    views: Path, tmp_path: Path, arrange: Callable[[Path], None], told: str | None
) -> None:
    """Three photographs are matched; what is left out is said."""
    photos, out = tmp_path / "photos", tmp_path / "out"
    shutil.copytree(views, photos)
    arrange(photos)
    done = run("batch", photos, "--out", out, "--pairs", "exhaustive", "--K", K_text(), *SIFT)
    assert done.exit_code == 0, done.output
    assert done.stderr.splitlines() == ([] if told is None else [f"warning: {told}"])
    assert read_batch(out).summary["poses"] == 3
