"""Ordinary variety of the names of folders and files."""

import os
import shutil
from pathlib import Path

import pycolmap
import pytest
from batch_runs import view_folder
from command_line import run
from multi_view import K_text

from dgc_pose.batch.result import read_batch

pytestmark = pytest.mark.slow

SIFT = ("--weights", "sift", "--runs", "1", "--iterations", "300", "--workers", "1")
WORDS = ("--pairs", "exhaustive", "--K", K_text(), *SIFT)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("views")
    view_folder(folder, 3)
    return folder


def test_a_folder_may_have_any_name(views: Path, tmp_path: Path) -> None:
    """That of the photographs, and that of the results: signs, and bytes that are no UTF-8."""
    name = "100%20real #3? [1] " + os.fsdecode("h\xfctte".encode("latin-1"))
    photos, out = tmp_path / name, tmp_path / "results" / name
    shutil.copytree(views, photos)
    done = run("batch", photos, "--out", out, *WORDS)
    assert (done.exit_code, done.stderr) == (0, ""), done.output
    assert read_batch(out).summary["poses"] == 3
    database = out.parent / f"{name}.db"
    exported = run("export-colmap", out, "--database", database, "--hloc", out.parent / "hloc")
    assert exported.exit_code == 0, exported.output
    shutil.copy(database, tmp_path / "plain.db")
    with pycolmap.Database.open(tmp_path / "plain.db") as opened:
        assert opened.num_verified_image_pairs() == 3


def test_results_may_lie_among_the_photographs(views: Path, tmp_path: Path) -> None:
    """Those of the first run were photographs of the second."""
    photos = tmp_path / "photos"
    shutil.copytree(views, photos)
    for more in (("--out", photos), ("--out", photos, "--resume")):
        done = run("reconstruct", photos, *more, *WORDS)
        assert done.exit_code == 0 and "3 of 3 images" in done.stdout, done.output
    other = run("batch", photos, "--out", tmp_path / "other", *WORDS)
    assert other.exit_code == 0, other.output
    assert read_batch(tmp_path / "other").summary["images"] == 3


def test_the_name_of_a_photograph_is_printed_as_one_line(views: Path, tmp_path: Path) -> None:
    """Its line breaks and control characters are not."""
    photos = tmp_path / "photos"
    shutil.copytree(views, photos)
    for i in range(3):
        (photos / f"view{i}.png").rename(photos / f"{i}\x1b]0;title\x07\n.png")
    for name in ("bad\x07\n.png", "notes\x07\n.txt"):
        (photos / name).write_bytes(b"\x89PNG\r\n\x1a\n" * name.endswith("png"))
    done = run("batch", photos, "--out", tmp_path / "out", *WORDS)
    assert done.exit_code == 0, done.output
    assert all(c.isprintable() or c == "\n" for c in done.output)
    lines = done.stdout.splitlines()
    assert sum(line.startswith("0\ufffd]0;title\ufffd .png 1") for line in lines) == 1
    assert [line.split(".")[0] for line in done.stderr.splitlines()] == [
        "warning: 1 file left out (first: notes\ufffd ",
        "bad image bad\ufffd ",
    ]
