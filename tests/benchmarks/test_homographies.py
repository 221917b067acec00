"""Pairs with known homographies: found in every layout, with their true maps."""

import cv2
import homography_scene as scene
import numpy as np
import pytest
import torch
import torch.nn.functional as F

from dgc_pose.benchmarks.homographies import (
    VIEWPOINTS,
    find_homography_pairs,
    homography_set,
    load_pair,
    true_map,
)
from dgc_pose.errors import InputError


def test_the_map_takes_a_pixel_through_both_resizes_and_the_inverse() -> None:
    found, valid = true_map(scene.H, scene.SIZE1, scene.SIZE2)
    (w1, h1), (w2, h2) = scene.SIZE1, scene.SIZE2
    inverse = np.linalg.inv(scene.H)
    seen = []
    for y, x in [(0, 0), (7, 231), (120, 120), (200, 30), (239, 239)]:
        X = (x + 0.5) * w2 / 240 - 0.5
        Y = (y + 0.5) * h2 / 240 - 0.5
        u, v, w = inverse @ [X, Y, 1.0]
        place = [(u / w + 0.5) * 240 / w1 - 0.5, (v / w + 0.5) * 240 / h1 - 0.5]
        np.testing.assert_allclose(found[y, x], place, atol=1e-9)
        assert valid[y, x] == all(0 <= value <= 239 for value in place)
        seen.append(bool(valid[y, x]))
    assert len(set(seen)) == 2
    other, same = true_map(-3 * scene.H, scene.SIZE1, scene.SIZE2)
    np.testing.assert_allclose(other, found)
    assert (same == valid).all()


def test_nothing_beyond_the_horizon_is_valid() -> None:
    # The source's line x = 160 goes to infinity: what lies right of it is behind the plane.
    H = np.array([[1.0, 0, 0], [0, 1.0, 0], [-1 / 160, 0, 1.0]])
    found, valid = true_map(H, (240, 240), (240, 240))
    assert np.isfinite(found).all() and valid.any()
    assert (found[valid][:, 0] < 160).all()


def test_the_source_at_the_map_is_the_target(tmp_path) -> None:
    scene.write_annotated(tmp_path, "wall")
    (pair,) = find_homography_pairs(tmp_path)
    pairs = load_pair(pair)
    assert pairs.image1.shape == pairs.image2.shape == (1, 3, 240, 240)
    normalised = (2 * pairs.map + 1) / 240 - 1
    warped = F.grid_sample(pairs.image1, normalised, align_corners=False)
    valid = pairs.valid[:, None].expand(-1, 3, -1, -1)
    assert 0.3 < pairs.valid.float().mean() < 0.95
    difference = (warped - pairs.image2)[valid].abs()
    assert difference.mean() < 0.01
    # The picture itself varies much more than that.
    assert (pairs.image1 - pairs.image2)[valid].abs().mean() > 0.1
    # RGB, not BGR: as the file has it.
    first = cv2.resize(scene.texture(), (240, 240), interpolation=cv2.INTER_AREA)[..., ::-1]
    expected = torch.from_numpy(first.copy()).permute(2, 0, 1) / 255
    assert (pairs.image1[0] - expected).abs().mean() < 0.01


def test_pairs_of_every_layout_are_found_if_their_files_are_there(tmp_path) -> None:
    for name in ("v_wall", "v_adam", "i_dome"):
        scene.write_sequence(tmp_path / name)
    (tmp_path / "v_wall" / "3.ppm").unlink()
    (tmp_path / "v_wall" / "H_1_5").unlink()
    scene.write_vgg(tmp_path / "graf")
    scene.write_annotated(tmp_path / "homogr", "tower", "city")
    pairs = find_homography_pairs(tmp_path)
    groups = ["graf", "graf", "homogr", "homogr", *VIEWPOINTS, "I", "III", "V"]
    assert [pair.group for pair in pairs] == groups
    names = ["graf 1-2", "graf 1-3", "homogr/city", "homogr/tower", "v_adam 1-2", "v_adam 1-3"]
    assert [pair.name for pair in pairs[:6]] == names
    np.testing.assert_array_equal(pairs[0].H, scene.H)
    data = homography_set(tmp_path)
    assert (data.total, data.facts["sequences"]) == (12, 2)
    assert len(find_homography_pairs(tmp_path / "homogr")) == 2


@pytest.mark.parametrize(
    "text",
    ["1 0 0\n0 1 0\n", "1 0 0\n0 x 0\n0 0 1\n", "1 0 0\n0 1 0\n0 0 nan\n", "1 2 3\n" * 3],
)
def test_a_matrix_that_is_none_is_named(tmp_path, text: str) -> None:
    scene.write_annotated(tmp_path, "wall")
    (tmp_path / "wall_H.txt").write_text(text)
    with pytest.raises(InputError, match=r"wall_H\.txt is not a homography"):
        find_homography_pairs(tmp_path)
