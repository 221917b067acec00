"""The Cauchy loss of robust least squares, its minimum, and the covariance by the jackknife.

Errors of dense matches are correlated: neighbours lie on the same misplaced surface, so a thousand
of them carry little more information than a few. The usual covariance assumes that all matches are
independent and is several times too small. The jackknife leaves out one block of an image after the
other (delete-a-group, Kott 2001), so that correlated errors are left out together.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

Fit = TypeVar("Fit")
DEVIATION = 1.4826  # standard deviation of Gaussian noise, over the median of its magnitude
EFFICIENT = 2.385  # width of the Cauchy loss of 95 % efficiency on Gaussian noise, in deviations
# Errors of neighbouring matches are correlated: this many count as one independent match against
# a prior. See docs/experiments.md.
CORRELATED = 10.0
BLOCKS = 3  # along the longer side of the inliers in image 2; see docs/experiments.md
_SHIFTS = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))  # of the blocks, in blocks
# Share of the whole information that stays when a block is left out: for a dense map, as a block
# may have nearly all of it (docs/experiments.md); and otherwise, to keep the rest regular.
KEPT = 0.1
REGULAR = 1e-9
_CONVERGED = 1e-5  # promised gain of a step over 1 + cost, up to which it is the last one
_DAMPING = 1e-4  # of the first step
_LEAST_DAMPING = 1e-9
_MOST_DAMPING = 1e6
_MIN_WIDTH = 0.02  # of the threshold: matches count as no more accurate than this


def loss_width(error: np.ndarray, threshold: float) -> float:
    """Width of the Cauchy loss for the errors (N,) of inliers, in their unit.

    From the median error, as if the errors were Gaussian; at most the threshold.
    """
    width = EFFICIENT * DEVIATION * float(np.median(np.abs(error)))
    return min(max(width, _MIN_WIDTH * threshold), threshold)


def cauchy_losses(error: np.ndarray, width: float) -> np.ndarray:
    """Minus the log-likelihoods (N,) of errors with a Cauchy distribution of this width, up to a
    constant, divided by `CORRELATED`."""
    with np.errstate(over="ignore"):
        losses: np.ndarray = EFFICIENT**2 / CORRELATED / 2 * np.log1p((error / width) ** 2)
    return losses


def match_variance(width: float) -> float:
    """The variance that an accurate match has against a prior, for a Cauchy loss of this width."""
    return CORRELATED * (width / EFFICIENT) ** 2


def cauchy_weights(error: np.ndarray, width: float) -> np.ndarray:
    """The weights (N,) with which the squares of errors have the slopes of their Cauchy losses."""
    weights: np.ndarray = 1 / (match_variance(width) * (1 + (error / width) ** 2))
    return weights


def cauchy_curvature(error: np.ndarray, width: float | np.ndarray) -> np.ndarray:
    """The second derivatives (N,) of the Cauchy losses of errors, over that of error 0. Beyond the
    inflection they are negative and count as 0: a match must not be negative evidence."""
    squared = (error / width) ** 2
    curvature: np.ndarray = np.maximum(1 - squared, 0) / (1 + squared) ** 2
    return curvature


def loss_terms(error: np.ndarray, slopes: np.ndarray, width: float) -> np.ndarray:
    """The information and the gradients, (N, P * P + P), of the Cauchy loss of errors (N,) with
    derivatives (N, P), relative to the information of plain squares."""
    gradients = slopes * (error / (1 + (error / width) ** 2))[:, None]
    weighted = slopes * cauchy_curvature(error, width)[:, None]
    information = weighted[:, :, None] * slopes[:, None]
    return np.column_stack([information.reshape(len(error), -1), gradients])


class Slopes(NamedTuple):
    """The cost of a fit, and its derivatives by the P parameters of a step."""

    cost: float
    hessian: np.ndarray  # (P, P)
    gradient: np.ndarray  # (P,)

    def with_prior(self, values: np.ndarray, information: float | np.ndarray = 1.0) -> Slopes:
        """With the prior of the last parameters: how far these are from what is expected, (M,), is
        normally distributed with this information, by default with standard deviation 1."""
        weighted = information * values
        gradient = self.gradient.copy()
        gradient[len(gradient) - len(values) :] += weighted
        prior = prior_information(len(gradient), information * np.ones(len(values)))
        return Slopes(self.cost + float(values @ weighted) / 2, self.hessian + prior, gradient)

    def step(self, damping: float) -> np.ndarray:
        """The step (P,) to the least cost, shortened by a damping, which is relative to the
        Hessian's diagonal. With 0, the shortest such step. Raises LinAlgError."""
        if damping == 0:
            shortest: np.ndarray = np.linalg.lstsq(self.hessian, -self.gradient, rcond=None)[0]
            return shortest
        damped = self.hessian + damping * np.diag(np.diag(self.hessian))
        step: np.ndarray = np.linalg.solve(damped, -self.gradient)
        return step


