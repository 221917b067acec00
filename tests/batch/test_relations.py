"""Poses of a folder's pairs: which agree in threes, and what of a pair few others have."""

from itertools import combinations

import numpy as np
import pytest
from results import camera, true_row
from scipy.spatial.transform import Rotation
from worlds import SIZE, K

from dgc_pose.batch.relations import Relation, own_cells, triples
from dgc_pose.batch.rows import MatchedPair
from dgc_pose.matches import Matches

POINTS = np.random.default_rng(0).uniform((-2, -1.5, 4), (2, 1.5, 7), (400, 3))
CENTRES = np.array([[-0.6, 0, 0], [-0.1, 0.1, 0.2], [0.5, -0.1, 0], [0.9, 0.2, 0.1]])
TURNS = Rotation.from_rotvec([[0, 0.1, 0], [0.02, 0, 0], [0, -0.1, 0.05], [0, -0.2, 0]]).as_matrix()


def _seen(points: np.ndarray, image: int) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) of points of the world in an image, and their depths (N,)."""
    x = (points - CENTRES[image]) @ TURNS[image].T
    pixels = x / x[:, 2:] @ K.T
    return pixels[:, :2], x[:, 2]


def _relation(
    first: int, second: int, *, moved=(0.0, 0.0, 0.0), status="ok", points=POINTS
) -> Relation:
    """The true pose of two images; moved: by how much what image 2 shows is another place."""
    points1, _ = _seen(points, first)
    points2, _ = _seen(points + moved, second)
    inside = [((p > 0) & (np.array(SIZE) > p)).all(1) for p in (points1, points2)]
    kept = inside[0] & inside[1]
    R = TURNS[second] @ TURNS[first].T
    t = TURNS[second] @ (CENTRES[first] + moved - CENTRES[second])
    row = true_row((str(first), str(second)), R, t, status, int(kept.sum()))
    matches = Matches(points1[kept], points2[kept], np.ones(kept.sum()), error_px=0.5)
    return Relation.of(MatchedPair(row, matches), (first, second), (camera(), camera()))


def test_right_poses_agree_whatever_the_order_of_their_images():
    for order in (1, -1):
        relations = [_relation(*pair[::order]) for pair in combinations(range(4), 2)]
        found, agree = triples(relations)
        assert len(found) == 4 and agree.all()
        for row in found:
            assert len({image for k in row for image in relations[k].images}) == 3


@pytest.mark.parametrize("moved", [(1.5, 0, 0), (0, 0, 2.0), (0, -1.2, 0)])
def test_one_pose_of_another_place_contradicts_two_right_ones(moved):
    """Its rotation is right, and along the way its direction may be, too."""
    relations = [_relation(0, 1), _relation(1, 2), _relation(0, 2, moved=moved)]
    found, agree = triples(relations)
    assert found.tolist() == [[0, 1, 2]] and not agree.any()


def test_two_poses_of_one_deception_agree_with_a_right_one():
    """Image 2 shows another place, alike, to both others."""
    moved = (1.5, 0, 0)
    relations = [_relation(0, 1), _relation(1, 2, moved=moved), _relation(0, 2, moved=moved)]
    assert triples(relations)[1].tolist() == [True]


def test_a_rotation_alone_contradicts_by_its_rotation_and_never_agrees():
    still = _relation(0, 2, status="rotation_only")
    assert still.t is None and np.isnan(still.log_depths[0]).all()
    assert len(triples([_relation(0, 1), _relation(1, 2), still])[0]) == 0
    turned = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    wrong = Relation(*((0, 2), turned @ still.R, None, (0.0, 0.0), still.cells, still.log_depths))
    assert triples([_relation(0, 1), _relation(1, 2), wrong])[1].tolist() == [False]


def test_poses_without_common_points_agree_on_no_scale():
    """Of each pair other points: nothing tells the lengths, and nothing is clear."""
    parts = np.array_split(POINTS, 3)
    pairs = ((0, 1), (1, 2), (0, 2))
    relations = [_relation(*p, points=part[:4]) for p, part in zip(pairs, parts, strict=True)]
    assert len(triples(relations)[0]) == 0


def test_no_triple_among_few_pairs():
    for relations in ([], [_relation(0, 1)], [_relation(0, 1), _relation(2, 3)]):
        found, agree = triples(relations)
        assert found.shape == (0, 3) and agree.shape == (0,)


def test_cells_of_few_pairs_count():
    """Image 0 shows one half to images 1 to 3, and the other to image 1 alone."""
    left, right = POINTS[POINTS[:, 0] < -0.3], POINTS[POINTS[:, 0] > 0.3]
    relations = [_relation(0, 1), *(_relation(0, k, points=left) for k in (2, 3))]
    whole, *parts = own_cells(relations)
    alone = own_cells([_relation(0, 1, points=right), *relations[1:]])[0]
    assert whole > max(parts) and alone > max(parts)
    assert own_cells([]).shape == (0,)
