"""The Cauchy loss of robust least squares, its minimum, and the covariance by the jackknife.

Errors of dense matches are correlated: neighbours lie on the same misplaced surface, so a thousand
of them carry little more information than a few. The usual covariance assumes that all matches are
independent and is several times too small. The jackknife leaves out one block of an image after the
other (delete-a-group, Kott 2001), so that correlated errors are left out together.
"""

from collections.abc import Callable
from typing import TypeVar

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
_CONVERGED = 1e-5  # relative change of the cost
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


def levenberg_marquardt(
    start: Fit,
    linearised: Callable[[Fit], tuple[float, np.ndarray, np.ndarray]],
    moved: Callable[[Fit, np.ndarray], Fit],
    iterations: int,
) -> Fit:
    """The fit of least cost (Marquardt 1963).

    linearised: the cost of a fit, its Hessian (P, P) and its gradient (P,). moved: the fit after a
    step (P,).
    """
    fit = start
    damping = 1e-4
    cost, hessian, gradient = linearised(fit)
    for _ in range(iterations):
        before = cost
        while damping < _MOST_DAMPING:
            damped = hessian + damping * np.diag(np.diag(hessian))
            try:
                candidate = moved(fit, np.linalg.solve(damped, -gradient))
            except np.linalg.LinAlgError:  # a parameter that the errors do not depend on
                return fit
            found = linearised(candidate)
            if found[0] < before:
                fit = candidate
                cost, hessian, gradient = found
                damping = max(damping / 10, _LEAST_DAMPING)
                break
            damping *= 10
        if before - cost <= _CONVERGED * (1 + before):
            break
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
