"""`dgc-pose judge`: its table, its files, and unusable input in one line."""

import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from batch_runs import killed_after, view_folder
from command_line import assert_refused, run
from given_world import given_world, write_npz, write_with_pycolmap
from worlds import K_text

from dgc_pose import load_image
from dgc_pose.batch.result import read_batch
from dgc_pose.cameras.pair_list import rendered_pair
from dgc_pose.geometry.rotation import rotation_of_quaternion
from dgc_pose.matching.key_points import SiftMatcher

WORLD = given_world(count=4)
K = ("--K", "900,905,500,390")
QUICK = ("--runs", "1", "--iterations", "300", "--workers", "1")


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_with_pycolmap(WORLD, tmp_path_factory.mktemp("given") / "a.db")


def test_a_table_and_its_files(database: Path, tmp_path: Path) -> None:
    """The claimed pairs come first, in the table as in the files."""
    files = ("--csv", tmp_path / "p.csv", "--json", tmp_path / "p.json")
    done = run("judge", database, *files, "--batch", tmp_path / "batch", *QUICK)
    assert done.exit_code == 0, done.output
    (said,) = done.stderr.splitlines()
    assert said.startswith(f"{database}: COLMAP's key points") and "0.5 is subtracted" in said
    _, *shown, _, counts = done.stdout.splitlines()
    assert counts.startswith(f"{database}: 3 poses of 6 pairs (")
    pairs = json.loads((tmp_path / "p.json").read_text())["pairs"]
    rows = list(csv.DictReader((tmp_path / "p.csv").open()))
    assert [row["claimed"] for row in rows] == ["1"] * 3 + ["0"] * 3
    for line, pair, row in zip(shown, pairs, rows, strict=True):
        names = pair["name1"], pair["name2"]
        assert line.startswith(" ".join(names)) and (row["name1"], row["name2"]) == names
        assert row["status"] == pair["status"] and int(row["num_inliers"]) == pair["num_inliers"]
        if pair["success"]:
            R = rotation_of_quaternion(np.array([float(row[f"q{axis}"]) for axis in "wxyz"]))
            t = np.array([float(row[f"t{axis}"]) for axis in "xyz"])
            assert np.allclose(R, pair["R"]) and np.allclose(t, pair["t"])
            assert max(WORLD.errors_deg(names, R, t)) < 1.5
            assert float(row["rotation_error_90_deg"]) == pair["rotation_error_90_deg"]
        else:
            assert row["qw"] == row["tx"] == ""
    stored = (tmp_path / "batch/pairs.jsonl").read_text().splitlines()
    assert sorted(map(json.dumps, pairs)) == sorted(json.dumps(json.loads(line)) for line in stored)
    only = run("judge", database, "--json", "-", *QUICK)
    assert json.loads(only.stdout)["pairs"] == pairs


