"""Whether the camera did not move: image 2 is image 1 turned, zoomed or cropped.

A camera that only turned gives an essential matrix with any translation, and the more so if its
focal length or its lens is a little wrong. So these are fitted together with the rotation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from dgc_pose.estimation.evidence import robust_rotation
from dgc_pose.estimation.intrinsics_prior import (
    SIZE,
    IntrinsicsPrior,
    renormalised_pair,
    renormalised_slopes,
)
from dgc_pose.estimation.least_squares import (
    KEPT,
    Slopes,
    block_jackknife,
    cauchy_slopes,
    loss_terms,
    loss_width,
    match_variance,
    minimised,
    prior_information,
)
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import TRANSFER_LIMIT, draw
from dgc_pose.geometry.epipolar import homogeneous, skew
from dgc_pose.geometry.homography import fit_homography, fit_similarity, transfer_error

_LOG_FOCAL_REACH = 1.5  # ln f of camera 1 is tried so far to either side
_LOG_FOCAL_STEP = 0.3  # the first step
_MIN_LOG_FOCAL_STEP = 0.005  # the last step
_SAMPLED = 300  # matches of the fit of a turn
# Largest errors in each round of the fit of a turn, over the limit; and the share of the sample
# that must be within each of them, and the least number.
_LIMITS = (20.0, 5.0, 1.0, 1.0)
_MIN_SHARE = 0.2
_MIN_COUNT = 10
_ITERATIONS = 10  # of a round
_RAYLEIGH = 1.1774 * 1.4826  # median length of Gaussian errors along two axes, over that along one
_TURN = 2  # the place of the turn among the homographies of a camera that did not move


@dataclass(frozen=True, eq=False)
class StillCamera:
    """The motion without a translation that explains most matches."""

    R: np.ndarray  # (3, 3)
    count: int  # of the matches that it explains
    covariance: np.ndarray | None = None  # (3, 3) of the rotation vector, rad^2; None if not known
    is_turn: bool = True  # not a zoom or a crop


@dataclass(frozen=True, eq=False)
class _Turn:
    """A rotation, and how far the cameras are from those that normalised the matches."""

    R: np.ndarray  # (3, 3)
    z: np.ndarray  # (M,) parameters in the basis of an `IntrinsicsPrior`, standard deviations


@dataclass(frozen=True, eq=False)
class _TurnFit:
    """Least squares of a rotation and of cameras."""

    problem: TwoViewProblem
    prior: IntrinsicsPrior
    width: float = math.inf  # of the losses, in the problem's unit; of matches that are fitted

    def linearised(self, turn: _Turn) -> Slopes:
        """The losses of all matches and the prior, by the turn and the parameters (3 + M,)."""
        return cauchy_slopes(*self.errors_and_slopes(turn), self.width).with_prior(turn.z)

    def moved(self, turn: _Turn, step: np.ndarray) -> _Turn:
        """The turn after a step (3 + M,)."""
        return _Turn(cv2.Rodrigues(step[:3])[0] @ turn.R, turn.z + step[3:])

    def distances(self, turn: _Turn) -> np.ndarray:
        """The lengths (N,) of the errors; infinite beyond the horizon."""
        return _lengths(self._errors(turn, *self._seen(turn)))

    def errors_and_slopes(self, turn: _Turn) -> tuple[np.ndarray, np.ndarray]:
        """Transfer errors (N, 2) in image 2, in the problem's unit, and their derivatives
        (N, 2, 3 + M), which are finite where the errors are."""
        points1, points2, turned = self._seen(turn)
        error = self._errors(turn, points1, points2, turned)
        parameters = self.prior.basis @ turn.z
        lens1, lens2 = self.problem.lenses
        by_turned = np.zeros((len(turned), 2, 3))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            by_turned[:, [0, 1], [0, 1]] = 1 / turned[:, 2:]
            by_turned[:, :, 2] = -turned[:, :2] / turned[:, 2:] ** 2
            by_rotation = np.stack([turned @ skew(axis).T for axis in np.eye(3)], axis=2)
            by_camera1 = renormalised_slopes(
                self.problem.points1, lens1, parameters[:SIZE], points1
            )
            by_camera2 = renormalised_slopes(
                self.problem.points2, lens2, parameters[SIZE:], points2
            )
            by_cameras = np.concatenate([by_turned @ turn.R[:, :2] @ by_camera1, -by_camera2], 2)
            by_cameras[:, :, SIZE] += turned[:, :2] / turned[:, 2:] - points2  # of the unit
            slopes = np.concatenate([by_turned @ by_rotation, by_cameras @ self.prior.basis], 2)
        return error, slopes * np.exp(parameters[SIZE])

    def _seen(self, turn: _Turn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The points (N, 2) of both images by the cameras of a turn, and those of image 1 turned,
        (N, 3)."""
        points1, points2 = renormalised_pair(self.problem, self.prior.basis @ turn.z)
        return points1, points2, homogeneous(points1) @ turn.R.T

    def _errors(
        self, turn: _Turn, points1: np.ndarray, points2: np.ndarray, turned: np.ndarray
    ) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            error = turned[:, :2] / turned[:, 2:] - points2
        error = np.where(turned[:, 2:] > 0, error, np.inf)
        return np.nan_to_num(error * np.exp((self.prior.basis @ turn.z)[SIZE]), nan=np.inf)

    def covariance(self, turn: _Turn) -> np.ndarray | None:
        """The covariance (3, 3) of the rotation vector, as of a pose (`covariance`)."""
        error, slopes = self.errors_and_slopes(turn)
        error = error.ravel()
        slopes = slopes.reshape(len(error), -1)
        count = slopes.shape[1]
        variance = match_variance(self.width)
        information = variance * prior_information(count, np.ones(len(turn.z)))
        terms = loss_terms(error, slopes, self.width)
        total = information + terms[:, : count**2].sum(0).reshape(count, count)
        points = np.repeat(self.problem.points2, 2, axis=0)
        try:
            covariance = block_jackknife(total, terms, points, KEPT)
            covariance += variance * np.linalg.inv(total)
        except np.linalg.LinAlgError:
            return None
        return covariance[:3, :3] if np.isfinite(covariance).all() else None


