"""The cameras of a folder: which photographs share one, and how all of their pairs fit it.

Each pair has fitted the focal lengths, principal points and lenses of its own cameras, with a
prior. Photographs of one `identity` share a camera, and the fits of their pairs are pooled:
robustly, weighted by their covariances, and with the prior once instead of once a pair. Dozens of
pairs determine the principal point, which one pair hardly does.

A photograph that is alone of its identity, or that most pairs with the others of it contradict, has
a camera of its own, which is fitted to its pairs with photographs of known cameras: one more
unknown camera is determined there far better than two are.
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
from dgc_pose.estimation.camera_model import OF_STATED, ModelName, with_model
from dgc_pose.estimation.intrinsics_prior import SIZE, is_of_part, parameter_stds, with_parameters
from dgc_pose.estimation.least_squares import EFFICIENT

_STARTS, _STEPS = 101, 50
_MAX_STD_SHARE = 0.9  # of the prior: a wider fit of the focal length is left out
_FAR_CENTRE_STDS = 1.5  # principal points that differ by more are far apart
_MIN_VARIANCE = 1e-9  # of the prior's: keeps an information finite
_ALONE = "its pairs agree with no other camera"
_SPLIT = "most pairs of its size agree with a focal length of each photograph"
_MIN_GROUP = 3  # images of a camera that one of them can contradict
_MIN_INLIERS = 50  # of a pair that ought to determine its cameras
_AGREEING_SHARE = 0.5  # of these pairs; a photograph with fewer that agree is fitted by itself
_AGREEING_STDS, _SAME_STDS = 3.0, 2.0  # of ln f: of a pair and its group; of two cameras
_SAME_FOCAL = 0.01  # difference of ln f of one camera, by its focus
_PARTNER_FOCAL_STD = 0.15  # of ln f, up to which a camera helps to determine another
_MOST_FOCAL_STD = 0.1  # of ln f, of a photograph that is fitted by itself
_CENTRE_OF_PART = 0.1  # deviation of the principal point of a photograph that may be cut


@dataclass(frozen=True)
class PooledCamera:
    """One camera of a folder."""

    cameras: Cameras  # of its images
    pairs: int  # whose fits enter its focal length
    why: str = ""  # its images have it, unless by their sizes and EXIF data or the K given


def folder_cameras(poses: PoseRunner, cameras: Cameras) -> list[PooledCamera]:
    """The cameras one by one, of those that had a deviation.

    poses: of pairs that are stored each with its own fit of `cameras`.
    """
    rows = _rows_of(poses.store.pairs("matched"))
    start = _by_models(cameras, rows)
    known = {**start, **by_image(pool(start, rows, inside=start))}
    if start != cameras or centre_moved(start, known):
        start = {name: replace(c, K=known[name].K) for name, c in start.items()}
        rows = _rows_of(poses.estimate(start, fit=True))
        known = {**start, **by_image(pool(start, rows, inside=start))}
    groups = sharing(start)
    certain = {
        name
        for name, camera in known.items()
        if len(groups.get(name, (name, ""))) > 1 and camera.focal_std < _PARTNER_FOCAL_STD
    }
    apart = {
        name
        for name in certain & groups.keys()
        if start[name].focal_source != "given" and start[name].identity != SHARED
        if _is_contradicted(name, groups[name], known[name], rows)
    }
    certain -= apart
    loose = apart | {name for name, names in groups.items() if len(names) == 1}
    some = {row.index for row in rows if loose & {*row.names} and certain & {*row.names}}
    own = {
        name: _individual_camera(start[name], doubted=name in apart)
        for row in rows
        if row.index in some
        for name in row.names
        if name in loose
    }
    refitted = _rows_of(poses.estimate({**known, **own}, fit=True, only=some))
    exact = {name: camera.as_exact() for name, camera in known.items()}
    found = pool({**exact, **own}, refitted)
    alone = {
        name
        for name, fit in by_image(found).items()
        if (not _agrees(fit, known[name]) if name in apart else fit.focal_std < _MOST_FOCAL_STD)
    }
    members = {name: camera for name, camera in start.items() if name not in alone}
    kept = [row for row in rows if not alone & {*row.names}]
    found = [replace(one, why=_ALONE) for one in found if alone & one.cameras.keys()]
    split = {n for n, c in members.items() if cameras[n].identity and c.identity is None}
    shared = pool(members, kept, inside=certain)
    return [replace(o, why=_SPLIT) if split & o.cameras.keys() else o for o in shared] + found


def _rows_of(pairs: Iterable[MatchedPair]) -> list[PairRow]:
    return sorted((pair.row for pair in pairs), key=lambda row: row.index)


def _by_models(cameras: Cameras, rows: Sequence[PairRow]) -> Cameras:
    """The cameras before the fit by the model that most of their pairs agree with."""
    groups = sharing(cameras)
    weights: dict[str, dict[ModelName, float]] = defaultdict(lambda: defaultdict(float))
    for row in rows:
        for name in {groups[n][0] for n in row.names if n in groups and row.success}:
            known = None if row.pose is None else row.pose.one_place_probability
            weights[name][row.camera_model] += 1.0 if known is None else known
    changed = dict(cameras)
    for name, names in groups.items():
        of_group = weights[names[0]]
        for model, weight in of_group.items():
            if weight > sum(of_group.values()) / 2 and model not in OF_STATED:
                changed[name] = with_model(cameras[name], model)
    return changed


def _is_contradicted(
    name: str, names: Sequence[str], camera: Camera, rows: Sequence[PairRow]
) -> bool:
    """Whether fewer than half of the pairs of an image with the others of its group, that ought to
    determine its camera, agree with that of the group."""
    agreeing, count = 0, 0
    for row in rows:
        if name in row.names and {*row.names} <= {*names}:
            if row.status == "mirrored":  # perhaps because of a wrong camera
                count += row.num_matches >= _MIN_INLIERS
            elif row.status not in ("rotation_only", "same_picture"):
                count += row.num_inliers >= _MIN_INLIERS
            if (fitted := fit_of(row)) is not None:
                agreeing += _same_focal(fitted[row.names.index(name)], camera, _AGREEING_STDS)
    return len(names) >= _MIN_GROUP and agreeing < _AGREEING_SHARE * count


def _agrees(camera: Camera, other: Camera) -> bool:
    """Whether a camera that is fitted by itself is that of its group after all."""
    shift = float(np.abs(camera.K[:2, 2] - other.K[:2, 2]).max())
    near = shift < _AGREEING_STDS * math.hypot(camera.centre_std, other.centre_std)
    return near and _same_focal(camera, other, _SAME_STDS)


def _same_focal(camera: Camera, other: Camera, stds: float) -> bool:
    off = abs(math.log(camera.focal / other.focal))
    return off < stds * math.hypot(camera.focal_std, other.focal_std, _SAME_FOCAL)


def _individual_camera(camera: Camera, *, doubted: bool) -> Camera:
    """The camera of a photograph by itself, which may be zoomed or cut unless EXIF data or a K
    state it and nothing contradicts them."""
    camera = replace(camera, identity=None)
    stated = camera.focal_source in ("exif", "given") and camera.focal_std < OTHER_STD
    if stated and not doubted:
        return camera
    centre_std = _CENTRE_OF_PART * max(camera.size or (0,))
    return replace(camera, focal_std=OTHER_STD, centre_std=centre_std)


def fit_of(row: PairRow) -> tuple[Camera, Camera] | None:
    """The cameras that a pair with a pose fits by the assumed camera model."""
    return row.fitted_cameras if row.success and row.camera_model == "assumed" else None


def sharing(cameras: Cameras) -> dict[str, tuple[str, ...]]:
    """By image name the images of its camera, of cameras with a deviation."""
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
    """The cameras that have a deviation, one by one, as all pairs fit them.

    cameras: by name, as the pairs had them. inside: images whose cameras are fitted by the pairs of
    one camera, and by those of two images alone. Images of several sizes, and parts without EXIF
    data, share a focal length and no principal point. The same for any order of the rows.
    """
    shared = sharing(cameras)
    # By the images of a camera: differences from its parameters, covariances, and the
    # probabilities that the poses of the pairs are right.
    fits: dict[tuple[str, ...], list[tuple[np.ndarray, np.ndarray, float]]] = defaultdict(list)
    for row in rows:
        pose, fitted = row.pose, fit_of(row)
        if fitted is None or pose is None or pose.camera_covariance is None:
            continue
        first, second = (shared.get(name, (name,)) for name in row.names)
        between = first != second and max(len(first), len(second)) > 1
        known = pose.one_place_probability
        blocks = pose.camera_covariance[:SIZE, :SIZE], pose.camera_covariance[SIZE:, SIZE:]
        of_row = {}  # one of a pair of one camera
        for name, camera, block in zip(row.names, fitted, blocks, strict=True):
            if name in shared and not (between and name in inside):
                value = _parameters(camera) - _parameters(cameras[name])
                of_row[shared[name]] = value, block, 1.0 if known is None else known
        for names, fit in of_row.items():
            fits[names].append(fit)
    pooled = []
    for names in dict.fromkeys(shared.values()):
        first_camera = cameras[names[0]]
        focal = first_camera.focal
        prior = np.array(parameter_stds(first_camera)) * ([1, focal, focal, 1, 1, 1])
        cut = first_camera.focal_source in ("size", "lines") and is_of_part(first_camera)
        if (cut and len(names) > 1) or len({cameras[name].size for name in names}) > 1:
            prior[1:3] = 0
        open_ = np.flatnonzero(prior)  # what is fitted
        if not len(open_):
            continue
        widest = (_MAX_STD_SHARE * prior[open_[0]]) ** 2
        useful = [
            (value[open_], covariance[np.ix_(open_, open_)], weight)
            for value, covariance, weight in fits[names]
            if covariance.diagonal()[open_[0]] < widest and weight > 0
        ]
        value, std = np.zeros(SIZE), np.zeros(SIZE)
        std[open_] = prior[open_]
        if useful:
            values, covariances, weights = (np.array(of) for of in zip(*useful, strict=True))
            of_fit = pooled_fit(values, covariances, weights, prior[open_], len(names))
            value[open_], std[open_] = of_fit
        of_names = {name: _pooled(cameras[name], value, std, bool(useful)) for name in names}
        pooled.append(PooledCamera(of_names, len(useful)))
    return pooled


def centre_moved(before: Cameras, after: Cameras) -> bool:
    """Whether a pooled principal point is so far from the prior's that fits with this prior are
    off, and are better made again around the pooled camera."""
    return any(
        np.abs(after[name].K[:2, 2] - camera.K[:2, 2]).max() > _FAR_CENTRE_STDS * camera.centre_std
        for name, camera in before.items()
        if not camera.exact
    )


def pooled_fit(
    values: np.ndarray, covariances: np.ndarray, weight: np.ndarray, prior: np.ndarray, images: int
) -> tuple[np.ndarray, np.ndarray]:
    """The parameters (D,), as differences from the prior's, and their deviations (D,).

    values, covariances: (N, D) and (N, D, D) of pairs whose fits contain the prior, of the
    deviations `prior` (D,). weight: (N,). images: that the camera took. Fits of pairs that share an
    image err alike: as many count as there are pairs without an image in common. Fits that scatter
    more than by their covariances widen the result.
    """
    count, order = len(prior), np.lexsort(values.T[::-1])  # the same sums for any order
    # In deviations of the prior, whose information is then 1 along each axis.
    weight, values = weight[order], values[order] / prior
    variances, axes = np.linalg.eigh(covariances[order] / np.outer(prior, prior))
    information = 1 / np.maximum(variances, _MIN_VARIANCE)
    of_matches = np.maximum(information - 1, 0)  # along the axes, without the prior
    along = np.einsum("nij,ni->nj", axes, values) * information * (of_matches > 0)
    matrices = (axes * of_matches[:, None]) @ axes.transpose(0, 2, 1)
    vectors = np.einsum("nij,nj->ni", axes, along)
    means = np.einsum("nij,nj->ni", axes, along / np.maximum(of_matches, 1e-9))

    def distances(middle: np.ndarray) -> np.ndarray:
        """Squared, of each fit, over the number of parameters."""
        offset = means - middle
        return np.einsum("ni,nij,nj->n", offset, matrices, offset).clip(min=0) / count

    def cost(middle: np.ndarray) -> float:
        return float((weight * np.log1p(distances(middle) / EFFICIENT**2)).sum())

    # From the fit that most pairs agree with: a few of great precision may be wrong.
    middle = min(values[:: 1 + len(values) // _STARTS], key=cost)
    for _ in range(_STEPS):
        distance = distances(middle)
        robust = weight / (1 + distance / EFFICIENT**2)
        total = (robust[:, None, None] * matrices).sum(0)
        before = middle
        middle = np.linalg.solve(total + np.eye(count), (robust[:, None] * vectors).sum(0))
        if np.abs(middle - before).max() < 1e-9:
            break
    scatter = max(1.0, float((robust * distance).sum() / robust.sum()))
    alike = min(max(1.0, 2 * len(values) / images), len(values))
    covariance = np.linalg.inv(total / (scatter * alike) + np.eye(count))
    return middle * prior, np.sqrt(np.diag(covariance)) * prior


def _pooled(camera: Camera, value: np.ndarray, std: np.ndarray, fitted: bool) -> Camera:
    """The camera with pooled differences (SIZE,) from it, and their deviations, 0 of what is not
    fitted."""
    moved = with_parameters(camera, value / [1, camera.focal, camera.focal, 1, 1, 1])
    if fitted and std[0]:
        moved = replace(moved, focal_source="matches", belief=None)
    focal, *centre, lens, _, aspect = std.tolist()
    centre_std = float(np.sqrt(np.square(centre).mean())) or camera.centre_std
    return replace(moved, focal_std=focal, centre_std=centre_std, lens_std=lens, aspect_std=aspect)


def _parameters(camera: Camera) -> np.ndarray:
    """(SIZE,): ln f, the principal point, pixels, the radial coefficients, 0 without them, and
    ln fy / fx."""
    lens = camera.distortion
    radial = (0.0, 0.0) if lens is None else lens.radial
    return np.array(
        [np.log(camera.focal), *camera.K[:2, 2], *radial, np.log(camera.K[1, 1] / camera.K[0, 0])]
    )
