"""Views that mislead: their cameras and poses are those of their pixels."""

import numpy as np
import pytest

from dgc_pose.cameras.camera import Camera
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.training.synthesis.misleading import (
    middle_quarter,
    night,
    render_facade,
    rolled,
    with_moving_object,
)

CAMERA = Camera(np.array([[90.0, 0, 30], [0, 80, 25], [0, 0, 1]]), (64, 48))
PIXELS = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)


def seen(camera: Camera, point: np.ndarray) -> np.ndarray:
    """The pixel (x, y) of a point (3,) in the camera's frame."""
    x, y, z = camera.K @ point
    return np.array([x / z, y / z])


@pytest.mark.parametrize("quarter_turns", [1, 2, 3, 4])
def test_a_rolled_camera_sees_the_same_pixels(quarter_turns) -> None:
    pixels, camera, R = rolled(PIXELS, CAMERA, quarter_turns)
    assert np.array_equal(pixels, np.rot90(PIXELS, quarter_turns))
    assert camera.size == (pixels.shape[1], pixels.shape[0])
    assert rotation_error_deg(R, np.eye(3)) == pytest.approx(90 * (2 - abs(2 - quarter_turns)))
    for x, y in ((3, 40), (60, 1), (31, 20)):
        u, v = seen(camera, R @ np.linalg.solve(CAMERA.K, [x, y, 1.0])).round(6)
        assert np.array_equal(pixels[int(v), int(u)], PIXELS[y, x])


def test_a_crop_keeps_its_pixels() -> None:
    pixels, camera = middle_quarter(PIXELS, CAMERA)
    assert camera.size == (16, 12)
    ray = np.linalg.solve(CAMERA.K, [30, 22, 1.0])
    u, v = seen(camera, ray).round(6).astype(int)
    assert np.array_equal(pixels[v, u], PIXELS[22, 30])


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_a_moving_object_covers_a_share_of_both_views(share: float) -> None:
    def made(seed: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        return with_moving_object((PIXELS, PIXELS), (CAMERA, CAMERA), rng, share)

    views = made(0)
    for view in views:
        changed = (view != PIXELS).any(axis=2)
        assert 0.5 * share < changed.mean() < 1.6 * share
        rows, columns = np.nonzero(changed)  # one piece, rather than specks
        assert changed[rows.min() : rows.max(), columns.min() : columns.max()].mean() > 0.5
    assert not np.array_equal(views[0], views[1])  # it moved
    assert all(map(np.array_equal, views, made(0)))


def test_night_is_darker_and_the_facade_is_seeded() -> None:
    dark = night(PIXELS, np.random.default_rng(1))
    assert dark.shape == PIXELS.shape and dark.mean() < 0.6 * PIXELS.mean()
    left, right, camera, R, t = render_facade(2, (80, 60))
    again = render_facade(2, (80, 60))
    assert np.array_equal(left, again[0]) and np.array_equal(right, again[1])
    assert not np.array_equal(left, render_facade(3, (80, 60))[0])
    assert left.shape == right.shape == (60, 80, 3) and camera.size == (80, 60)
    assert 16 <= rotation_error_deg(R, np.eye(3)) <= 24 and np.linalg.norm(t) > 0
