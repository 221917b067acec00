"""Maps of matchers at 240x240, against maps that are computed by hand."""

import numpy as np
import torch

from dgc_pose.benchmarks.flow import scaled_map
from dgc_pose.benchmarks.map_run import compare_matcher
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image
from dgc_pose.matching.correspondence_map import MatchingOptions, select_matches
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.training.map_pairs import MapPairs

CELLS = 60  # of 4 pixels
SHIFT = np.array([3.0, -1.5])  # pixels


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


def _pairs(truth: np.ndarray) -> MapPairs:
    """Two pairs whose source is black and whose target is white, with the same true map."""
    images = torch.ones(2, 3, 240, 240)
    visible = torch.ones(2, 240, 240, dtype=torch.bool)
    visible[1, 0] = False
    maps = torch.tensor(truth).float().expand(2, -1, -1, -1)
    return MapPairs(0 * images, images, maps, visible, torch.ones_like(visible))


def test_a_shift_is_kept_to_the_border() -> None:
    matcher = Stretching(1.0)
    first, second = compare_matcher(matcher, _pairs(pixel_grid((240, 240))))
    (level,), (other,) = first.levels, second.levels
    assert np.allclose(level.errors, np.hypot(*SHIFT), atol=1e-4)
    assert np.isinf(other.errors[0]).all() and not other.valid[0].any()
    assert first.matchability is not None
    assert (first.matchability == (np.arange(240) < 80)).all()
    black, white = matcher.seen[0]
    assert (black.pixels == 0).all() and (white.pixels == 255).all()


def test_between_centres_of_cells_it_is_linear_and_beyond_them_moves_along() -> None:
    scale = 1.1
    (first, _) = compare_matcher(Stretching(scale), _pairs(scale * pixel_grid((240, 240)) + SHIFT))
    errors = first.levels[-1].errors
    assert errors[2:-2, 2:-2].max() < 1e-3
    # The outermost centres are at 1.5: their displacement is wrong by a tenth of 1.5 px at 0.
    assert np.isclose(errors[0, 120], 0.15, atol=1e-3)
