"""`batch`, `export-colmap` and `reconstruct` with unusable input: one line, exit code 2,
nothing written."""

import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from batch_runs import view_folder
from command_line import assert_refused, run
from worlds import K_text

from dgc_pose.batch.result import read_batch
from dgc_pose.matching.key_points import SiftMatcher

SIFT = ("--weights", "sift", "--runs", "1", "--iterations", "300", "--workers", "1")


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    view_folder(folder, 3)
    return folder


@pytest.mark.parametrize(
    ("command", "count", "reason"),
    [
        ("batch", 0, "no image there, and a pair needs two"),
        ("reconstruct", 1, "a single image there, and a pair needs two"),
        ("reconstruct", 2, "2 images, and a model needs 3"),
    ],
)
def test_too_few_images(
    photos: Path, tmp_path: Path, command: str, count: int, reason: str
) -> None:
    folder, out = tmp_path / "folder", tmp_path / "out"
    folder.mkdir()
    for i in range(count):
        (folder / f"{i}.png").write_bytes((photos / f"view{i}.png").read_bytes())
    options = ["--out", out, "--pairs", "exhaustive", "--K", K_text(), *SIFT]
    assert_refused(run(command, folder, *options), str(folder), reason)
    assert not out.exists()


def test_images_of_several_sizes(photos: Path, tmp_path: Path) -> None:
    """Without a K, and with one; a K of each serves."""
    folder, out = tmp_path / "folder", tmp_path / "out"
    folder.mkdir()
    whole = cv2.imread(str(photos / "view0.png"))
    cv2.imwrite(str(folder / "a.png"), whole)
    cv2.imwrite(str(folder / "b.png"), whole[:150])
    options = ["--out", out, "--pairs", "exhaustive", *SIFT]
    assert_refused(run("batch", folder, *options), "no camera for a.png", "--K")
    reason = "one K for images of several sizes (240x150 and 240x180)"
    assert_refused(run("batch", folder, *options, "--K", K_text()), reason)
    assert not out.exists()
    table = tmp_path / "K.csv"
    table.write_text(
        f"name,fx,fy,cx,cy,width,height\na.png,{K_text()},240,180\nb.png,{K_text()},240,150\n"
    )
    (folder / "notes.txt").write_text("of the day")
    done = run("batch", folder, *options, "--K", table)
    assert done.exit_code == 3, done.output  # the images are the same
    left_out = "1 file left out (first: notes.txt): not an image of a known format"
    assert f"warning: {left_out}\n" in done.stderr


def test_failed_pairs_are_told(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: object) -> None:
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(SiftMatcher, "_match", fail)
    options = ["--out", tmp_path / "out", "--pairs", "exhaustive", "--K", K_text(), *SIFT]
    done = run("batch", photos, *options)
    assert done.exit_code == 3 and "0 poses of 3 pairs (failed 3)" in done.stdout
    assert done.stderr == (
        "3 pairs failed (first: view0.png view1.png: LinAlgError: singular): "
        "--resume matches them again\n"
    )


def test_a_batch_ends_with_a_table_and_its_files(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without --pairs all pairs of three images; the angle is that of the row."""
    monkeypatch.setattr("dgc_pose.cli.batch.PAIRS_SHOWN", 2)
    out = tmp_path / "o ut"
    done = run("batch", photos, "--out", out, "--K", K_text(), *SIFT)
    assert done.exit_code == 0, done.output
    rows = read_batch(out).rows
    _, first, second, more, _, counts, *files = done.stdout.splitlines()
    for line, row in zip((first, second), rows, strict=False):
        angle = np.linalg.norm(row.pose.rotvec) * 180 / np.pi
        errors = (row.pose.rotation_error_90_deg, row.pose.translation_error_90_deg)
        shown = " ".join(f"{value:.2f} deg" for value in (angle, *errors))
        assert row.probability is None  # SIFT's matches have no model of it
        expected = f"{row.name1} {row.name2} {row.status} - {shown}"
        assert " ".join(line.split()) == f"{expected} {row.num_inliers} of {row.num_matches}"
    assert more == "... and 1 more" and counts.startswith(f"{out}: 3 poses of 3 pairs (ok 3), ")
    command = "for COLMAP: dgc-pose "
    assert files[2].startswith(command)
    words = shlex.split(files[2].removeprefix(command))
    words[-1] = str(tmp_path / words[-1])
    assert run(*words).exit_code == 0 and (tmp_path / "database.db").is_file()
