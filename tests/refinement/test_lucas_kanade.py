"""Patches aligned by shift, or with their affinity: against an exact affinity between images."""

import cv2
import numpy as np
import pytest

from dgc_pose.refinement.consistency import LocalMatches
from dgc_pose.refinement.lucas_kanade import Patches, align_patches

_SIDE = 300
_AFFINITY = np.array([[1.1, 0.15], [-0.1, 0.9]])  # of offsets in image 2 to offsets in image 1
_OFFSET = np.array([4.3, 12.8])


def _pictures(gain: float = 1.0, offset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Images 1 and 2 with image2(x) = gain * image1(A x + b) + offset."""
    rng = np.random.default_rng(3)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (400, 400)).astype(np.float32), (0, 0), 2)
    first = 128 + 6 * (texture - texture.mean())
    matrix = np.column_stack([_AFFINITY, _OFFSET])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    second = cv2.warpAffine(first, matrix, (_SIDE, _SIDE), flags=flags)
    return first, gain * second + offset


def _run(shift: float, change: np.ndarray, affine: bool, **light: float) -> tuple[Patches, ...]:
    """From starts off by `shift` pixels and a factor of the affinity: what is found, the truth."""
    rng = np.random.default_rng(4)
    points2 = rng.uniform(40, _SIDE - 40, (300, 2))
    angle = rng.uniform(0, 2 * np.pi, 300)
    truth = points2 @ _AFFINITY.T + _OFFSET
    start = truth + shift * np.stack([np.cos(angle), np.sin(angle)], -1)
    affinity = np.broadcast_to(_AFFINITY @ change, (300, 2, 2))
    local = LocalMatches(start, points2, affinity, np.arange(300))
    first, second = _pictures(**light)
    found = align_patches(first, second, local, 7, affine=affine)
    exact = Patches(truth, np.broadcast_to(_AFFINITY, (300, 2, 2)), np.ones(300), np.zeros(300))
    return found, exact


def _off(found: Patches, truth: Patches) -> np.ndarray:
    return np.linalg.norm(found.points1 - truth.points1, axis=1)


@pytest.mark.parametrize("affine", [False, True])
@pytest.mark.parametrize("light", [{}, {"gain": 0.5, "offset": 60.0}])
def test_a_shift_is_found_at_any_gain_and_offset(affine: bool, light: dict[str, float]) -> None:
    found, truth = _run(1.0, np.eye(2), affine, **light)
    good = found.zncc > 0.95
    assert good.mean() > 0.9
    assert np.median(_off(found, truth)[good]) < 0.03
    assert (found.step[good] < 0.1).mean() > 0.95
    if not affine:
        assert np.array_equal(found.affinity, truth.affinity)


def test_an_affinity_that_is_wrong_is_put_right() -> None:
    """A quarter of a patch's extent is off: shifts alone leave the patches dissimilar."""
    turn = np.radians(12)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    change = rotation * 1.12
    shifted, truth = _run(1.0, change, affine=False)
    found, _ = _run(1.0, change, affine=True)
    good = found.zncc > 0.95
    assert good.mean() > 0.85 > 0.3 > (shifted.zncc > 0.95).mean()
    assert np.median(_off(found, truth)[good]) < 0.05
    wrong = np.linalg.norm(found.affinity - truth.affinity, axis=(1, 2))[good]
    assert np.median(wrong) < 0.05 < np.linalg.norm(_AFFINITY @ change - _AFFINITY)


def test_an_affinity_that_changes_much_is_no_alignment() -> None:
    """Towards another texture everything is possible: none of it is a match."""
    first, second = _pictures()
    rng = np.random.default_rng(5)
    points1, points2 = rng.uniform(40, _SIDE - 40, (2, 400, 2))
    upright = np.broadcast_to(np.eye(2), (400, 2, 2))
    local = LocalMatches(points1, points2, upright, np.arange(400))
    found = align_patches(first, second, local, 7, affine=True)
    stretch = np.linalg.svd(found.affinity, compute_uv=False)
    beyond = (stretch >= 2).any(1) | (stretch <= 0.5).any(1) | (np.linalg.det(found.affinity) <= 0)
    assert beyond.any() and (found.zncc[beyond] == -1).all()
    assert (found.zncc > 0.9).mean() < 0.02
    assert np.isfinite(found.points1).all()


def test_no_patches() -> None:
    first, second = _pictures()
    none = np.zeros((0, 2))
    local = LocalMatches(none, none, np.zeros((0, 2, 2)), np.arange(0))
    found = align_patches(first, second, local, 7, affine=True)
    assert found.points1.shape == (0, 2) and found.zncc.shape == (0,)