def prior_information(count: int, last: np.ndarray) -> np.ndarray:
    """The information (P, P) of a prior of the last of `count` parameters, theirs being (M,)."""
    return np.diag([*np.zeros(count - len(last)), *last])


def cauchy_slopes(
    error: np.ndarray,
    slopes: np.ndarray,
    width: float,
    counts: float | np.ndarray = 1.0,
) -> Slopes:
    """The sum of the Cauchy losses of errors (N,), or of the lengths of errors (N, K), with their
    derivatives (N, P) or (N, K, P); the Hessian is that of reweighted squares. counts: factors (N,)
    of the losses."""
    length = np.sqrt(np.square(error).sum(1)) if error.ndim > 1 else error
    cost = float((counts * cauchy_losses(length, width)).sum())
    number = slopes.shape[-1]
    if not math.isfinite(cost):  # of a step that is refused
        return Slopes(cost, np.eye(number), np.zeros(number))
    weights = counts * cauchy_weights(length, width)
    weighted = (slopes.T * weights).T.reshape(-1, number).T
    return Slopes(cost, weighted @ slopes.reshape(-1, number), weighted @ error.ravel())


class Problem(Protocol[Fit]):
    """Least squares: what is minimised, and how a fit changes by a step of its P parameters."""

    def linearised(self, fit: Fit) -> Slopes:
        """The cost of a fit and its derivatives."""

    def moved(self, fit: Fit, step: np.ndarray) -> Fit:
        """The fit after a step (P,)."""


def minimised(
    problem: Problem[Fit],
    start: Fit,
    iterations: int,
    *,
    descends: bool = True,
    converged: float = _CONVERGED,
) -> Fit:
    """The fit of least cost near a start (Marquardt 1963).

    iterations: the most steps. descends: whether a step must lower the cost; not where each fit
    has errors of its own, so that the costs of two do not compare: its steps are not damped.
    converged: the gain that a step promises, over 1 + the cost, up to which it is the last one.
    """
    fit = start
    slopes = problem.linearised(fit)
    damping = _DAMPING if descends else 0.0
    for _ in range(iterations):
        try:
            step = slopes.step(damping)
            is_last = -slopes.gradient @ step / 2 <= converged * (1 + slopes.cost)
            candidate = problem.moved(fit, step)
            found = problem.linearised(candidate)
            while descends and not found.cost < slopes.cost:
                damping *= 10
                if is_last or damping >= _MOST_DAMPING:
                    return fit
                candidate = problem.moved(fit, slopes.step(damping))
                found = problem.linearised(candidate)
        except np.linalg.LinAlgError:  # a parameter that the errors do not depend on
            break
        fit = candidate
        slopes = found
        if is_last:
            break
        if descends:
            damping = max(damping / 10, _LEAST_DAMPING)
    return fit


def jackknife(total: np.ndarray, sums: np.ndarray, kept: float = REGULAR) -> np.ndarray:
    """The covariance (P, P) of P parameters by leaving out one group after the other.

    total: their information (P, P), with that of any prior. sums: (G, P * P + P), the information
    of each group and the gradient of its loss. kept: share of `total` that is added to the other
    groups. Raises LinAlgError if these do not determine the parameters.
    """
    count = len(total)
    groups = len(sums)
    left_out = sums[:, : count**2].reshape(-1, count, count)
    gradient = sums[:, count**2 :, None]
    moves = np.linalg.solve((1 + kept) * total - left_out, gradient)[:, :, 0]
    covariance: np.ndarray = (groups - 1) / groups * moves.T @ moves
    return covariance


def block_jackknife(
    total: np.ndarray, terms: np.ndarray, points: np.ndarray, kept: float
) -> np.ndarray:
    """The covariance (P, P) by leaving out blocks of points (N, 2), averaged over shifts of the
    blocks. terms: (N, P * P + P), from `loss_terms`; see `jackknife` for the others."""
    shifted = [jackknife(total, block_sums(terms, points, shift), kept) for shift in _SHIFTS]
    covariance: np.ndarray = np.mean(shifted, axis=0)
    return covariance


def block_sums(terms: np.ndarray, points: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    """Sums (B, M) of terms (N, M) over square blocks of points (N, 2), without empty blocks.

    Uses no matrix product: the order of its sums depends on the number of threads.
    """
    low = points.min(0)
    high = points.max(0)
    # Slightly more than the span, or the farthest point would be alone in a block.
    side = max((1 + 1e-9) * float((high - low).max()), np.finfo(float).tiny) / BLOCKS
    column, row = np.floor((points - low) / side + shift).astype(int).T
    block = column + (BLOCKS + 1) * row
    order = np.argsort(block, kind="stable")
    return np.add.reduceat(terms[order], np.unique(block[order], return_index=True)[1])
