"""What batches, exports and models never replace or remove: files of the user, and their inputs."""

import os
from pathlib import Path

import pytest
from command_line import assert_refused, contents, run
from fuzz.readers import make_batch, make_photographs
from photos import write_photos

from dgc_pose.files.outputs import only_writer, replaced_folder

RECONSTRUCT = ("reconstruct", "batch", "--out", ".", "--K", "9,9,4,3")
EXPORT = ("export-colmap", "batch")


@pytest.fixture
def batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished batch of three small pictures, in the working folder."""
    monkeypatch.chdir(tmp_path)
    Path("batch").mkdir()
    make_batch(Path("batch"))
    make_photographs(Path("batch"))
    return tmp_path


@pytest.mark.parametrize(
    ("words", "present", "line"),
    [
        (RECONSTRUCT, "sparse/0/cameras.bin", "is there already"),
        ((*RECONSTRUCT, "--resume"), "model.html", "is there already"),
        ((*RECONSTRUCT, "--resume"), "points.ply", "is there already"),
        ((*RECONSTRUCT, "--resume"), "sparse/letter.txt", "sparse: holds other files"),
        ((*RECONSTRUCT, "--resume"), "sparse/1/letter.txt", "sparse: holds other files"),
        ((*RECONSTRUCT, "--resume"), "sparse/0/cameras.bin", "sparse: holds other files"),
        ((*RECONSTRUCT, "--resume"), "sparse/images/a.png", "sparse: holds other files"),
        ((*EXPORT, "--database", "batch/matches.h5", "--overwrite"), "", ""),
        ((*EXPORT, "--database", "batch/a.png", "--overwrite"), "batch/a.png", ""),
    ],
    ids=str,
)
def test_what_is_not_its_own_is_kept(
    batch: Path, words: tuple[str, ...], present: str, line: str
) -> None:
    if line == "is there already":
        Path("batch").rename("other")  # no batch to go on with
        words = ("reconstruct", "other", *words[2:])
    if present:
        Path(present).parent.mkdir(parents=True, exist_ok=True)
        Path(present).write_text("of the user")
    before = contents(batch)
    assert_refused(run(*words), line)
    assert contents(batch) == before


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
