"""The cameras of a folder: which photographs share a camera, and its parameters from all pairs.

Each pair has fitted the focal lengths, principal points and lenses of its own cameras, with a
prior. Photographs with the same `identity` share a camera, and the fits of their pairs are pooled:
robustly, weighted by their covariances, with the prior counted once instead of once per pair.
Dozens of pairs determine the principal point, which one pair hardly does.

Some photographs have a camera of their own: the only photograph of an identity, and one whose pairs
within its identity mostly contradict the shared camera. This camera is fitted to pairs with
photographs of known cameras, since one unknown camera is determined far better than two.
"""

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.batch.pairs import MatchedPair, PairRow
from dgc_pose.batch.workers import Cameras, PoseRunner
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import OTHER_STD, SHARED
from dgc_pose.estimation.camera_model import ModelName, model_named, with_model
from dgc_pose.estimation.intrinsics_prior import SIZE, may_be_crop, parameter_stds, with_parameters
from dgc_pose.estimation.least_squares import (
    CORRELATED,
    EFFICIENT,
    Slopes,
    cauchy_losses,
    cauchy_slopes,
    cauchy_weights,
    minimised,
)

_STARTS = 101
_STEPS = 50
_CONVERGED = 1e-12  # promised gain of a step over 1 + loss, up to which it is the last one
_MAX_STD_SHARE = 0.9  # of the prior's deviation of ln f: pairs with a wider fit are skipped
_FAR_CENTRE_STDS = 1.5  # deviations: a principal point that moved further is far from its prior
_MIN_VARIANCE = 1e-9  # as a share of the prior's: keeps the information finite
_ALONE = "its pairs agree with no other camera"
_SPLIT = "most pairs of its size fit a separate focal length for each photograph"
_MIN_GROUP = 3  # fewest images of a camera that one of them can contradict
_MIN_INLIERS = 50  # of a pair that should determine its cameras
_AGREEING_SHARE = 0.5  # of these pairs; below it, a photograph gets an individual camera
_AGREEING_STDS = 3.0  # limit for ln f of a pair and its group
_SAME_STDS = 2.0  # limit for ln f of two cameras
_SAME_FOCAL = 0.01  # deviation of ln f of one camera between photographs, by focusing
_PARTNER_FOCAL_STD = 0.15  # of ln f, below which a camera helps to determine another
_MOST_FOCAL_STD = 0.1  # of ln f, below which an individual camera is accepted
_CENTRE_OF_PART = 0.1  # deviation of the principal point of a possible crop, over the longer side


@dataclass(frozen=True)
class PooledCamera:
    """One camera of a folder."""

    cameras: Cameras  # for each of its images
    pairs: int  # number of pairs whose fits are pooled
    why: str = ""  # why these images have it; empty if by their sizes and EXIF data or a given K


def folder_cameras(poses: PoseRunner, cameras: Cameras) -> list[PooledCamera]:
    """The cameras of the folder, without those that were exact before.

    poses: its store holds the matched pairs, each with its own fit of `cameras`.
    """
    rows = _rows_of(poses.store.pairs("matched"))
    start = _by_models(cameras, rows)
    known = {**start, **by_image(pool(start, rows, inside=start))}
    if start != cameras or centre_moved(start, known):
        start = {name: replace(camera, K=known[name].K) for name, camera in start.items()}
        rows = _rows_of(poses.estimate(start, fit=True))
        known = {**start, **by_image(pool(start, rows, inside=start))}
    groups = sharing(start)
    certain = set[str]()
    apart = set[str]()
    for name, camera in known.items():
        is_alone = name in groups and len(groups[name]) == 1
        if is_alone or camera.focal_std >= _PARTNER_FOCAL_STD:
            continue
        may_differ = start[name].focal_source != "given" and start[name].identity != SHARED
        if may_differ and name in groups and _is_contradicted(name, groups[name], camera, rows):
            apart.add(name)
        else:
            certain.add(name)

    loose = apart | {name for name, names in groups.items() if len(names) == 1}
    own = dict[str, Camera]()
    some = set[int]()
    for row in rows:
        if loose & {*row.names} and certain & {*row.names}:
            some.add(row.index)
            for name in row.names:
                if name in loose:
                    own[name] = _individual_camera(start[name], doubted=name in apart)
    refitted = _rows_of(poses.estimate({**known, **own}, fit=True, only=some))
    exact = {name: camera.as_exact() for name, camera in known.items()}
    found = pool({**exact, **own}, refitted)
    unshared = set[str]()
    for name, fit in by_image(found).items():
        differs = (
            not _agrees(fit, known[name]) if name in apart else fit.focal_std < _MOST_FOCAL_STD
        )
        if differs:
            unshared.add(name)

    members = {name: camera for name, camera in start.items() if name not in unshared}
    kept = [row for row in rows if not unshared & {*row.names}]
    split = set[str]()
    for name, camera in members.items():
        if cameras[name].identity and camera.identity is None:
            split.add(name)
    pooled = []
    for shared in pool(members, kept, inside=certain):
        is_split = bool(split & shared.cameras.keys())
        pooled.append(replace(shared, why=_SPLIT) if is_split else shared)
    for alone in found:
        if unshared & alone.cameras.keys():
            pooled.append(replace(alone, why=_ALONE))
    return pooled


