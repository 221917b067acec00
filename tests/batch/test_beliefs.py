"""What a folder believes of its pairs."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
from results import camera, true_row

from dgc_pose.batch.beliefs import believed, by_itself, shows_repeats, solutions
from dgc_pose.batch.rows import MatchedPair
from dgc_pose.matches import Matches

IMAGES = 8
PAIRS = list(combinations(range(IMAGES), 2))
NUMBER = {pair: k for k, pair in enumerate(PAIRS)}
TRIPLES = np.array(
    [[NUMBER[a, b], NUMBER[b, c], NUMBER[a, c]] for a, b, c in combinations(range(IMAGES), 3)]
)


def _agree(right: np.ndarray) -> np.ndarray:
    """Whether the triples of pairs agree: all but those with one wrong pose alone."""
    return right[TRIPLES].sum(1) != 2


def _values(probability: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Those of `gathered`; around: of surroundings and own cells alike."""
    log_odds = np.log(probability / (1 - probability))
    return np.column_stack([log_odds, around, around])


def _in_folder(values: np.ndarray, found: np.ndarray, agree: np.ndarray) -> np.ndarray:
    solved = solutions(values[:, 0], by_itself(values), found, agree)
    return solved[shows_repeats(solved, values)]


def test_two_rooms_that_look_alike_are_parted():
    """Images 0 to 3 and 4 to 7. Poses between them are as probable and agree with all others; less
    surrounds them that is alike, but for some."""
    right = np.array([(a < 4) == (b < 4) for a, b in PAIRS])
    around = np.where(right, 0.0, -0.6) + np.random.default_rng(0).normal(0, 0.25, len(PAIRS))
    values = _values(np.full(len(PAIRS), 0.98), around)
    assert ((by_itself(values) > 0) != right).any() and _agree(right).all()
    assert np.array_equal(_in_folder(values, TRIPLES, _agree(right)) > 0, right)


def test_an_ordinary_folder_keeps_its_pairs():
    """Of which a third has surroundings that are less alike, and nothing contradicts them."""
    right = np.ones(len(PAIRS), bool)
    around = np.random.default_rng(1).normal(-0.1, 0.2, len(PAIRS))
    values = _values(np.full(len(PAIRS), 0.97), around)
    assert 5 < (by_itself(values) < 0).sum() < 20
    assert (_in_folder(values, TRIPLES, _agree(right)) > 0).all()


def test_what_surrounds_no_match_tells_of_no_repeats():
    """The same two rooms by matches whose surroundings are not known."""
    right = np.array([(a < 4) == (b < 4) for a, b in PAIRS])
    values = _values(np.full(len(PAIRS), 0.98), np.where(right, 0.0, -0.9))
    values[:, 1] = np.nan
    assert (_in_folder(values, TRIPLES, _agree(right)) > 0).all()


def test_a_wrong_pose_that_triples_contradict_is_turned_down():
    right = np.arange(len(PAIRS)) != 5
    values = _values(np.full(len(PAIRS), 0.95), np.zeros(len(PAIRS)))
    assert np.array_equal(_in_folder(values, TRIPLES, _agree(right)) > 0, right)


def test_an_unlikely_pose_that_triples_agree_with_holds():
    right = np.ones(len(PAIRS), bool)
    probability = np.where(np.arange(len(PAIRS)) == 5, 0.3, 0.95)
    values = _values(probability, np.zeros(len(PAIRS)))
    assert (_in_folder(values, TRIPLES, _agree(right)) > 0).all()


def test_without_triples_each_pair_is_as_by_itself():
    values = _values(np.array([0.9, 0.3]), np.zeros(2))
    after = _in_folder(values, np.zeros((0, 3), np.int64), np.zeros(0, bool))
    np.testing.assert_allclose(1 / (1 + np.exp(-after)), [0.9, 0.3])


def test_more_of_each_value_speaks_for_a_pair():
    base = by_itself(np.zeros((1, 3)))[0]
    assert (by_itself(0.1 * np.eye(3)) > base).all()
    assert np.abs(by_itself(np.array([[99.0, 9.0, 9.0], [-99.0, -9.0, -9.0]]))).max() <= 5


def test_a_pair_in_no_triple_has_its_own_probability_and_is_not_turned_down():
    """A claim, one that `min_probability` alone allows, and a rotation of an unlikely pose."""
    points = np.random.default_rng(0).uniform(10, 170, (100, 2))
    matches = Matches(points, points + (5.0, 0.0), np.ones(100), error_px=0.5)
    pairs = []
    for k, (status, probability) in enumerate((("ok", 0.8), ("ok", 0.3), ("rotation_only", 0.1))):
        row = true_row(("a", "bcd"[k]), np.eye(3), np.array([1.0, 0, 0]), status)
        own = 0.0 if status == "rotation_only" else probability
        pose = replace(row.pose, probability=own, any_probability=probability)
        pairs.append(MatchedPair(replace(row, pose=pose, index=k), matches))
    plan = SimpleNamespace(names="abcd", final_cameras=dict.fromkeys("abcd", camera()))
    rows = believed(pairs, plan)
    assert [row.folder_probability for row in rows] == [0.8, 0.6, 0.6]
    assert not any(row.turned_down for row in rows)
    assert [row.folder_triples for row in rows] == 3 * [(0, 0)]
