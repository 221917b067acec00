"""Which images are paired."""

import networkx as nx
import numpy as np
import pytest

from dgc_pose.batch.pair_choice import (
    most_similar,
    parse_pair_choice,
    similarities,
)
from dgc_pose.errors import InputError


@pytest.mark.parametrize(
    ("text", "count", "pairs"),
    [
        ("exhaustive", 3, [(0, 1), (0, 2), (1, 2)]),
        ("sequential:1", 3, [(0, 1), (1, 2)]),
        ("sequential:2", 4, [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]),
        ("sequential:9", 3, [(0, 1), (0, 2), (1, 2)]),
        ("auto:7", 3, []),
    ],
)
def test_the_pairs_of_a_choice(text, count, pairs):
    assert parse_pair_choice(text).pairs(count) == pairs


@pytest.mark.parametrize("text", ["all", "auto", "auto:0", "auto:-1", "sequential:x", "", "a:1"])
def test_another_text_is_refused(text):
    with pytest.raises(InputError, match="^pairs"):
        parse_pair_choice(text)


@pytest.mark.parametrize("most", [1, 3])
def test_the_most_similar_ones_and_a_spanning_tree(most):
    """Each image has its `most` best partners; networkx' maximum spanning tree is there too."""
    rng = np.random.default_rng(5)
    scores = rng.random((12, 12))
    scores[:6, 6:] *= 0.01  # two groups, which only the tree connects
    scores = np.triu(scores, 1)
    scores += scores.T
    found = set(most_similar(scores, most))
    for i in range(12):
        best = sorted((j for j in range(12) if j != i), key=lambda j: -scores[i, j])[:most]
        assert {(min(i, j), max(i, j)) for j in best} <= found
    graph = nx.from_numpy_array(scores)
    tree = {tuple(sorted(edge)) for edge in nx.maximum_spanning_edges(graph, data=False)}
    assert tree <= found
    assert len(found) <= 12 * most + 11
    assert nx.is_connected(nx.Graph(list(found)))


def _cells(rng, count):
    cells = rng.standard_normal((count, 32))
    return cells / np.linalg.norm(cells, axis=1, keepdims=True)


def _score(one, other):
    """Cell by cell."""
    best = [max(float(a @ b) for b in other) for a in one]
    best += [max(float(a @ b) for a in one) for b in other]
    return sum(best) / len(best)


def test_scores_are_those_of_a_plain_loop():
    """Also of images of different shapes; the progress counts pairs."""
    rng = np.random.default_rng(0)
    features = [_cells(rng, count) for count in (20, 20, 12, 30)]
    told = []
    scores = similarities(features, lambda done, of: told.append((done, of)))
    assert told == [(1, 6), (3, 6), (6, 6)]
    np.testing.assert_array_equal(scores, scores.T)
    for i, j in ((0, 1), (0, 2), (3, 2)):
        assert abs(scores[i, j] - _score(features[i], features[j])) < 1e-6
