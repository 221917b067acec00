"""The rivals as methods of the benchmarks: matches, maps, and no refinement."""

import dense_scene
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
    assert matcher.fingerprint is None
    found = matcher.match(*images)
    assert 0 < len(found.matches) <= 100 and found.aligned is None
    assert found.correspondence_map is not None


@pytest.mark.parametrize("name", RIVALS)
def test_a_rival_is_no_matcher_of_the_product(name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: no such file, and no such matcher"):
        load_matcher(name)
