"""The fixed sets: what they hold, by an independent look at their maps."""

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from textures import drawn_photos

from dgc_pose.benchmarks.map_run import MapCase
from dgc_pose.benchmarks.synthetic import SETS, synthetic_cases
from dgc_pose.training.photos import Photos


@pytest.fixture(scope="module")
def photos() -> Photos:
    return drawn_photos(6, 128)


@pytest.fixture(scope="module")
def cases(photos: Photos) -> dict[str, MapCase]:
    """The first batch of every set."""
    return {name: next(synthetic_cases(photos, name, 4, 0)) for name in SETS}


def test_the_source_at_the_map_is_the_target_pixel_by_pixel(cases: dict[str, MapCase]) -> None:
    """No change of light and no occluders: what is left is the sampling."""
    for name in ("affine", "affine-tps", "homography"):
        pairs = cases[name].pairs
        place = (2 * pairs.map + 1) / 240 - 1
        warped = F.grid_sample(pairs.image1, place, align_corners=False)
        off = (warped - pairs.image2).abs().mean(1)[pairs.valid]
        assert off.median() < 0.02, name
        inside = (place.abs() <= 1).all(-1)
        assert (pairs.valid == inside).all(), name


def test_names_say_which_homographies_look_past_the_horizon(photos: Photos) -> None:
    """The denominator of the homography fitted to the map changes sign in those views."""
    said, found = [], []
    y, x = np.mgrid[0:240, 0:240].astype(float)
    for case in synthetic_cases(photos, "homography", 16, 2):
        said += [name.endswith(", past its horizon") for name in case.names]
        for truth, valid in zip(case.pairs.map.double().numpy(), case.pairs.valid, strict=True):
            here = np.column_stack([x[valid], y[valid]])
            matrix, _ = cv2.findHomography(here[::50], truth[valid.numpy()][::50])
            denominator = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
            found.append(bool(denominator.min() < 0 < denominator.max()))
    assert said == found and 0 < sum(said) < 8


def test_the_same_seed_gives_the_same_pairs_and_more_only_add(
    photos: Photos, cases: dict[str, MapCase]
) -> None:
    more = list(synthetic_cases(photos, "affine", 10, 0))
    assert [name for case in more for name in case.names] == [f"affine {n}" for n in range(10)]
    assert torch.equal(cases["affine"].pairs.image2, more[0].pairs.image2[:4])
    other = next(synthetic_cases(photos, "affine", 4, 1))
    assert not torch.equal(cases["affine"].pairs.map, other.pairs.map)


def test_scenes_have_hidden_pixels(cases: dict[str, MapCase]) -> None:
    case = cases["scenes"]
    inside = ((case.pairs.map >= -0.5) & (case.pairs.map <= 239.5)).all(-1)
    assert (case.pairs.valid & ~inside).sum() == 0
    assert (inside & ~case.pairs.valid).any()


def test_changed_pairs_have_the_same_kind_of_map_in_another_light(
    photos: Photos, cases: dict[str, MapCase]
) -> None:
    plain = cases["affine"].pairs
    changed = next(synthetic_cases(photos, "affine", 4, 0, changed=True)).pairs
    torch.testing.assert_close(plain.map, changed.map)
    assert (plain.image1 - changed.image1).abs().mean() > 0.03
    assert (plain.valid & ~changed.valid).any() and not (changed.valid & ~plain.valid).any()