def _rows_of(pairs: Iterable[MatchedPair]) -> list[PairRow]:
    return sorted((pair.row for pair in pairs), key=lambda row: row.index)


def _by_models(cameras: Cameras, rows: Sequence[PairRow]) -> Cameras:
    """The cameras before the fit, each with the model that most of its pairs agree with."""
    groups = sharing(cameras)
    weights: dict[str, dict[ModelName, float]] = defaultdict(lambda: defaultdict(float))
    for row in rows:
        for name in {groups[n][0] for n in row.names if n in groups and row.success}:
            known = None if row.pose is None else row.pose.one_place_probability
            weights[name][row.camera_model] += 1.0 if known is None else known
    changed = dict(cameras)
    for name, names in groups.items():
        own = weights[names[0]]
        for model, weight in own.items():
            is_most = weight > sum(own.values()) / 2
            if is_most and not model_named(model).contradicts_K:
                changed[name] = with_model(cameras[name], model)
    return changed


def _is_contradicted(
    name: str, names: Sequence[str], camera: Camera, rows: Sequence[PairRow]
) -> bool:
    """Whether fewer than half of the pairs of an image within its group agree with `camera`, the
    group's. Only pairs that should determine a camera count."""
    agreeing = 0
    count = 0
    for row in rows:
        if name in row.names and {*row.names} <= {*names}:
            if row.status == "mirrored":  # a wrong camera may be the cause
                count += row.num_matches >= _MIN_INLIERS
            elif row.status not in ("rotation_only", "same_picture"):
                count += row.num_inliers >= _MIN_INLIERS
            if (fitted := fit_of(row)) is not None:
                agreeing += _same_focal(fitted[row.names.index(name)], camera, _AGREEING_STDS)
    return len(names) >= _MIN_GROUP and agreeing < _AGREEING_SHARE * count


def _agrees(camera: Camera, other: Camera) -> bool:
    """Whether an individually fitted camera agrees with `other`, the camera of its group."""
    shift = float(np.abs(camera.K[:2, 2] - other.K[:2, 2]).max())
    near = shift < _AGREEING_STDS * math.hypot(camera.centre_std, other.centre_std)
    return near and _same_focal(camera, other, _SAME_STDS)


def _same_focal(camera: Camera, other: Camera, stds: float) -> bool:
    off = abs(math.log(camera.focal / other.focal))
    return off < stds * math.hypot(camera.focal_std, other.focal_std, _SAME_FOCAL)


def _individual_camera(camera: Camera, *, doubted: bool) -> Camera:
    """The prior camera of one photograph. It allows for zoom and cropping, unless EXIF data or a K
    state the focal length and no pair contradicts it."""
    camera = replace(camera, identity=None)
    stated = camera.focal_source in ("exif", "given") and camera.focal_std < OTHER_STD
    if stated and not doubted:
        return camera
    centre_std = _CENTRE_OF_PART * max(camera.size or (0,))
    return replace(camera, focal_std=OTHER_STD, centre_std=centre_std)


def fit_of(row: PairRow) -> tuple[Camera, Camera] | None:
    """The cameras that a pair fitted; None without a pose or with another camera model."""
    return row.fitted_cameras if row.success and row.camera_model == "assumed" else None


