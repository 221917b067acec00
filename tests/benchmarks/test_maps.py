"""Maps of planes: pairs found in every layout, true maps, and figures against loops."""

import math

import cv2
import homography_scene as scene
import numpy as np
import pytest
import torch
import torch.nn.functional as F

from dgc_pose.benchmarks.maps import (
    PCK_THRESHOLDS,
    VIEWPOINTS,
    Comparison,
    compare_matcher,
    find_homography_pairs,
    level_errors,
    load_pair,
    pooled,
    score_map,
    true_map,
)
from dgc_pose.benchmarks.other_matchers import scaled_map
from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image
from dgc_pose.matching.correspondence_map import MatchingOptions, select_matches
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.training.views import MapPairs

CELLS = 60  # of 4 pixels
SHIFT = np.array([3.0, -1.5])  # pixels


def test_the_map_takes_a_pixel_through_both_resizes_and_the_inverse_up_to_the_horizon() -> None:
    found, valid = true_map(scene.H, scene.SIZE1, scene.SIZE2)
    w1, h1 = scene.SIZE1
    w2, h2 = scene.SIZE2
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
    # The source's line x = 160 goes to infinity: what lies right of it is behind the plane.
    H = np.array([[1.0, 0, 0], [0, 1.0, 0], [-1 / 160, 0, 1.0]])
    found, valid = true_map(H, (240, 240), (240, 240))
    assert np.isfinite(found).all() and valid.any()
    assert (found[valid][:, 0] < 160).all()


def test_the_source_at_the_map_is_the_target(tmp_path) -> None:
    scene.write_annotated(tmp_path, "wall")
    pairs = load_pair(*find_homography_pairs(tmp_path))
    assert pairs.image1.shape == pairs.image2.shape == (1, 3, 240, 240)
    normalised = (2 * pairs.map + 1) / 240 - 1
    warped = F.grid_sample(pairs.image1, normalised, align_corners=False)
    valid = pairs.valid[:, None].expand(-1, 3, -1, -1)
    assert 0.3 < pairs.valid.float().mean() < 0.95
    assert (warped - pairs.image2)[valid].abs().mean() < 0.01
    # The picture itself varies much more than that.
    assert (pairs.image1 - pairs.image2)[valid].abs().mean() > 0.1
    # RGB, not BGR: as the file has it.
    first = cv2.resize(scene.texture(), (240, 240), interpolation=cv2.INTER_AREA)[..., ::-1]
    assert np.abs(pairs.image1[0].numpy() - np.moveaxis(first, 2, 0) / 255).mean() < 0.01


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
    assert len(find_homography_pairs(tmp_path / "homogr")) == 2


@pytest.mark.parametrize(
    "text",
    ["1 0 0\n0 1 0\n", "1 0 0\n0 x 0\n0 0 1\n", "1 0 0\n0 1 0\n0 0 nan\n", "1 2 3\n" * 3],
)
def test_a_matrix_that_is_none_is_named(tmp_path, text: str) -> None:
    scene.write_annotated(tmp_path, "wall")
    (tmp_path / "wall_H.txt").write_text(text)
    with pytest.raises(InputError, match=r"wall_H\.txt cannot be read as a homography"):
        find_homography_pairs(tmp_path)


