"""The protocol against what the paper states of it (section 4.4)."""

import dense_scene
import numpy as np

from dgc_pose.benchmarks.dtu.protocol import PAPER_SIZE, paper_options
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import select_matches


def test_every_match_counts_and_the_best_of_five_runs_is_not_refined():
    matcher, estimation = paper_options(MatcherOptions(), EstimationOptions(seed=7))
    assert PAPER_SIZE == (256, 256)
    assert (estimation.runs, estimation.iterations, estimation.refine) == (5, 1000, False)
    assert estimation.seed == 7
    dense = dense_scene.true_map()
    inside = (dense.map >= -0.5).all(-1) & (dense.map <= np.array(dense.size1) - 0.5).all(-1)
    trusted = inside & (dense.matchability >= 0.7)
    assert len(select_matches(dense, matcher.matching)) == trusted.sum() > 2000
