"""Masks of the photographs of a batch, and of what is made of it."""

import cv2
import numpy as np
import pytest
from batch_runs import run_sift, view_folder, write_masks
from command_line import assert_refused, run
from multi_view import SIZE, K_text

from dgc_pose.batch.source import open_source
from dgc_pose.colmap.export import share

MIDDLE = SIZE[0] / 2 - 0.5  # masks are black on the left of it
NAMES = [f"sub/view{i}.png" for i in range(3)]


@pytest.fixture
def photos(tmp_path):
    """Three views in a folder within the folder."""
    view_folder(tmp_path / "photos" / "sub", 3)
    return tmp_path / "photos"


@pytest.fixture
def batch(photos, tmp_path):
    """Of photographs of which the last has no mask."""
    write_masks(tmp_path / "masks", NAMES[:2])
    return run_sift(photos, tmp_path / "out", masks=tmp_path / "masks")


def test_masked_pixels_are_not_matched(batch):
    assert [(row.name1, row.name2) for row in batch.rows] == [
        (NAMES[0], NAMES[1]),
        (NAMES[0], NAMES[2]),
        (NAMES[1], NAMES[2]),
    ]
    least = []
    for pair in batch.pairs():
        assert pair.row.success and len(pair.matches) > 50
        points = pair.matches.points1, pair.matches.points2
        least += [(n, p[:, 0].min()) for n, p in zip(pair.row.names, points, strict=True)]
    assert all(x >= MIDDLE for name, x in least if name != NAMES[2])
    unmasked = [x for name, x in least if name == NAMES[2]]
    assert min(unmasked) < MIDDLE - 5


def test_pixels_of_alpha_0_are_not_matched(photos, tmp_path):
    """Of photographs whose left is under alpha 0; and one has a mask of its own."""
    for name in NAMES:
        pixels = cv2.imread(str(photos / name))
        alpha = np.full(pixels.shape[:2], 255, np.uint8)
        alpha[:, : round(0.3 * SIZE[0])] = 0
        cv2.imwrite(str(photos / name), np.dstack([pixels, alpha]))
    write_masks(tmp_path / "masks", NAMES[:1])
    batch = run_sift(photos, tmp_path / "out", masks=tmp_path / "masks")
    least = dict.fromkeys(NAMES, np.inf)
    for pair in batch.pairs():
        found = pair.matches.points1, pair.matches.points2
        for name, points in zip(pair.row.names, found, strict=True):
            least[name] = min(least[name], points[:, 0].min())
    assert least[NAMES[0]] >= MIDDLE
    assert all(0.3 * SIZE[0] - 1 < least[name] < MIDDLE for name in NAMES[1:])
    points = share(batch, 1000).key_points.values()
    assert len(points) == 3 and min(p[:, 0].min() for p in points) >= 0.3 * SIZE[0] - 1


@pytest.mark.parametrize("kind", ["shape", "black", "text"])
def test_a_bad_mask_makes_its_photograph_bad(photos, tmp_path, kind):
    masks, bad = tmp_path / "masks", tmp_path / "masks" / f"{NAMES[0]}.png"
    write_masks(masks, NAMES[1:])
    if kind == "text":
        bad.write_text("a letter")
    else:
        shape = SIZE[::-1] if kind == "black" else (50, 100)
        cv2.imwrite(str(bad), np.full(shape, 255 * (kind == "shape"), np.uint8))
    batch = run_sift(photos, tmp_path / "out", masks=masks)
    assert [row.status == "bad_input" for row in batch.rows] == [True, True, False]
    reasons = {
        "shape": f"{bad} is 100 x 50 and the image {SIZE[0]} x {SIZE[1]}",
        "black": f"{bad} leaves no pixel of the image",
        "text": f"{bad} is not an image of a known format",
    }
    assert batch.summary["bad_images"] == {NAMES[0]: reasons[kind]}


@pytest.mark.parametrize("inside", ["masks", "."])
def test_masks_in_the_folder_of_the_photographs_are_no_photographs(photos, inside):
    """In a folder below it, or beside them."""
    write_masks(photos / inside, NAMES)
    assert len(open_source(photos).names) == 4  # the masks are equal
    assert open_source(photos, masks=photos / inside).names == tuple(NAMES)


@pytest.mark.parametrize("command", ["batch", "reconstruct"])
def test_a_folder_without_any_mask_is_refused(photos, tmp_path, command):
    (tmp_path / "empty").mkdir()
    write_masks(tmp_path / "flat", ["view0.png"])  # the photograph is sub/view0.png
    for folder in ("nowhere", "empty", "flat"):
        masks, out = tmp_path / folder, tmp_path / "out"
        words = ["--K", K_text(), "--weights", "sift", "--masks", masks, "--out", out]
        reason = f"--masks {masks}: no {NAMES[0]}.png there, and no mask of another image"
        assert_refused(run(command, photos, *words), reason)
        assert not out.exists()


def test_a_reconstruction_takes_masks(photos, tmp_path):
    out, masks = tmp_path / "out", tmp_path / "masks"
    write_masks(masks, NAMES, share=0.3)
    words = ["--K", K_text(), "--weights", "sift", "--workers", "1", "--out", out, "--masks", masks]
    result = run("reconstruct", photos, *words)
    assert result.exit_code == 0, result.output
    import pycolmap

    model = pycolmap.Reconstruction(str(out / "sparse"))
    left = [point.xy[0] for image in model.images.values() for point in image.points2D]
    assert len(model.images) == 3 and min(left) >= 0.3 * SIZE[0]
