"""What a folder says of its pairs: poses that agree in threes, and places that look alike."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from results import EYE, camera, pair_row
from scenes import two_views
from scipy.spatial.transform import Rotation

from dgc_pose.batch.look_alikes import (
    PlacedPair,
    evidence_of_pairs,
    folder_probabilities,
    has_repeats,
    log_unshared_cells,
    own_log_odds,
    solutions,
    triples,
)
from dgc_pose.batch.pairs import MatchedPair
from dgc_pose.matches import Matches

POINTS = np.random.default_rng(0).uniform((-2, -1.5, 4), (2, 1.5, 7), (400, 3))
CENTRES = np.array([[-0.6, 0, 0], [-0.1, 0.1, 0.2], [0.5, -0.1, 0], [0.9, 0.2, 0.1]])
TURNS = Rotation.from_rotvec([[0, 0.1, 0], [0.02, 0, 0], [0, -0.1, 0.05], [0, -0.2, 0]]).as_matrix()


def _placed(
    first: int, second: int, *, moved=(0.0, 0.0, 0.0), status="ok", points=POINTS
) -> PlacedPair:
    """The true pose of two images; moved: by how much what image 2 shows is another place."""
    R = TURNS[second] @ TURNS[first].T
    t = TURNS[second] @ (CENTRES[first] + moved - CENTRES[second])
    seen = (points - CENTRES[first]) @ TURNS[first].T
    scene = two_views(seen, (camera(), camera()), (R, t), np.random.default_rng(0))
    row = pair_row((str(first), str(second)), status, R, t, count=len(scene.true))
    return PlacedPair.of(MatchedPair(row, scene.matches), (first, second), scene.cameras)


def test_right_poses_agree_whatever_the_order_of_their_images():
    for order in (1, -1):
        pairs = [_placed(*pair[::order]) for pair in combinations(range(4), 2)]
        found, agree = triples(pairs)
        assert len(found) == 4 and agree.all()
        for row in found:
            assert len({image for k in row for image in pairs[k].images}) == 3


@pytest.mark.parametrize(
    ("of_second", "of_third", "agrees"),
    [
        # The rotation is right, and along the way the direction may be, too.
        ((0, 0, 0), (1.5, 0, 0), False),
        ((0, 0, 0), (0, 0, 2.0), False),
        ((1.5, 0, 0), (1.5, 0, 0), True),  # of one deception: image 2 is alike to both others
    ],
)
def test_one_pose_of_another_place_contradicts_two_right_ones(of_second, of_third, agrees):
    pairs = [_placed(0, 1), _placed(1, 2, moved=of_second), _placed(0, 2, moved=of_third)]
    found, agree = triples(pairs)
    assert (found.tolist(), agree.tolist()) == ([[0, 1, 2]], [agrees])


def test_a_rotation_alone_contradicts_by_its_rotation_and_never_agrees():
    still = _placed(0, 2, status="rotation_only")
    assert np.isnan(still.t).all() and np.isnan(still.log_depths[0]).all()
    assert len(triples([_placed(0, 1), _placed(1, 2), still])[0]) == 0
    turned = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    wrong = replace(still, R=turned @ still.R)
    assert triples([_placed(0, 1), _placed(1, 2), wrong])[1].tolist() == [False]


def test_poses_without_common_points_agree_on_no_scale():
    """Of each pair other points: nothing tells the lengths, and nothing is clear."""
    parts = np.array_split(POINTS, 3)
    pairs = ((0, 1), (1, 2), (0, 2))
    pairs = [_placed(*p, points=part[:4]) for p, part in zip(pairs, parts, strict=True)]
    assert len(triples(pairs)[0]) == 0


def test_cells_of_few_pairs_count():
    """Image 0 shows one half to images 1 to 3, and the other to image 1 alone."""
    left, right = POINTS[POINTS[:, 0] < -0.3], POINTS[POINTS[:, 0] > 0.3]
    pairs = [_placed(0, 1), *(_placed(0, k, points=left) for k in (2, 3))]
    whole, *parts = log_unshared_cells(pairs)
    alone = log_unshared_cells([_placed(0, 1, points=right), *pairs[1:]])[0]
    assert whole > max(parts) and alone > max(parts)
    assert log_unshared_cells([]).shape == (0,)


IMAGES = 8
PAIRS = list(combinations(range(IMAGES), 2))
NUMBER = {pair: k for k, pair in enumerate(PAIRS)}
TRIPLES = np.array(
    [[NUMBER[a, b], NUMBER[b, c], NUMBER[a, c]] for a, b, c in combinations(range(IMAGES), 3)]
)
EVERY = np.ones(len(PAIRS), bool)
ROOMS = np.array([(a < 4) == (b < 4) for a, b in PAIRS])  # pairs within one


def _agree(right: np.ndarray) -> np.ndarray:
    """Whether the triples of pairs agree: all but those with one wrong pose alone."""
    return right[TRIPLES].sum(1) != 2


def _rights(probability, around, right=EVERY, *, known=True):
    """Whether each pair is right in its folder, and its log-odds by itself.

    around: of context_ratio and unshared cells alike; known: whether context_ratio are. right: with
    which the triples agree.
    """
    probability = np.broadcast_to(probability, len(PAIRS))
    around = np.broadcast_to(around, len(PAIRS))
    log_odds = np.log(probability / (1 - probability))
    values = np.column_stack([log_odds, around if known else np.nan * around, around])
    solved = solutions(values[:, 0], own_log_odds(values), TRIPLES, _agree(right))
    return solved[has_repeats(solved, values)] > 0, own_log_odds(values)


def test_two_rooms_that_look_alike_are_parted():
    """Images 0 to 3 and 4 to 7. Poses between them are as probable and agree with all others; less
    surrounds them that is alike, but for some. Surroundings that are not known tell nothing."""
    noise = np.random.default_rng(0).normal(0, 0.25, len(PAIRS))
    found, alone = _rights(0.98, np.where(ROOMS, 0.0, -0.6) + noise, ROOMS)
    assert ((alone > 0) != ROOMS).any() and _agree(ROOMS).all()
    assert np.array_equal(found, ROOMS)
    assert _rights(0.98, np.where(ROOMS, 0.0, -6.0), ROOMS, known=False)[0].all()


def test_an_ordinary_folder_keeps_its_pairs():
    """Of which a third has context_ratio that are less alike, and nothing contradicts them."""
    around = np.random.default_rng(1).normal(-0.1, 0.2, len(PAIRS))
    found, alone = _rights(0.97, around)
    assert 5 < (alone < 0).sum() < 20 and found.all()


def test_triples_turn_a_wrong_pose_down_and_hold_an_unlikely_one():
    right = np.arange(len(PAIRS)) != 5
    assert np.array_equal(_rights(0.95, 0.0, right)[0], right)
    assert _rights(np.where(right, 0.95, 0.3), 0.0)[0].all()


def test_few_pairs_do_not_make_a_folder_one_with_repeats():
    """Two pairs, of which one has less alike surroundings, and no triple."""
    values = np.array([[4.6, 0.16, 0.1], [3.7, -0.47, -0.4]])
    alone, found = own_log_odds(values), np.zeros((0, 3), np.int64)
    solved = solutions(values[:, 0], alone, found, np.zeros(0, bool))
    assert alone[1] < -1 and solved[1][1] < 0 and not has_repeats(solved, values)


def _matched(names: str, probability: float, status="ok", *, index=0, R=EYE) -> MatchedPair:
    """A pair of 100 matches. probability: of a pose of a rotation_only pair that is not claimed."""
    points = np.random.default_rng(0).uniform(10, 170, (100, 2))
    matches = Matches(points, points + (5.0, 0.0), np.ones(100), error_px=0.5)
    own = 0.0 if status == "rotation_only" else probability
    known = {"probability": own, "any_probability": probability}
    row = pair_row(names, status, R, (1, 0, 0), count=100, **known)
    return MatchedPair(replace(row, index=index), matches)


PLAN = SimpleNamespace(names="abcd", final_cameras=dict.fromkeys("abcd", camera()))


@pytest.mark.parametrize(
    ("probability", "count", "holds"), [(1.0, 2, True), (1.0, 3, False), (0.99, 2, False)]
)
def test_two_triples_do_not_turn_the_most_certain_pair_down(probability, count, holds):
    _, _, values = evidence_of_pairs([_matched("ab", probability)], PLAN)
    probable = np.append(values[0, 0], np.full(2 * count, 6.0))
    found = np.array([(0, k, k + count) for k in range(1, count + 1)])
    log_odds, _, _ = solutions(probable, probable, found, np.zeros(count, bool))
    assert (log_odds[0] > np.log(1.5)) == holds


def test_pairs_of_views_far_apart_are_expected_to_share_less():
    """Two pairs with the same cells: the one that turned by 60 degrees has more than expected."""
    turned = Rotation.from_euler("y", 60, degrees=True).as_matrix()
    pairs = _matched("ab", 0.9), _matched("cd", 0.9, index=1, R=turned)
    _, placed, values = evidence_of_pairs(pairs, PLAN)
    near, far = log_unshared_cells(placed)
    assert near == far and values[1, 2] - values[0, 2] > 3


def test_a_pair_in_no_triple_has_its_own_probability_and_is_not_turned_down():
    """A claim, one that `min_probability` alone allows, and a rotation of an unlikely pose."""
    kinds = ("ab", 0.8, "ok"), ("ac", 0.3, "ok"), ("ad", 0.1, "rotation_only")
    pairs = [_matched(*kind, index=k) for k, kind in enumerate(kinds)]
    rows = folder_probabilities(pairs, PLAN)
    assert [row.folder_probability for row in rows] == [0.8, 0.6, 0.6]
    assert not any(row.rejected for row in rows)
    assert [row.folder_triples for row in rows] == 3 * [(0, 0)]
