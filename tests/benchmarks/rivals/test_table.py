"""The rivals as methods of the benchmarks: matches, maps, and no refinement."""

import cv2
import dense_scene
import numpy as np
import pytest

from dgc_pose import load_matcher
from dgc_pose.benchmarks.methods import RIVALS
from dgc_pose.benchmarks.rivals import deep_matching
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import Matcher, MatchingOptions


def _matcher(name: str, matching: MatchingOptions | None = None) -> Matcher:
    options = MatcherOptions(name, "cpu", matching=matching or MatchingOptions())
    return RIVALS[name].load(options, None, None)


@pytest.mark.parametrize("name", RIVALS)
def test_a_rival_matches_within_its_options(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deep_matching, "SIDE", 64)
    images = map(Image, dense_scene.pictures())
    matcher = _matcher(name, MatchingOptions(max_matches=100))
    assert matcher.name == name and matcher.engine is None
    assert (matcher.fingerprint is None) == (name == "deepmatching")
    found = matcher.match(*images)
    assert 0 < len(found.matches) <= 100 and found.aligned is None
    assert found.correspondence_map is not None


@pytest.mark.parametrize("name", RIVALS)
def test_a_rival_is_no_matcher_of_the_product(name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: no such file, and no such matcher"):
        load_matcher(name)


@pytest.mark.parametrize("cells", [240, 60])
def test_transformations_follow_an_image_that_is_moved(cells: int) -> None:
    pixels = dense_scene.pictures()[0]
    height, width = pixels.shape[:2]
    moved = cv2.getRotationMatrix2D((width / 2, height / 2), 10, 1.1) + [[0, 0, 12], [0, 0, -8]]
    other = Image(cv2.warpAffine(pixels, moved, (width, height), borderMode=cv2.BORDER_REFLECT))
    matcher = _matcher("rocco", MatchingOptions(finest=cells))  # type: ignore[arg-type]
    result = matcher.match(Image(pixels), other).correspondence_map
    assert result is not None and result.map.shape == (cells, cells, 2)
    assert (result.matchability == 1).all()
    back = cv2.transform(result.grid.astype(np.float64), cv2.invertAffineTransform(moved))
    inside = ((back >= 0) & (back <= [width - 1, height - 1])).all(-1)
    errors = np.linalg.norm(result.map - back, axis=-1)[inside]
    apart = np.linalg.norm(result.grid - back, axis=-1)[inside]
    assert errors.mean() < 0.4 * apart.mean()
