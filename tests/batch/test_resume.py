"""A batch that is resumed: what must be the same, what is matched again, and what is kept."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from batch_runs import Killed, assert_same_result, killed_after, run_sift, write_masks

from dgc_pose.batch.result import read_batch
from dgc_pose.batch.source import open_source
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import Image
from dgc_pose.matching.sift import SiftMatcher

COUNT = 4
LAST = f"view{COUNT - 1}.png"
OTHER_K = "300,300,119.5,89.5"


@pytest.fixture(scope="module")
def whole(views: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted batch."""
    out = tmp_path_factory.mktemp("whole") / "out"
    run_sift(views, out)
    return out


@pytest.fixture
def photos(views: Path, tmp_path: Path) -> Path:
    """A copy of the views, to change."""
    shutil.copytree(views, tmp_path / "photos")
    return tmp_path / "photos"


def _files(out: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


def _add(photos: Path) -> Path:
    cv2.imwrite(str(photos / "added.png"), cv2.imread(str(photos / "view0.png"))[::-1])
    return photos


def _remove(photos: Path) -> Path:
    (photos / "view2.png").unlink()
    return photos


def _move(photos: Path) -> Path:
    return shutil.copytree(photos, photos.with_name("elsewhere"))


def _mask(photos: Path) -> Path:
    write_masks(photos.with_name("masks"), ["view0.png"])
    return photos


CHANGES = {
    "K": (None, {"K": OTHER_K}, "had of view0.png the K [["),
    "folder": (_move, {}, "had the folder "),
    "masks": (_mask, {"masks": "masks"}, "had the option masks null, not "),
    "added": (_add, {}, "photos/added.png is new since that batch: "),
    "removed": (_remove, {}, "photos/view2.png has gone since that batch: "),
    "way": (None, {"pairs": "sequential:1"}, 'had the option pairs way "exhaustive"'),
    "seed": (None, {"estimation": EstimationOptions(seed=9)}, "had the option estimation "),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_differs_is_named_and_nothing_changes(
    photos: Path, tmp_path: Path, change: str
) -> None:
    out = tmp_path / "out"
    with pytest.raises(Killed):
        run_sift(photos, out, start_workers=killed_after(1))
    before = _files(out)
    apply, options, words = CHANGES[change]
    source = photos if apply is None else apply(photos)
    options = {k: tmp_path / "masks" if k == "masks" else v for k, v in options.items()}
    with pytest.raises(InputError, match=": resume needs the same") as raised:
        run_sift(source, out, resume=True, **options)  # type: ignore[arg-type]
    assert words in str(raised.value) and "\n" not in str(raised.value)
    assert _files(out) == before


def test_a_photograph_that_was_half_copied_is_matched_when_it_is_whole(
    photos: Path, whole: Path, tmp_path: Path
) -> None:
    """Its pairs alone."""
    out, content = tmp_path / "out", (photos / LAST).read_bytes()
    (photos / LAST).write_bytes(content[: len(content) // 2])
    assert list(run_sift(photos, out).summary["bad_images"]) == [LAST]
    (photos / LAST).write_bytes(content)
    batch = run_sift(photos, out, resume=True)
    assert batch.summary["bad_images"] == {} and batch.summary["matched_now"] == COUNT - 1
    assert_same_result(out, whole)
    again = run_sift(photos, out, resume=True, start_workers=killed_after(0))
    assert again.summary == batch.summary


def test_a_mask_that_changed_is_matched_again(photos: Path, tmp_path: Path) -> None:
    """The pairs of its photograph are; so are those of a photograph that gets a mask."""
    out, other, masks = tmp_path / "out", tmp_path / "other", tmp_path / "masks"
    write_masks(masks, ["view0.png"])
    with pytest.raises(Killed):
        run_sift(photos, out, masks=masks, start_workers=killed_after(5))
    write_masks(masks, ["view0.png"], share=0.3)
    batch = run_sift(photos, out, masks=masks, resume=True)
    assert 3 <= batch.summary["matched_now"] <= 4
    write_masks(masks, ["view1.png"])
    assert run_sift(photos, out, masks=masks, resume=True).summary["matched_now"] == 3
    run_sift(photos, other, masks=masks)
    assert_same_result(out, other)


def _raising(error: Exception) -> Callable[..., object]:
    """`SiftMatcher._match`, but raising once an image is LAST."""
    match = SiftMatcher._match

    def raising(matcher: SiftMatcher, image1: Image, image2: Image) -> object:
        if image2.name.endswith(LAST):
            raise error
        return match(matcher, image1, image2)

    return raising


def test_a_failure_is_no_bad_input_and_is_matched_again(
    photos: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lack of memory ends the batch, which resumes."""
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(SiftMatcher, "_match", _raising(MemoryError("60 GiB")))
        with pytest.raises(MemoryError, match="60 GiB"):
            run_sift(photos, out)
        with pytest.raises(InputError, match="not finished"):
            read_batch(out)
        patch.undo()
        patch.setattr(SiftMatcher, "_match", _raising(np.linalg.LinAlgError("singular")))
        batch = run_sift(photos, out, resume=True)
    failed = [row for row in batch.rows if row.status == "failed"]
    assert [row.name2 for row in failed] == [LAST] * (COUNT - 1)
    assert {row.reason for row in failed} == {"LinAlgError: singular"}
    assert batch.summary["failed_pairs"] == COUNT - 1 and batch.summary["bad_pairs"] == 0
    assert run_sift(photos, out, resume=True).summary["matched_now"] == COUNT - 1
    assert_same_result(out, whole)


def test_a_batch_without_pairs_has_an_empty_result(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where no image can be compared with another; also when it is resumed before its result."""
    out = tmp_path / "out"
    none = replace(open_source(photos), pairs=())
    monkeypatch.setattr("batch_runs.open_source", lambda *_: none)
    for resume in (False, True):
        batch = run_sift(photos, out, pairs=None, resume=resume)
        assert batch.rows == [] and batch.summary["pairs"] == 0
