from __future__ import annotations

import numpy as np
import pytest

from dgc_pose.viz.subsample import spread_evenly


def test_all_are_chosen_where_few():
    points = np.array([[5.0, 1.0], [0.0, 0.0], [3.0, 3.0]])
    assert spread_evenly(points, 10).tolist() == [0, 1, 2]


def test_none_of_none():
    assert spread_evenly(np.zeros((0, 2)), 10).tolist() == []


def test_the_same_place_is_taken_once():
    points = np.array([[1.0, 1.0]] * 5 + [[4.0, 4.0]])
    assert spread_evenly(points, 4).tolist() == [0, 5]


def test_each_next_is_the_farthest():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [10.0, 0.0], [4.0, 0.0]])
    assert spread_evenly(points, 2).tolist() == [0, 2]
    assert spread_evenly(points, 3).tolist() == [0, 2, 3]


@pytest.mark.parametrize("seed", range(3))
def test_a_crowd_takes_no_more_than_its_place(seed):
    rng = np.random.default_rng(seed)
    crowd, others = rng.normal(50, 1, (900, 2)), rng.random((100, 2)) * 1000
    chosen = spread_evenly(np.concatenate([crowd, others]), 50)
    assert len(chosen) == 50
    assert (chosen < 900).sum() <= 2
