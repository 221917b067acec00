"""What batches, exports and models never replace or remove: files of the user, and their inputs."""

import os
from pathlib import Path

import numpy as np
import pytest
from command_line import assert_refused, contents, run
from fuzz.readers import make_batch, make_unfinished_batch
from photos import write_photos

from dgc_pose.batch.store import PairStore
from dgc_pose.benchmarks.posed_views import PosedViews
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.files.outputs import only_writer, replaced_folder


@pytest.fixture
def batch(tmp_path: Path) -> Path:
    """A finished batch of three small pictures."""
    folder = tmp_path / "batch"
    folder.mkdir()
    make_batch(folder)
    return folder


def test_what_cannot_be_read_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of the system while a batch is resumed costs no pair."""
    plan, _ = make_unfinished_batch(tmp_path)
    before = contents(tmp_path)

    def fail(*arguments: object) -> None:
        raise PermissionError(13, "Permission denied", "matched.jsonl")

    with monkeypatch.context() as patch, pytest.raises(PermissionError):
        patch.setattr("dgc_pose.batch.store.open_regular", fail)
        PairStore(tmp_path, plan)
    assert contents(tmp_path) == before
    assert PairStore(tmp_path, plan).left == []


@pytest.mark.parametrize("present", ["sparse/0/cameras.bin", "picture.png", "points.ply"])
@pytest.mark.parametrize("resume", [(), ("--resume",)], ids=["", "resume"])
def test_reconstruct_keeps_what_is_not_its_own(
    tmp_path: Path, present: str, resume: tuple[str, ...]
) -> None:
    (tmp_path / "sparse/0").mkdir(parents=True)
    (tmp_path / present).write_text("of the user")
    result = run("reconstruct", tmp_path, "--out", tmp_path, "--K", "9,9,4,3", *resume)
    assert_refused(result, "is there already")
    assert (tmp_path / present).read_text() == "of the user"


def test_a_model_folder_with_other_files_is_kept(batch: Path) -> None:
    """Also beside a batch of ours."""
    out = batch.parent
    (out / "sparse").mkdir()
    (out / "sparse/letter.txt").write_text("dear friend")
    result = run("reconstruct", batch, "--out", out, "--K", "9,9,4,3", "--resume")
    assert_refused(result, "sparse: holds other files")


@pytest.mark.parametrize(
    "arguments",
    [
        ("--database", "matches.h5"),
        ("--database", "plan.json"),
        ("--database", "a.png"),
        ("--hloc", "."),
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)], ids=["", "overwrite"])
def test_export_never_replaces_its_batch(
    batch: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple, overwrite: tuple
) -> None:
    monkeypatch.chdir(batch)
    Path("a.png").write_bytes(b"\x89PNG")
    before = contents(batch)
    assert_refused(run("export-colmap", ".", "--sharing", "cells", *arguments, *overwrite))
    assert contents(batch) == before


def test_copies_for_a_benchmark_never_replace_the_images(tmp_path: Path) -> None:
    views = PosedViews(tmp_path, {"a.png": Camera(np.eye(3))}, {"a.png": np.eye(4)[:3]})
    (tmp_path / "a.png").write_bytes(b"image")
    with pytest.raises(InputError, match="would be lost"):
        views.resized(0.5, tmp_path)


def test_a_second_writer_of_a_batch_is_refused(tmp_path: Path) -> None:
    words = ("--pairs", "sequential:1", "--K", "90,90,48,40", "--weights", "sift")
    write_photos(tmp_path / "photos", 2)
    (tmp_path / "out").mkdir()
    with only_writer(tmp_path / "out"):
        assert_refused(
            run("batch", tmp_path / "photos", "--out", tmp_path / "out", *words), "another run"
        )


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    for content in ("old", "new"):
        with replaced_folder(path) as folder:
            (folder / "file").write_text(content)
    with pytest.raises(ZeroDivisionError), replaced_folder(path) as folder:
        (folder / "file").write_text("half")
        raise ZeroDivisionError
    assert (path / "file").read_text() == "new"
    assert os.listdir(tmp_path) == ["sparse"]
