"""A batch that is resumed: what must be the same, what is matched again, and what is kept."""

import os
import shutil
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from batch_runs import Killed, assert_same_result, killed_after, run_sift, write_masks
from boxes import box_picture

from dgc_pose.batch.result import read_batch
from dgc_pose.batch.source import open_source
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matching.key_points import SiftMatcher

LATE = "view2.png"  # of two pairs
chain = partial(run_sift, pairs="sequential:1")  # three pairs


@pytest.fixture(scope="module")
def whole(views, tmp_path_factory):
    """An uninterrupted batch."""
    return chain(views, tmp_path_factory.mktemp("whole") / "out").folder


@pytest.fixture
def photos(views, tmp_path):
    """A copy of the views, to change."""
    return shutil.copytree(views, tmp_path / "photos")


def _added(photos):
    cv2.imwrite(str(photos / "added.png"), cv2.imread(str(photos / "view0.png"))[::-1])
    return photos


def _masked(photos):
    write_masks(photos.with_name("masks"), ["view0.png"])
    return photos


CHANGES = {
    "K": (None, {"K": "300,300,119.5,89.5"}),
    "folder": (lambda p: shutil.copytree(p, p.with_name("other")), {}),
    "masks": (_masked, {"masks": "masks"}),
    "seed": (None, {"estimation": EstimationOptions(seed=9)}),
    "added": (_added, {}, "photos/added.png is new since that batch: "),
    "removed": (
        lambda p: (p / "view2.png").unlink() or p,
        {},
        "photos/view2.png has gone since that batch: ",
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_difference_is_refused_with_the_command_and_nothing_changes(
    photos, tmp_path, change, monkeypatch
):
    monkeypatch.setattr("sys.argv", ["dgc-pose", "batch", "my photos"])
    out = tmp_path / "out"
    with pytest.raises(Killed):
        chain(photos, out, start_workers=killed_after(1))
    before = {path: path.read_bytes() for path in out.iterdir()}
    apply, options, *words = CHANGES[change]
    made = "has another folder, options, pairs or cameras"
    (words,) = words or [f"batch.db {made} (`dgc-pose batch 'my photos'`): "]
    source = photos if apply is None else apply(photos)
    options = {k: tmp_path / "masks" if k == "masks" else v for k, v in options.items()}
    with pytest.raises(InputError, match=": resume needs the same") as raised:
        chain(source, out, resume=True, **options)
    assert words in str(raised.value) and "\n" not in str(raised.value)
    assert {path: path.read_bytes() for path in out.iterdir()} == before


def test_killed_and_resumed_gives_the_same(views, tmp_path, monkeypatch):
    """While the pairs are matched, fitted again around the pooled camera, and estimated."""
    moved = "dgc_pose.batch.folder_cameras.centre_moved"
    monkeypatch.setattr(moved, lambda before, after: True)
    out, whole = tmp_path / "out", tmp_path / "whole"
    auto = partial(chain, views, K="auto")
    auto(whole)
    # Of two matches; the third and a fit; two fits and an estimate.
    for tasks in (2, 2, 3):
        with pytest.raises(Killed):
            auto(out, start_workers=killed_after(tasks), resume=out.exists())
        with pytest.raises(InputError, match="unfinished"):
            read_batch(out)
    auto(out, resume=True)
    assert_same_result(out, whole)
    again = auto(out, resume=True, start_workers=killed_after(0))
    assert again.plan.pooled is not None


def test_a_photograph_that_was_half_copied_is_matched_when_it_is_whole(photos, whole, tmp_path):
    """Its pairs alone, whether the batch was finished or killed."""
    out, content = tmp_path / "out", (photos / LATE).read_bytes()
    (photos / LATE).write_bytes(content[: len(content) // 2])
    assert list(chain(photos, out).summary["bad_images"]) == [LATE]
    (photos / LATE).write_bytes(content)
    batch = chain(photos, out, resume=True)
    assert batch.summary["bad_images"] == {} and batch.summary["matched_now"] == 2
    assert_same_result(out, whole)
    again = chain(photos, out, resume=True, start_workers=killed_after(0))
    assert again.summary == batch.summary
    (out / "matches.h5").unlink()
    assert chain(photos, out, resume=True).summary["matched_now"] == 0
    assert_same_result(out, whole)
    os.utime(photos / LATE, (10**9, 10**9))
    with pytest.raises(Killed):
        chain(photos, out, resume=True, start_workers=killed_after(1))
    assert chain(photos, out, resume=True).summary["matched_now"] == 1
    assert_same_result(out, whole)


def test_a_picture_that_only_one_run_could_read_is_told(photos, tmp_path):
    """Repaired, or broken between the runs. It is neither new nor gone."""
    out, picture = tmp_path / "out", photos / "view3.png"
    content = picture.read_bytes()
    picture.write_bytes(b"")
    chain(photos, out)
    picture.write_bytes(content)
    could_not = r"view3\.png could not be read by that batch \(empty\): resume needs the same$"
    with pytest.raises(InputError, match=could_not):
        chain(photos, out, resume=True)
    chain(photos, tmp_path / "whole")
    picture.write_bytes(b"")
    with pytest.raises(InputError, match=r"view3\.png was read by that .* read now \(empty\): "):
        chain(photos, tmp_path / "whole", resume=True)


def test_a_mask_that_changed_is_matched_again(photos, tmp_path):
    """The pairs of its photograph are; so are those of a photograph that gets a mask."""
    out, other, masks = tmp_path / "out", tmp_path / "other", tmp_path / "masks"
    write_masks(masks, ["view0.png"])
    with_masks = partial(chain, photos, masks=masks)
    with_masks(out)
    for name, share, pairs in (("view0.png", 0.3, 1), ("view1.png", 0.5, 2)):
        write_masks(masks, [name], share)
        assert with_masks(out, resume=True).summary["matched_now"] == pairs
    with_masks(other)
    assert_same_result(out, other)


def test_a_changed_photograph_of_a_camera_by_its_lines_is_matched_again(tmp_path):
    """The lines of all photographs of a camera count together."""
    photos = tmp_path / "photos"
    photos.mkdir()
    for number in range(3):
        picture = box_picture(1.2, (30 + 5 * number, 20, 3), size=(480, 360))
        cv2.imwrite(str(photos / f"{number}.png"), picture)
    run_sift(photos, tmp_path / "out", K="auto")
    cv2.imwrite(str(photos / "2.png"), box_picture(1.2, (45, 22, 3), size=(480, 360), seed=3))
    batch = run_sift(photos, tmp_path / "out", K="auto", resume=True)
    assert batch.summary["matched_now"] == 2


def _raising(error):
    """`SiftMatcher._match`, but raising once an image is LATE."""
    match = SiftMatcher._match

    def raising(matcher, image1, image2):
        if any(image.name.endswith(LATE) for image in (image1, image2)):
            raise error
        return match(matcher, image1, image2)

    return raising


def test_a_failure_is_no_bad_input_and_is_matched_again(photos, whole, tmp_path, monkeypatch):
    """A lack of memory ends the batch, which resumes."""
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(SiftMatcher, "_match", _raising(MemoryError("60 GiB")))
        with pytest.raises(MemoryError, match="60 GiB"):
            chain(photos, out)
        with pytest.raises(InputError, match="unfinished"):
            read_batch(out)
        patch.undo()
        patch.setattr(SiftMatcher, "_match", _raising(np.linalg.LinAlgError("singular")))
        batch = chain(photos, out, resume=True)
    failed = [(row.names, row.reason) for row in batch.rows if row.status == "failed"]
    pairs = ("view1.png", LATE), (LATE, "view3.png")
    assert failed == [(pair, "LinAlgError: singular") for pair in pairs]
    assert batch.summary["failed_pairs"] == 2 and batch.summary["bad_pairs"] == 0
    assert chain(photos, out, resume=True).summary["matched_now"] == 2
    assert_same_result(out, whole)


def test_a_batch_without_pairs_has_an_empty_result(photos, tmp_path, monkeypatch):
    """As where no image can be compared with another; also when it is resumed."""
    none = replace(open_source(photos), pairs=())
    monkeypatch.setattr("batch_runs.open_source", lambda *_: none)
    for resume in (False, True):
        batch = run_sift(photos, tmp_path / "out", pairs=None, resume=resume)
        assert batch.rows == [] and batch.summary["pairs"] == 0