def _lengths(errors: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.hypot(*errors.T)


def turned_camera(stated: TwoViewProblem) -> StillCamera:
    """The turn that explains most matches, with cameras that deviate from those that normalise them
    by their standard deviations. Ends early if few matches fit a turn."""
    prior = IntrinsicsPrior.of(*stated.cameras)
    limit = TRANSFER_LIMIT * stated.threshold
    sample = draw(stated, stated.options.seed, _SAMPLED)
    turn = _Turn(robust_rotation(sample), np.zeros(len(prior)))
    fit = _TurnFit(sample, prior)
    for widest in _LIMITS:
        distance = fit.distances(turn)
        near = distance < widest * limit
        if near.sum() < max(_MIN_SHARE * len(sample), _MIN_COUNT):
            return StillCamera(turn.R, 0)
        width = loss_width(distance[near], widest * limit)
        turn = minimised(_TurnFit(sample.subset(near), prior, width), turn, _ITERATIONS)
    whole = _TurnFit(stated, prior)
    distance = whole.distances(turn)
    near = distance < limit
    if not near.any():
        return StillCamera(turn.R, 0)
    width = loss_width(distance[near] / _RAYLEIGH, limit)
    explained = _TurnFit(stated.subset(near), prior, width)
    return StillCamera(turn.R, int(near.sum()), explained.covariance(turn))


def zoomed_camera(inliers: TwoViewProblem) -> StillCamera:
    """The motion without a translation that explains most inliers, for cameras without a K.

    Either image 2 is image 1 scaled, rolled and shifted; or the camera rotated about its centre,
    with a focal length for each image. inliers: normalised by the stated cameras, whose principal
    points no fit has moved.
    """
    points = (inliers.points1, inliers.points2)
    limit = TRANSFER_LIMIT * inliers.threshold
    homographies = [(np.eye(3), np.eye(3))] * 2
    similarity = fit_similarity(*points, limit)
    if similarity is not None:
        roll = similarity / np.hypot(*similarity[:2, 0])
        roll[:, 2] = 0, 0, 1
        homographies[1] = similarity, roll
    H = fit_homography(*points, limit, inliers.options.seed)
    if H is not None:
        step = _LOG_FOCAL_STEP
        tried = np.arange(-_LOG_FOCAL_REACH, _LOG_FOCAL_REACH + step / 2, step)
        turns = {k: _turn(H, k) for k in tried}
        while True:
            best = min(turns, key=lambda k: np.median(transfer_error(*points, turns[k][0])))
            if step < _MIN_LOG_FOCAL_STEP:
                break
            step /= 2
            turns = {k: _turn(H, k) for k in (best, best - step, best + step)}
        homographies.append(turns[best])
    counts = [int((transfer_error(*points, H) < limit).sum()) for H, _ in homographies]
    best = int(np.argmax(counts))
    return StillCamera(homographies[best][1], counts[best], is_turn=best == _TURN)


def _turn(H: np.ndarray, log_focal: float) -> tuple[np.ndarray, np.ndarray]:
    """The homography (3, 3) near H of a camera that only rotates, and its rotation. log_focal: of
    image 1, whose points have focal length 1; the focal length of image 2 follows from H."""
    D1 = np.diag([np.exp(log_focal), np.exp(log_focal), 1.0])
    rows = H @ D1
    lengths = np.linalg.norm(rows, axis=1)
    focal2 = lengths[:2].mean() / lengths[2]
    D2 = np.diag([focal2, focal2, 1.0])
    U, _, Vt = np.linalg.svd(np.linalg.solve(D2, rows))
    R = U @ Vt
    R *= np.linalg.det(R)  # the sign of H is arbitrary
    return D2 @ R @ np.linalg.inv(D1), R
