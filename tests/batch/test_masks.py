"""Masks of the photographs of a batch, and of what is made of it."""

import shutil
from itertools import combinations

import cv2
import numpy as np
import pytest
from batch_runs import run_sift, write_masks
from command_line import assert_refused, run
from worlds import SIZE, K_text

from dgc_pose.batch.source import open_source

MIDDLE = SIZE[0] / 2 - 0.5  # masks are black on the left of it
NAMES = [f"sub/view{i}.png" for i in range(3)]


@pytest.fixture
def photos(views, tmp_path):
    """Three views in a folder within the folder."""
    (shutil.copytree(views, tmp_path / "photos" / "sub") / "view3.png").unlink()
    return tmp_path / "photos"


def test_masked_pixels_are_not_matched(photos, tmp_path):
    """The first photograph has no mask."""
    write_masks(tmp_path / "masks", NAMES[1:])
    batch = run_sift(photos, tmp_path / "out", masks=tmp_path / "masks")
    assert [row.names for row in batch.rows] == [*combinations(NAMES, 2)]
    least = []
    for pair in batch.pairs():
        assert pair.row.success and len(pair.matches) > 50
        points = pair.matches.points1, pair.matches.points2
        least += [(n, p[:, 0].min()) for n, p in zip(pair.row.names, points, strict=True)]
    assert all(x >= MIDDLE for name, x in least if name != NAMES[0])
    assert min(x for name, x in least if name == NAMES[0]) < MIDDLE - 5


@pytest.mark.parametrize("inside", ["masks", "."])
def test_masks_in_the_folder_of_the_photographs_are_no_photographs(photos, inside):
    """In a folder below it, or beside them."""
    write_masks(photos / inside, NAMES)
    assert len(open_source(photos).names) == 4  # the masks are equal
    assert open_source(photos, masks=photos / inside).names == tuple(NAMES)


def test_a_folder_without_any_mask_is_refused(photos, tmp_path):
    (tmp_path / "empty").mkdir()
    write_masks(tmp_path / "flat", ["view0.png"])  # the photograph is sub/view0.png
    for folder in ("nowhere", "empty", "flat"):
        masks, out = tmp_path / folder, tmp_path / "out"
        words = ["--K", K_text(), "--weights", "sift", "--masks", masks, "--out", out]
        reason = f"--masks {masks}: no {NAMES[0]}.png there, and no mask of another image"
        assert_refused(run("batch", photos, *words), reason)
        assert not out.exists()


@pytest.mark.parametrize("shape", [(180, 240), (50, 240)], ids=["empty", "of another shape"])
def test_a_bad_mask_spoils_its_photograph_alone(photos, tmp_path, shape):
    """A mask that leaves no pixel, or has another shape."""
    masks = tmp_path / "masks"
    write_masks(masks, NAMES)
    level = 255 if shape[0] == 50 else 0
    cv2.imwrite(str(masks / f"{NAMES[0]}.png"), np.full(shape, level, np.uint8))
    batch = run_sift(photos, tmp_path / "out", masks=masks)
    bad = [row.status == "bad_input" for row in batch.rows]
    assert bad == [NAMES[0] in row.names for row in batch.rows]
