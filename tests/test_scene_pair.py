"""The pairs that tests of other modules use."""

import cv2
import numpy as np
import pytest
from scene_pair import render_scene_pair

KINDS = ("general", "planar", "rotation_only", "forward")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rotation_deg", (5.0, 25.0))
def test_pairs_carry_their_truth(kind, rotation_deg):
    pair = render_scene_pair(
        3, size1=(160, 120), size2=(120, 140), rotation_deg=rotation_deg, kind=kind
    )
    assert pair.image1.shape == (120, 160, 3) and pair.image1.dtype == np.uint8
    assert pair.image2.shape == (140, 120, 3) and pair.map.shape == (140, 120, 2)
    assert np.isclose(np.degrees(np.arccos((np.trace(pair.R) - 1) / 2)), rotation_deg, atol=1e-6)
    assert np.allclose(pair.R @ pair.R.T, np.eye(3), atol=1e-12)
    assert not np.allclose(pair.K1, pair.K2)
    assert pair.visible.mean() > 0.3

    y, x = np.nonzero(pair.visible)
    rays2 = np.column_stack((x, y, np.ones(len(x)))) @ np.linalg.inv(pair.K2).T
    points1 = (rays2 * pair.depth2[y, x, None] - pair.t) @ pair.R  # rows: R^T (X2 - t)
    seen = points1 @ pair.K1.T
    assert np.allclose(seen[:, :2] / seen[:, 2:], pair.map[y, x], atol=1e-6)


def test_kinds_have_their_motion():
    pairs = {
        kind: render_scene_pair(1, size1=(96, 96), size2=(96, 96), kind=kind) for kind in KINDS
    }
    assert np.linalg.norm(pairs["rotation_only"].t) < 1e-12
    centre2 = -pairs["forward"].R.T @ pairs["forward"].t
    assert centre2[2] > 0.1 and np.abs(centre2[:2]).max() < 1e-9
    for kind in KINDS:
        pair = pairs[kind]
        y, x = np.nonzero(pair.visible)
        H, inliers = cv2.findHomography(
            np.column_stack((x, y)).astype(np.float64), pair.map[y, x], cv2.RANSAC, 0.05
        )
        share = inliers.mean()
        assert share > 0.999 if kind in ("planar", "rotation_only") else share < 0.8, kind
