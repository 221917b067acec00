"""The images that a batch works on, and what of a folder is left out."""

from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from dgc_pose.batch.source import open_source, survey
from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.errors import InputError


def _save(path: Path, format: str, count: int = 0) -> None:
    pixels = np.random.default_rng(count).integers(0, 256, (48, 64, 3), np.uint8)
    PIL.Image.fromarray(pixels).save(path, format)


def test_a_folder_is_searched_for_images_of_any_name(tmp_path: Path) -> None:
    _save(tmp_path / "a.jfif", "JPEG")
    _save(tmp_path / "b.gif", "GIF")
    (tmp_path / "notes.txt").write_text("of the day")
    source = open_source(tmp_path)
    assert source.names == ("a.jfif", "b.gif")
    assert source.left_out == (
        "1 file left out (first: notes.txt): not an image of a known format",
    )
    cameras, bad, _ = survey(source, read_calibration("50,50,32,24"))
    assert {camera.size for camera in cameras.values()} == {(64, 48)} and not bad


@pytest.mark.parametrize(
    ("plan", "result", "kept"),
    [
        ("out/batch/plan.json", "out/picture.png", False),
        ("batch/plan.json", "picture.png", False),  # in the folder of the photographs
        ("out/plan.json", "out/more/drawn.png", False),
        ("batch/plan.json", "other.png", True),
        ("plan.json", "picture.png", True),
        ("out/summary.json", "out/picture.png", True),
    ],
)
def test_results_are_no_photographs(tmp_path: Path, plan: str, result: str, *, kept: bool) -> None:
    """Of `batch` and `reconstruct`, wherever they were put; all else is taken."""
    for name in ("1.png", "2.png", result):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        _save(tmp_path / name, "PNG")
    (tmp_path / plan).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / plan).write_text("{}")
    source = open_source(tmp_path)
    assert source.names == ("1.png", "2.png") + (result,) * kept
    assert kept or "results, told by their plan.json" in "; ".join(source.left_out)


@pytest.mark.parametrize("root", ["photos/other", None])
def test_a_folder_without_any_of_the_listed_images(tmp_path: Path, root: str | None) -> None:
    """The argument is named; one image that is there is enough, since a bad image stops nothing."""
    (tmp_path / "photos" / "other").mkdir(parents=True)
    (tmp_path / "list.txt").write_text("a.png b.png\nb.png c.png\n")
    folder = tmp_path if root is None else tmp_path / root
    with pytest.raises(InputError) as caught:
        open_source(tmp_path / "list.txt", None if root is None else folder)
    assert str(caught.value) == (
        f"root {folder}: none of the 3 images of {tmp_path / 'list.txt'} is there (first: a.png)"
    )
    _save(tmp_path / "photos" / "c.png", "PNG")
    assert open_source(tmp_path / "list.txt", tmp_path / "photos").names == (
        "a.png",
        "b.png",
        "c.png",
    )


def test_a_video_is_no_list_of_pairs(tmp_path: Path) -> None:
    (tmp_path / "x.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + bytes(100))
    with pytest.raises(InputError, match=r"x\.mp4: a list of pairs is text, and this is not$"):
        open_source(tmp_path / "x.mp4")