def test_a_stopped_run_goes_on(
    database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the pairs that it has. A finished one is read; one of a source that has changed, or
    without photographs where these are given now, is not."""
    source = tmp_path / "a.db"
    shutil.copy2(database, source)
    words = ("--batch", tmp_path / "batch", *QUICK)
    whole = run("judge", source, "--json", "-", *QUICK)
    with monkeypatch.context() as patch:
        patch.setattr("dgc_pose.batch.run.local_workers", killed_after(2))
        killed = run("judge", source, *words)
    assert killed.exit_code == 1 and "Killed" in killed.stderr
    resumed = run("judge", source, *words, "--resume", "--json", "-")
    assert resumed.exit_code == 0 and resumed.stdout == whole.stdout
    assert read_batch(tmp_path / "batch").summary["matched_now"] == 4
    assert_refused(run("judge", source, *words), "has a batch already", "--resume continues it")
    again = run("judge", source, *words, "--resume", "--csv", tmp_path / "p.csv")
    assert again.exit_code == 0 and (tmp_path / "p.csv").is_file()
    (tmp_path / "rows").mkdir()
    for name in WORLD.names:
        cv2.imwrite(str(tmp_path / name), np.zeros((800, 1000, 3), np.uint8))
    with_images = run("judge", source, *words, "--resume", "--images", tmp_path)
    assert_refused(with_images, "--resume needs the same")
    with pycolmap.Database.open(source) as changed:
        changed.clear_two_view_geometries()
    source.touch()
    refused = run("judge", source, *words, "--resume")
    assert_refused(refused, "--resume needs the same")


def test_cameras_that_are_not_known(tmp_path: Path) -> None:
    """One line states it."""
    world = given_world(count=2, unrelated=0)
    source = write_with_pycolmap(world, tmp_path / "a.db", known=False)
    done = run("judge", source, *QUICK)
    said = "K is not stated: the focal lengths are estimated (--K auto)"
    assert done.exit_code in (0, 3) and done.stderr.splitlines()[0] == said
    with_K = run("judge", source, *K, *QUICK)
    known = run("judge", write_with_pycolmap(world, tmp_path / "b.db"), *QUICK)
    assert with_K.stdout.splitlines()[:-1] == known.stdout.splitlines()[:-1]


def test_no_pair_with_a_pose(tmp_path: Path) -> None:
    write_npz(given_world(count=2, unrelated=2), tmp_path / "n")
    done = run("judge", tmp_path / "n", *K, *QUICK)
    assert done.exit_code == 3 and ": 0 poses of 1 pairs (" in done.stdout


def test_a_damaged_file_stops_no_other(tmp_path: Path) -> None:
    folder = write_npz(given_world(count=3, unrelated=0), tmp_path / "n", named=False)
    file = min(folder.iterdir())
    file.write_bytes(file.read_bytes()[:200])
    done = run("judge", folder, *K, "--json", "-", *QUICK)
    pairs = json.loads(done.stdout)["pairs"]
    (bad,) = (pair for pair in pairs if pair["status"] == "bad_input")
    assert "_".join((bad["name1"], bad["name2"], "")) == f"{file.stem}_"
    assert done.exit_code == 0 and len(pairs) == 3 and f"{file} cannot be read" in str(bad)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rendered views, and SIFT's matches of them as .npz. The second one is stored on its side."""
    folder = tmp_path_factory.mktemp("photographs")
    view_folder(folder, 3)
    images = {path.name: load_image(path) for path in sorted(folder.glob("*.png"))}
    names = [*images]
    (folder / "npz").mkdir()
    for first, second in ((0, 1), (0, 2), (1, 2)):
        pair = names[first], names[second]
        found = SiftMatcher().match(*(images[name] for name in pair)).matches
        arrays = {"points1": found.points1, "points2": found.points2, "key_points": True}
        np.savez(folder / "npz" / f"{'_'.join(pair)}.npz", **arrays)
    return folder


def test_photographs_tell_what_surrounds_the_matches(photographs: Path, tmp_path: Path) -> None:
    words = ("--images", photographs, "--K", K_text(), "--batch", tmp_path / "b")
    done = run("judge", photographs / "npz", *words, *QUICK)
    assert done.exit_code == 0 and ": 3 poses of 3 pairs" in done.stdout, done.output
    for pair in read_batch(tmp_path / "b").pairs():
        around = pair.matches.context_ratio
        assert around is not None and around > 0.3


def test_the_matches_that_estimate_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They have a probability, as matches of our network without their map. Their names are those
    in the folder that contains both photographs."""
    monkeypatch.chdir(tmp_path)
    pair = rendered_pair()
    lines = []
    for folder, path, camera in (("a", pair.path1, pair.camera1), ("b", pair.path2, pair.camera2)):
        (tmp_path / "photos" / folder).mkdir(parents=True)
        shutil.copy(path, tmp_path / "photos" / folder / "same.jpg")
        values = (f"{folder}/same.jpg", *camera.K[(0, 1, 0, 1), (0, 1, 2, 2)])
        lines.append(",".join(map(str, values)))
    Path("K.csv").write_text("\n".join(["name,fx,fy,cx,cy", *lines, ""]))
    (tmp_path / "npz").mkdir()
    paths = ("photos/a/same.jpg", "photos/b/../b/same.jpg")
    files = ("--json", "pose.json", "--matches", "npz/any.npz", "--effort", "fast")
    assert run("estimate", *paths, "--K", "K.csv", *files).exit_code == 0
    done = run("judge", "npz", "--K", "K.csv", "--json", "-", "--workers", "1")
    (judged,) = json.loads(done.stdout)["pairs"]
    pose = json.loads(Path("pose.json").read_text())
    assert (judged["name1"], judged["name2"]) == ("a/same.jpg", "b/same.jpg")
    assert np.allclose(judged["R"], pose["R"], atol=1e-3)
    assert judged["probability"] > 0.9 and pose["probability"] > 0.9
    with_images = ("--images", "photos", "--K", "K.csv", *QUICK)
    assert run("judge", "npz", *with_images).exit_code == 0


def test_photographs_that_do_not_fit(photographs: Path, database: Path, tmp_path: Path) -> None:
    words = ("judge", photographs / "npz", "--K", K_text(), *QUICK)
    some = tmp_path / "some"
    shutil.copytree(photographs, some)
    (some / "view2.png").unlink()
    done = run(*words, "--images", some)
    assert done.exit_code == 0 and "bad_input 2, ok 1" in done.stdout
    assert done.stderr.splitlines()[-1].startswith("bad image view2.png: ")
    rows = tmp_path / "other/rows"
    rows.mkdir(parents=True)
    for name in WORLD.names:  # of another size than the database states
        cv2.imwrite(str(rows.parent / name), np.zeros((90, 120, 3), np.uint8))
    refused = run("judge", database, "--images", rows.parent, *QUICK)
    assert refused.exit_code == 2 and "120x90 pixels, and " in refused.stderr
    assert "states 1000x800" in refused.stderr