def sharing(cameras: Cameras) -> dict[str, tuple[str, ...]]:
    """By image name, the images that share its camera; only for cameras with a deviation."""
    groups: dict[tuple[bool, str], list[str]] = defaultdict(list)
    for name, camera in cameras.items():
        if not camera.exact:
            groups[camera.identity is None, camera.identity or name].append(name)
    return {name: tuple(names) for names in groups.values() for name in names}


def by_image(pooled: Iterable[PooledCamera]) -> dict[str, Camera]:
    """The cameras by image name."""
    return {name: camera for one in pooled for name, camera in one.cameras.items()}


def pool(
    cameras: Cameras, rows: Iterable[PairRow], inside: Collection[str] = ()
) -> list[PooledCamera]:
    """The cameras with a deviation, each pooled from the fits of all of its pairs.

    cameras: by name, as they were before the pairs fitted them. inside: images that skip the fits
    of pairs with another camera, unless each of the two cameras took a single image. Images of
    several sizes, and possible crops without EXIF data, share a focal length but no principal
    point. The order of the rows does not matter.
    """
    shared = sharing(cameras)
    # By the images of a camera, for each pair: difference from the camera's parameters, covariance,
    # and probability that the pose is right.
    fits: dict[tuple[str, ...], list[tuple[np.ndarray, np.ndarray, float]]] = defaultdict(list)
    for row in rows:
        pose = row.pose
        fitted = fit_of(row)
        if fitted is None or pose is None or pose.camera_covariance is None:
            continue
        first, second = (shared.get(name, (name,)) for name in row.names)
        between = first != second and max(len(first), len(second)) > 1
        known = pose.one_place_probability
        blocks = pose.camera_covariance[:SIZE, :SIZE], pose.camera_covariance[SIZE:, SIZE:]
        by_camera = {}  # a single entry if one camera took both images
        for name, camera, block in zip(row.names, fitted, blocks, strict=True):
            if name in shared and not (between and name in inside):
                value = _parameters(camera) - _parameters(cameras[name])
                by_camera[shared[name]] = value, block, 1.0 if known is None else known
        for names, fit in by_camera.items():
            fits[names].append(fit)
    pooled = []
    for names in dict.fromkeys(shared.values()):
        first_camera = cameras[names[0]]
        focal = first_camera.focal
        prior = np.array(parameter_stds(first_camera)) * ([1, focal, focal, 1, 1, 1])
        cut = first_camera.focal_source in ("size", "lines") and may_be_crop(first_camera)
        if (cut and len(names) > 1) or len({cameras[name].size for name in names}) > 1:
            prior[1:3] = 0
        open_ = np.flatnonzero(prior)  # the fitted parameters
        if not len(open_):
            continue
        widest = (_MAX_STD_SHARE * prior[open_[0]]) ** 2
        useful = [
            (value[open_], covariance[np.ix_(open_, open_)], weight)
            for value, covariance, weight in fits[names]
            if covariance.diagonal()[open_[0]] < widest and weight > 0
        ]
        value = np.zeros(SIZE)
        std = np.zeros(SIZE)
        std[open_] = prior[open_]
        if useful:
            values, covariances, weights = map(np.array, zip(*useful, strict=True))
            fitted_value, fitted_std = pooled_fit(
                values, covariances, weights, prior[open_], len(names)
            )
            value[open_] = fitted_value
            std[open_] = fitted_std
        members = {name: _pooled(cameras[name], value, std, bool(useful)) for name in names}
        pooled.append(PooledCamera(members, len(useful)))
    return pooled


def centre_moved(before: Cameras, after: Cameras) -> bool:
    """Whether a pooled principal point is far from its prior. Fits with that prior are then
    inaccurate, and should be repeated around the pooled camera."""
    return any(
        np.abs(after[name].K[:2, 2] - camera.K[:2, 2]).max() > _FAR_CENTRE_STDS * camera.centre_std
        for name, camera in before.items()
        if not camera.exact
    )