class Stretching(Matcher):
    """A map of 60x60 cells by x1 = scale x2 + SHIFT; its left third can be used."""

    def __init__(self, scale: float) -> None:
        self.scale = scale
        self.seen: list[tuple[Image, Image]] = []

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        self.seen.append((image1, image2))
        points = self.scale * (4 * pixel_grid((CELLS, CELLS)) + 1.5) + SHIFT
        usable = np.zeros((CELLS, CELLS))
        usable[:, : CELLS // 3] = 1
        dense = scaled_map((points + 0.5) / 4 - 0.5, usable, image1.size, image2.size)
        return MatchResult(select_matches(dense, MatchingOptions()), dense)


def _pair(truth: np.ndarray) -> MapPairs:
    """A pair whose source is black and whose target is white, without the truth of a row."""
    image = torch.ones(1, 3, 240, 240)
    visible = torch.ones(1, 240, 240, dtype=torch.bool)
    visible[0, 0] = False
    true = torch.tensor(truth).float()[None]
    return MapPairs(0 * image, image, true, visible, torch.ones_like(visible))


def test_between_centres_of_cells_a_map_is_linear_and_beyond_them_moves_along() -> None:
    """A shift is kept to the border; the outermost centres are at 1.5, whose displacement is wrong
    by a tenth of 1.5 px at 0 where the scale is 1.1."""
    matcher = Stretching(1.0)
    ((errors, valid),), matchability = compare_matcher(matcher, _pair(pixel_grid((240, 240))))
    assert np.allclose(errors[1:], np.hypot(*SHIFT), atol=1e-4)
    assert np.isinf(errors[0]).all() and not valid[0].any()
    assert (matchability == (np.arange(240) < 80)).all()
    black, white = matcher.seen[0]
    assert (black.pixels == 0).all() and (white.pixels == 255).all()
    truth = 1.1 * pixel_grid((240, 240)) + SHIFT
    ((errors, _),), _ = compare_matcher(Stretching(1.1), _pair(truth))
    assert errors[2:-2, 2:-2].max() < 1e-3
    assert np.isclose(errors[120, 0], 0.15, atol=1e-3)


def comparison(seed: int, *, blind: bool = False) -> Comparison:
    """A pair whose errors spread over the PCK thresholds, on small grids."""
    rng = np.random.default_rng(seed)
    levels = []
    for cells in (2, 4, 6, 8, 12):
        truth = rng.uniform(0, 240, (cells, cells, 2))
        valid = rng.random((cells, cells)) < (0.0 if blind else 0.7)
        levels.append(level_errors(truth + rng.normal(0, 4, truth.shape), truth, valid))
    return levels, rng.random((12, 12))


def distances_of(pair: Comparison) -> dict[tuple[int, int], float]:
    """By row and column of a valid cell of the finest level."""
    errors, valid = pair[0][-1]
    return {(y, x): float(errors[y, x]) for y, x in np.argwhere(valid).tolist()}


def test_figures_of_pairs_and_their_means_over_a_group() -> None:
    """Errors of valid pixels, both meanings of the mask, means over pairs and curves over pixels. A
    pair with nothing to find has no error and takes no part."""
    truth = np.zeros((1, 2, 2))
    points = np.array([[[3.0, -4.0], [1.0, 1.0]]])
    errors, _ = level_errors(points, truth, np.array([[True, False]]))
    assert errors.tolist() == [[5.0, math.inf]]
    pairs = [comparison(0), comparison(1), comparison(2, blind=True)]
    own = [score_map("net", "I", str(index), pair) for index, pair in enumerate(pairs)]
    limits = [*PCK_THRESHOLDS, 1, 3, 5]
    for found, pair in zip(own[:2], pairs, strict=False):
        near = distances_of(pair)
        matchability = pair[1]
        distances = [*near.values()]
        assert found.valid == len(distances) > 50
        assert found.means["aepe"] == found.means["aepe240"] == pytest.approx(np.mean(distances))
        assert found.near.tolist() == [sum(d <= limit for d in distances) for limit in limits]
        said = {(y, x) for y, x in np.ndindex(12, 12) if matchability[y, x] > 0.5}
        good = {place for place, distance in near.items() if distance < 4}
        for name, true in (("jaccard", {*near}), ("jaccard_found", good)):
            assert found.means[name] == pytest.approx(len(said & true) / len(said | true))
        assert found.means["jaccard"] != found.means["jaccard_found"]
        # A match is right within 3 px, and wrong where there is nothing.
        assert found.reliability is not None and found.reliability[0].sum() == 144
        assert found.reliability[1].sum() == sum(d <= 3 for d in distances) > 0
    group = pooled(own, "I")
    assert (group.method, group.group, group.pairs) == ("net", "I", 3)
    assert own[2].valid == 0 and math.isnan(own[2].means["aepe"])
    for name in ("aepe", "jaccard", *(f"aepe{cells}" for cells in (15, 30, 60, 120, 240))):
        assert group.means[name] == pytest.approx(np.nanmean([s.means[name] for s in own]))
    every = [distance for pair in pairs for distance in distances_of(pair).values()]
    np.testing.assert_allclose(
        group.pck[:200], [np.mean([d <= limit for d in every]) for limit in PCK_THRESHOLDS]
    )
    assert group.data["pck3"] == pytest.approx(np.mean([d <= 3 for d in every]))
    assert group.reliability is not None and group.reliability[0].sum() == 3 * 144
    assert np.isnan(pooled([own[2]]).pck).all()
