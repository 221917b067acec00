"""How many of the pairs that verify are chosen by `--pairs auto:K`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dgc_pose.batch.pair_choice import most_similar
from dgc_pose.batch.run import Batch
from dgc_pose.batch.similarity import similarities
from dgc_pose.batch.work import Describe, Described, Job, MatcherSettings, Worker
from dgc_pose.benchmarks.table import aligned
from dgc_pose.colmap.database import CONFIGURATIONS
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions

_MEMORY = 2**28  # bytes of images; each is loaded once


@dataclass(frozen=True)
class Recall:
    """Of one K."""

    number: int  # K
    chosen: int  # pairs
    pairs: int  # of all images
    verified: int  # pairs of the batch with a pose or a rotation
    found: int  # of those, how many are chosen


def coarse_features(batch: Batch, weights: str) -> list[np.ndarray]:
    """The coarsest features of the images of a batch, as `auto` compares them.

    Raises InputError for an image that cannot be used, and for a matcher without a network.
    """
    plan = batch.plan
    matcher = MatcherSettings(weights, refinement=None)
    worker = Worker(Job(plan.root, plan.cameras, plan.bad, matcher, EstimationOptions(), _MEMORY))
    outcome = worker.do(Describe(plan.names))
    assert isinstance(outcome, Described)
    for reason in outcome.bad.values():
        raise InputError(reason)
    return [outcome.features[name] for name in plan.names]


def recalls(batch: Batch, features: Sequence[np.ndarray], numbers: Sequence[int]) -> list[Recall]:
    """The recall of each K. features: of the images of the plan, in its order."""
    scores = similarities(features)
    position = {name: i for i, name in enumerate(batch.plan.names)}
    verified = {
        tuple(sorted((position[row.name1], position[row.name2])))
        for row in batch.rows
        if row.status in CONFIGURATIONS
    }
    count = len(features) * (len(features) - 1) // 2
    found = []
    for number in numbers:
        chosen = {*most_similar(scores, number)}
        found.append(Recall(number, len(chosen), count, len(verified), len(verified & chosen)))
    return found


def recall_table(found: Sequence[Recall]) -> str:
    """A line a K."""
    rows = [
        (
            f"auto:{one.number}",
            str(one.chosen),
            f"{100 * one.chosen / one.pairs:.1f}",
            str(one.verified),
            str(one.found),
            f"{100 * one.found / one.verified:.1f}" if one.verified else "-",
        )
        for one in found
    ]
    return aligned([("pairs", "chosen", "% of all", "verified", "of those", "recall %"), *rows])