def pooled_fit(
    values: np.ndarray, covariances: np.ndarray, weight: np.ndarray, prior: np.ndarray, images: int
) -> tuple[np.ndarray, np.ndarray]:
    """The pooled parameters (D,), as differences from the prior's, and their deviations (D,).

    values, covariances: (N, D) and (N, D, D), the fits of pairs, each including the prior of
    deviations `prior` (D,). weight: (N,). images: number of images of the camera. Fits of pairs
    that share an image have correlated errors: they count as at most images / 2 pairs. Fits that
    scatter more than their covariances widen the result.
    """
    order = np.lexsort(values.T[::-1])  # the same sums for any order
    # In units of the prior's deviations: its information is then 1 along each axis.
    scaled = values[order] / prior
    fits = _PairFits(scaled, covariances[order] / np.outer(prior, prior), weight[order])
    # Start at the fit that most pairs agree with: a few very precise fits may be wrong.
    start = min(scaled[:: 1 + len(values) // _STARTS], key=fits.cost)
    middle = minimised(fits, start, _STEPS, converged=_CONVERGED)
    alike = min(max(1.0, 2 * len(values) / images), len(values))
    information = fits.slopes(middle).hessian / (fits.scatter(middle) * alike)
    covariance = np.linalg.inv(information + np.eye(len(prior)))
    return middle * prior, np.sqrt(np.diag(covariance)) * prior


class _PairFits:
    """Least squares of the parameters (D,) of a camera on the fits of N pairs, in deviations of the
    prior. values, covariances, weights: (N, D), (N, D, D) and (N,), see `pooled_fit`."""

    def __init__(self, values: np.ndarray, covariances: np.ndarray, weights: np.ndarray) -> None:
        variances, axes = np.linalg.eigh(covariances)
        information = 1 / np.maximum(variances, _MIN_VARIANCE)
        by_matches = np.maximum(information - 1, 0)  # along the axes, without the prior
        along = np.einsum("nij,ni->nj", axes, values) * information * (by_matches > 0)
        self._means = np.einsum("nij,nj->ni", axes, along / np.maximum(by_matches, 1e-9))
        count = values.shape[1]
        self._rows = np.sqrt(by_matches / count)[:, :, None] * axes.transpose(0, 2, 1)
        self._weights = weights
        self._counts = CORRELATED * count * weights

    def _errors(self, middle: np.ndarray) -> np.ndarray:
        """(N, D), whose squares are those of the distances over the number of parameters."""
        errors: np.ndarray = np.einsum("nij,nj->ni", self._rows, middle - self._means)
        return errors

    def cost(self, middle: np.ndarray) -> float:
        """The loss of the fits, up to a factor."""
        distances = np.linalg.norm(self._errors(middle), axis=1)
        return float(self._weights @ cauchy_losses(distances, EFFICIENT))

    def scatter(self, middle: np.ndarray) -> float:
        """The mean square of the errors over their variance; at least 1."""
        squared = np.square(self._errors(middle)).sum(1)
        weights = self._weights * cauchy_weights(np.sqrt(squared), EFFICIENT)
        return max(1.0, float(np.average(squared, weights=weights)))

    def slopes(self, middle: np.ndarray) -> Slopes:
        """The loss of the fits by the parameters, without the prior."""
        return cauchy_slopes(self._errors(middle), self._rows, EFFICIENT, self._counts)

    def linearised(self, middle: np.ndarray) -> Slopes:
        """The loss of the fits and the prior."""
        return self.slopes(middle).with_prior(middle)

    def moved(self, middle: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The parameters after a step."""
        return middle + step


def _pooled(camera: Camera, value: np.ndarray, std: np.ndarray, fitted: bool) -> Camera:
    """The camera moved by pooled differences `value` (SIZE,). std: their deviations (SIZE,), 0 for
    a parameter that is not fitted."""
    moved = with_parameters(camera, value / [1, camera.focal, camera.focal, 1, 1, 1])
    if fitted and std[0]:
        moved = replace(moved, focal_source="matches", focal_prior=None)
    known = moved.with_deviations((std / [1, moved.focal, moved.focal, 1, 1, 1]) ** 2)
    return replace(known, centre_std=known.centre_std or camera.centre_std)


def _parameters(camera: Camera) -> np.ndarray:
    """(SIZE,): ln f, the principal point in pixels, the radial coefficients (0 without a lens), and
    ln(fy / fx)."""
    lens = camera.distortion
    radial = (0.0, 0.0) if lens is None else lens.radial
    return np.array(
        [np.log(camera.focal), *camera.K[:2, 2], *radial, np.log(camera.K[1, 1] / camera.K[0, 0])]
    )
