"""What a folder believes of its pairs: the probability that a pose is right, given all others.

Triples of pairs exchange messages, a loopy belief propagation (Pearl 1988): of three poses that
agree not one alone is wrong, and of three that do not agree at least one is.

Most folders show no place twice. Each is solved as such a one, in which pairs begin with their own
probabilities; and as one with repeats, in which they begin with what surrounds their matches and
what no other pair matches (`relations.py`), too, compared with the folder's. The solution holds
that explains the pairs better.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice

import numpy as np

from dgc_pose.batch.plan import Plan
from dgc_pose.batch.relations import Relation, own_cells, triples
from dgc_pose.batch.rows import LEAST_BELIEF, MatchedPair, PairRow
from dgc_pose.estimation.evidence import alikeness
from dgc_pose.estimation.status import CONFIGURATIONS

MOST_PAIRS = 2000  # with a pose, of a folder
_MOST = 0.999  # probability of a pair
_UNKNOWN = 0.9  # probability of a pose whose own is not known
_MOST_LOG_ODDS = 5.0
# Of a pair in a folder with repeats: for a unit of each of the values of `gathered`
_WEIGHTS, _INTERCEPT = np.array([0.228, 5.227, 0.689]), 0.391
_QUANTILE = 0.75  # of a folder's pairs, that each is compared with
# Log-odds, for each of its pairs, by which a folder is likelier without repeats: the least with
# which no posed folder of `fit-folders`, left out of the fit, is taken for one with repeats
_ORDINARY = 0.3
# Of three poses of which 0 to 3 are right, how likely they are to agree, and not to, each up to a
# factor
_AGREE, _DISAGREE = np.array([[0.8, 1.0, 0.02, 1.0], [0.8, 1.0, 1.0, 0.02]])
_FULL_TRIPLES = 4  # of a pair; of more each counts less, as they are not independent
_ROUNDS, _DAMPING = 60, 0.5
_MOST_SENT = 8.0  # log-odds


def believed(pairs: Iterable[MatchedPair], plan: Plan) -> list[PairRow]:
    """The rows of the pairs that have a pose or a rotation, with what the folder believes of them;
    none of more than `MOST_PAIRS` pairs."""
    rows, relations, values = gathered(pairs, plan, MOST_PAIRS + 1)
    if not 0 < len(rows) <= MOST_PAIRS:
        return []
    found, agree = triples(relations)
    solved = solutions(values[:, 0], by_itself(values), found, agree)
    log_odds = solved[shows_repeats(solved, values)]
    if log_odds is solved[0]:  # a pair in no triple has its own
        alone = ~np.isin(np.arange(len(rows)), found)
        own = [_UNKNOWN if r.probability is None else r.probability for r in rows]
        own_odds = _log_odds(np.clip(own, LEAST_BELIEF, _MOST))
        log_odds = np.where(alone, own_odds, log_odds)
    belief = np.round(1 / (1 + np.exp(-log_odds)), 4)
    counts = np.zeros((len(rows), 2), np.int64)  # of triples that agree, and that do not
    for k in range(3):
        pair, *others = np.roll(found, k, axis=1).T
        holds = (belief[others] >= LEAST_BELIEF).all(0)
        np.add.at(counts, (pair[holds], 1 - agree[holds].astype(np.int64)), 1)
    return [
        replace(row, folder_probability=value, folder_triples=(agreeing, differing))
        for row, value, (agreeing, differing) in zip(
            rows, belief.tolist(), counts.tolist(), strict=True
        )
    ]


def gathered(
    pairs: Iterable[MatchedPair], plan: Plan, most: int | None = None
) -> tuple[list[PairRow], list[Relation], np.ndarray]:
    """The rows and relations of pairs that have a pose or a rotation, the first `most` of them; and
    what by itself speaks for each, (n, 3): log-odds, surroundings and own cells, the latter two
    less the folder's; NaN of what is not known."""
    number = {name: k for k, name in enumerate(plan.names)}
    cameras, rows, relations = plan.final_cameras, list[PairRow](), list[Relation]()
    values = list[tuple[float, float]]()
    posed = (p for p in pairs if p.row.pose is not None and p.row.pose.status in CONFIGURATIONS)
    for pair in islice(posed, most):
        row, pose = pair.row, pair.row.pose
        assert pose is not None and pose.R is not None  # by its status
        name1, name2 = row.names
        of_pair = row.fitted_cameras or (cameras[name1], cameras[name2])
        relations.append(Relation.of(pair, (number[name1], number[name2]), of_pair))
        # What is claimed holds unless other pairs speak against it. Most rotations that are of an
        # unlikely pose are wrong.
        known = pose.one_place_probability if pose.success else pose.any_probability
        least = LEAST_BELIEF if pose.success else 1 - _MOST
        known = _UNKNOWN if known is None else min(max(known, least), _MOST)
        around = pair.matches.surroundings
        alike = math.nan if around is None else alikeness(around, pose.R)
        values.append((known, alike))
        rows.append(row)
    found = np.column_stack([np.array(values).reshape(-1, 2), own_cells(relations)])
    found[:, 0] = _log_odds(found[:, 0])
    for column in found.T[1:]:
        known_ones = column[np.isfinite(column)]
        column -= np.quantile(known_ones, _QUANTILE) if len(known_ones) else 0.0
    return rows, relations, found


