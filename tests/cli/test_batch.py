"""`batch` and `reconstruct`: their tables and files, and photographs that cannot be used."""

import os
import shlex
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from bad_pictures import BAD_PICTURES, MISSING, write_bad_pictures
from batch_runs import view_folder
from command_line import assert_all_bad, run
from worlds import K_text

from dgc_pose.batch.result import read_batch
from dgc_pose.estimation.status import percent_text

SIFT = ("--weights", "sift", "--runs", "1", "--iterations", "300", "--workers", "1")


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    view_folder(folder, 3)
    return folder


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
        assert row.probability is not None and row.probability > 0.9
        likely = percent_text(row.probability)
        expected = f"{row.name1} {row.name2} {row.status} {likely} {shown}"
        assert " ".join(line.split()) == f"{expected} {row.num_inliers} of {row.num_matches}"
    assert more == "... and 1 more" and counts.startswith(f"{out}: 3 poses of 3 pairs (ok 3), ")
    command = "for COLMAP: dgc-pose "
    assert files[2].startswith(command)
    words = shlex.split(files[2].removeprefix(command))
    words[-1] = str(tmp_path / words[-1])
    assert run(*words).exit_code == 0 and (tmp_path / "database.db").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["100%20real #3? [1]", os.fsdecode(b"h\xfctte")], ids=ascii)
def test_folders_and_photographs_may_have_any_name(photos: Path, tmp_path: Path, name: str) -> None:
    """Line breaks and control characters of a name are not printed."""
    views = tmp_path / name
    out = tmp_path / "results" / name
    shutil.copytree(photos, views)
    for i in range(3):
        (views / f"view{i}.png").rename(views / f"{i}\x1b]0;title\x07\n.png")
    for file in ("bad\x07\n.png", "notes\x07\n.txt"):
        (views / file).write_bytes(b"\x89PNG\r\n\x1a\n" * file.endswith("png"))
    done = run("batch", views, "--out", out, "--pairs", "exhaustive", "--K", K_text(), *SIFT)
    assert done.exit_code == 0 and read_batch(out).summary["poses"] == 3, done.output
    assert all(c.isprintable() or c == "\n" for c in done.output.encode(errors="replace").decode())
    lines = done.stdout.splitlines()
    assert sum(line.startswith("0\ufffd]0;title\ufffd .png 1") for line in lines) == 1
    assert [line.split(".")[0] for line in done.stderr.splitlines()] == [
        "warning: 1 file skipped (first: notes\ufffd ",
        "bad image bad\ufffd ",
    ]
    database = out.parent / f"{name}.db"
    exported = run("export-colmap", out, "--database", database)
    assert exported.exit_code == 0 and database.is_file(), exported.output


@pytest.mark.slow
def test_results_may_lie_among_the_photographs(photos: Path, tmp_path: Path) -> None:
    """They are no photographs of the next run."""
    views = tmp_path / "photos"
    shutil.copytree(photos, views)
    words = (views, "--pairs", "exhaustive", "--K", K_text(), *SIFT, "--out")
    for more in ((views / "out",), (views / "out", "--resume")):
        done = run("reconstruct", *words, *more)
        assert done.exit_code == 0 and "3 of 3 images" in done.stdout, done.output
    assert run("batch", *words, tmp_path / "other").exit_code == 0
    assert read_batch(tmp_path / "other").summary["images"] == 3


def test_without_K_the_cameras_are_estimated(photos: Path, tmp_path: Path) -> None:
    """As with --K auto; one line on stderr states it. The bad images are named."""
    folder = tmp_path / "folder"
    shutil.copytree(photos, folder)
    bad = [path for path in write_bad_pictures(folder) if path.exists()]
    done = run("batch", folder, "--out", tmp_path / "out", "--pairs", "sequential:1", *SIFT)
    assert done.exit_code == 0, done.output
    said, *lines = done.stderr.splitlines()
    assert said == "K is not stated: the focal lengths are estimated (--K auto)"
    for path in bad:
        reason = BAD_PICTURES[path.name]
        (line,) = (line for line in lines if line.startswith(f"bad image {path.name}"))
        assert reason in line
    assert (tmp_path / "out" / "cameras.csv").is_file()


def test_images_without_a_K_beside_others_with_one_are_counted(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a list, whose other cameras are estimated, and in a file of --K, which lacks them."""
    monkeypatch.chdir(tmp_path)
    both = "180 0 120 0 180 90 0 0 1 180 0 120 0 180 90 0 0 1"
    Path("list.txt").write_text(f"view0.png view1.png 0 0 {both}\nview1.png view2.png\n")
    listed = run("batch", "list.txt", "--root", photos, "--out", "o1", *SIFT)
    assert listed.exit_code == 0, listed.output
    (said,) = listed.stderr.splitlines()
    estimated = "the focal lengths are estimated (--K auto)"
    assert said == f"K is not stated for 1 of 3 images (first: view2.png): {estimated}"
    Path("K.csv").write_text(
        "name,fx,fy,cx,cy\nview0.png,180,180,120,90\nview1.png,180,180,120,90\n"
    )
    lacked = run("batch", photos, "--K", "K.csv", "--out", "o2", *SIFT)
    assert lacked.exit_code == 0, lacked.output
    assert lacked.stderr.splitlines() == [
        "warning: K.csv has no camera for 1 of 3 images (first: view2.png)",
        "bad image view2.png: K.csv has no camera for view2.png",
    ]


def test_photographs_without_a_pose_or_of_no_use(photos: Path, tmp_path: Path) -> None:
    """`batch` and `reconstruct` exit with 3 without a pose, and with 2 if no image can be used."""
    nothing = tmp_path / "nothing"
    bad = tmp_path / "bad"
    nothing.mkdir()
    rng = np.random.default_rng(0)
    for name in "abc":
        noise = rng.integers(0, 256, (23, 30, 3), np.uint8)
        cv2.imwrite(str(nothing / f"{name}.png"), cv2.resize(noise, (240, 180)))
    write_bad_pictures(bad)
    for command in ("batch", "reconstruct"):
        out = tmp_path / command
        done = run(command, nothing, "--out", out, *SIFT)
        assert done.exit_code == 3, done.output
        assert "0 poses of 3 pairs" in done.stdout and "error" not in done.stderr
        assert ("no model: " in done.stdout) == (command == "reconstruct")
        done = run(command, bad, "--out", tmp_path / f"bad_{command}", *SIFT)
        reasons = [BAD_PICTURES[name] for name in sorted(BAD_PICTURES) if name != MISSING]
        assert_all_bad(done, *reasons)
