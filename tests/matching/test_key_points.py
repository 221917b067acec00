"""SIFT as a matcher, on a rendered pair whose true map is known."""

import numpy as np
from rendered import render_scene_pair

from dgc_pose.images.image import Image
from dgc_pose.matching.key_points import RATIO, SiftMatcher


def test_matches_lie_on_the_true_map() -> None:
    pair = render_scene_pair(3, size1=(480, 360), size2=(440, 400), rotation_deg=10)
    result = SiftMatcher().match(Image(pair.image1), Image(pair.image2))
    matches = result.matches
    assert result.correspondence_map is None
    assert len(matches) > 60
    x, y = np.rint(matches.points2).astype(int).T
    seen = pair.visible[y, x]
    error = np.linalg.norm(pair.map[y, x] - matches.points1, axis=1)[seen]
    assert np.median(error) < 1.0 and (error < 3).mean() > 0.8
    assert matches.confidence.min() >= 1 - RATIO
    assert matches.key_points


def test_images_without_texture_give_no_matches() -> None:
    blank = Image(np.full((100, 120, 3), 127, np.uint8))
    matches = SiftMatcher().match(blank, blank).matches
    assert len(matches) == 0 and matches.points1.shape == (0, 2)
