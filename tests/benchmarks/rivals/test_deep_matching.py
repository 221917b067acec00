"""DeepMatching, against transformations of noise whose map is known, and a loop over all places."""

import cv2
import numpy as np
import pytest

from dgc_pose.benchmarks.rivals import deep_matching
from dgc_pose.benchmarks.rivals.deep_matching import DeepMatcher, deep_matches
from dgc_pose.images.image import Image

SIDE = 64


def _noise(side: int) -> np.ndarray:
    """Blots of some pixels, grey levels of 0 to 255."""
    rng = np.random.default_rng(4)
    return cv2.resize(rng.uniform(0, 255, (side // 4, side // 4)), (side, side)).astype(np.float32)


def _centred(matrix: list[list[float]]) -> np.ndarray:
    """The affine map (2, 3) of pixels, of a matrix about the centre of an image."""
    centre = np.full(2, (SIDE - 1) / 2)
    return np.column_stack([matrix, centre - matrix @ centre])


@pytest.mark.parametrize(
    ("affine", "share", "error"),
    [
        (np.array([[1.0, 0, 0], [0, 1, 0]]), 0.99, 0.01),
        (np.array([[1.0, 0, 8], [0, 1, -5]]), 0.75, 0.01),
        (_centred([[1.25, 0], [0, 1.25]]), 0.5, 1.5),
        (_centred([[0.85, 0.1], [-0.05, 1.1]]), 0.5, 1.5),
    ],
    ids=["identity", "translation", "scale", "shear"],
)
def test_patches_lie_where_the_transformation_takes_them(
    affine: np.ndarray, share: float, error: float
) -> None:
    """Image 2 at x is image 1 at A x: a patch at x is to be matched to A x."""
    image1 = _noise(SIDE)
    image2 = cv2.warpAffine(
        image1, affine, (SIDE, SIDE), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )
    matches = deep_matches(image1, image2)
    expected = matches.points2 @ affine[:, :2].T + affine[:, 2]
    inside = ((expected > 4) & (expected < SIDE - 5)).all(1)
    distance = np.linalg.norm(matches.points1 - expected, axis=1)[inside]
    assert inside.sum() > share * (SIDE / 4) ** 2 * 0.6
    assert (distance <= error + 1e-9).mean() >= share


def test_each_match_is_the_best_of_its_patch_and_of_its_place() -> None:
    matches = deep_matches(_noise(SIDE), np.roll(_noise(SIDE), (3, 5), axis=(0, 1)))
    for points in (matches.points2, matches.points1):
        cells = (points - 1.5).astype(int) // 4  # of the patch's first pixel
        assert len(np.unique(cells, axis=0)) == len(cells)


def test_the_map_is_in_pixels_of_both_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Image 2 is twice as wide, and shows image 1 moved by an eighth of its width."""
    monkeypatch.setattr(deep_matching, "SIDE", SIDE)
    grey = np.clip(_noise(SIDE), 0, 255).astype(np.uint8)
    moved = np.roll(grey, -SIDE // 8, axis=1)
    first, second = (np.repeat(image[..., None], 3, 2) for image in (grey, moved))
    second = cv2.resize(second, (2 * SIDE, SIDE), interpolation=cv2.INTER_LINEAR)
    result = DeepMatcher().match(Image(first), Image(second))
    dense = result.correspondence_map
    assert dense is not None
    assert dense.map.shape == (SIDE // 4, SIDE // 4, 2)
    expected = (dense.grid + 0.5) * (0.5, 1) - 0.5 + (SIDE / 8, 0)
    error = np.linalg.norm(dense.map - expected, axis=-1)[:, :-3]
    assert np.median(error) < 0.5
    assert (dense.matchability[:, :-3] == 1).mean() > 0.7


def test_images_without_structure_give_a_map_and_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deep_matching, "SIDE", SIDE)
    blank = Image(np.full((40, 50, 3), 90, np.uint8))
    result = DeepMatcher().match(blank, blank)
    assert result.correspondence_map is not None
    assert np.isfinite(result.correspondence_map.map).all()
