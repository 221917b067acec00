"""Methods by name, and what each takes of a map."""

from __future__ import annotations

import numpy as np
import pytest

from dgc_pose.benchmarks.dtu.methods import Method, load_engines, matches_of, parse_methods
from dgc_pose.errors import InputError, WeightsError
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap, MatchingOptions, MatchResult, select_matches


def test_names_stand_for_methods() -> None:
    assert parse_methods(["sift", "a/b.pth/all", "raft"], ["raft", "other"]) == [
        Method("sift", "sift"),
        Method("a/b.pth/all", "a/b.pth", everywhere=True),
        Method("raft", "raft"),
        Method("other", "other"),
    ]
    # One that is asked for without its mask alone is not added with it.
    assert parse_methods(["raft/all"], ["raft"]) == [Method("raft/all", "raft", everywhere=True)]


@pytest.mark.parametrize(
    ("names", "external", "reason"),
    [
        ([], [], "no methods"),
        (["dis", "sift", "dis"], [], "'dis' is named twice"),
        (["/all"], [], "is none"),
        (["sift/all"], [], "key points alone"),
        (["dis"], ["sift"], "there already"),
        (["dis"], ["dgcm-lite"], "there already"),
    ],
)
def test_names_that_stand_for_none(names, external, reason) -> None:
    with pytest.raises(InputError, match=reason):
        parse_methods(names, external)


def _map() -> CorrespondenceMap:
    """10 x 10 cells onto themselves; half of them trusted, a corner outside image 1."""
    grid = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0)), -1).astype(np.float32)
    place = grid.copy()
    place[:2, :2] -= 5
    trust = np.zeros((10, 10), np.float32)
    trust[:, :5] = 0.8
    return CorrespondenceMap(place, grid, trust, (10, 10), (10, 10), None)


def _taken(method: Method, options: MatchingOptions) -> Matches:
    found = _map()
    return matches_of(method, MatchResult(select_matches(found, options), found), options)


def test_a_method_takes_what_it_trusts_or_everything() -> None:
    options = MatchingOptions(min_share=0.9)  # more than the mask leaves
    trusting = MatchingOptions(matchability=0.5)
    everywhere = Method("n/all", "n", everywhere=True)
    assert len(_taken(everywhere, options)) == 96
    assert len(_taken(Method("n", "n"), trusting)) == 46
    assert len(_taken(Method("n", "n"), MatchingOptions(matchability=0.9))) == 0
    assert len(_taken(Method("n", "n"), options)) == 0
    assert len(_taken(everywhere, MatchingOptions(max_matches=10))) <= 10


def test_points_have_no_everywhere() -> None:
    points = Matches(np.zeros((3, 2)), np.zeros((3, 2)), np.ones(3), 1.0)
    found = MatchResult(points, None)
    assert matches_of(Method("p", "p"), found, MatchingOptions()) is points
    with pytest.raises(InputError, match="points and no map"):
        matches_of(Method("p/all", "p", everywhere=True), found, MatchingOptions())


def test_an_engine_is_loaded_once(tmp_path) -> None:
    methods = parse_methods(["dis", "dis/all", "mine"], ["mine"])
    engines = load_engines(methods, {"mine": tmp_path}, device="cpu", options=MatchingOptions())
    assert set(engines.by_name) == {"dis", "mine"} and not engines.caches
    with pytest.raises(WeightsError, match="nowhere"):
        load_engines(
            parse_methods(["nowhere"]), {}, device="cpu", options=MatchingOptions()
        )