def by_itself(
    values: np.ndarray, weights: np.ndarray = _WEIGHTS, intercept: float = _INTERCEPT
) -> np.ndarray:
    """Log-odds (n,) of pairs before the triples, by the values (n, 3) of `gathered`."""
    return (intercept + np.nan_to_num(values) @ weights).clip(-_MOST_LOG_ODDS, _MOST_LOG_ODDS)


def _log_odds(probability: np.ndarray) -> np.ndarray:
    return np.log(probability / (1 - probability))


def shows_repeats(solved: tuple[np.ndarray, np.ndarray, float], values: np.ndarray) -> bool:
    """Whether a folder is one with repeats, by its `solutions` and the values (n, 3) of `gathered`:
    not if what surrounds the matches is not known of half of the pairs."""
    known = np.isfinite(values[:, 1]).mean() > 0.5
    return bool(known and solved[2] > _ORDINARY * len(values))


def solutions(
    probable: np.ndarray, with_repeats: np.ndarray, found: np.ndarray, agree: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Log-odds (n,) of pairs in a folder without repeats and in one with repeats, and by how much
    the latter explain the pairs better, log-odds.

    probable: of their probabilities (n,); with_repeats: of `by_itself` (n,); found: triples (M, 3);
    agree: whether these do (M,).
    """
    count = np.bincount(found.ravel(), minlength=len(probable))
    weight = np.minimum(1, _FULL_TRIPLES / np.maximum(count, 1))
    likely, solved = np.where(agree[:, None], _AGREE, _DISAGREE), []
    for before in (probable.clip(-_MOST_LOG_ODDS, _MOST_LOG_ODDS), with_repeats):
        after = _after_messages(before, found, likely, weight)
        right = after > 0
        of_triples = np.log(likely[np.arange(len(found)), right[found].sum(1)])
        solved.append((after, weight[found].mean(1) @ of_triples - before[~right].sum()))
    (ordinary, explained), (repeating, with_them) = solved
    return ordinary, repeating, float(with_them - explained)


def _after_messages(
    before: np.ndarray, found: np.ndarray, likely: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """The log-odds (n,) that the triples' messages make of those before. likely: (M, 4), of 0 to 3
    right poses of a triple; weight: (n,), of the messages to a pair."""

    def total(messages: np.ndarray) -> np.ndarray:
        sums = np.bincount(found.ravel(), messages.ravel(), minlength=len(before))
        return before + weight * sums

    messages = np.zeros(found.shape)
    for _ in range(_ROUNDS):
        sent = total(messages)[found] - weight[found] * messages
        right = 1 / (1 + np.exp(-sent.clip(-_MOST_SENT, _MOST_SENT)))
        new = np.empty_like(messages)
        for k in range(3):
            a, b = right[:, k - 1], right[:, k - 2]
            others = np.stack([(1 - a) * (1 - b), a + b - 2 * a * b, a * b], 1)  # 0 to 2 are right
            new[:, k] = np.log((likely[:, 1:] * others).sum(1) / (likely[:, :3] * others).sum(1))
        messages = _DAMPING * messages + (1 - _DAMPING) * new
    return total(messages)
