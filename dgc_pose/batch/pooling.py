"""The cameras of a folder, each pooled from the fits of all of its pairs.

Each pair has fitted the focal lengths, principal points and lenses of its own cameras, with a
prior. The fits of one camera are pooled here: robustly, weighted by their covariances, and with the
prior once instead of once a pair. Dozens of pairs determine the principal point, which one pair
hardly does.
"""

import csv
import io
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgc_pose.batch.rows import PairRow
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.intrinsics_prior import SIZE, is_of_part, parameter_stds, with_parameters
from dgc_pose.estimation.least_squares import EFFICIENT
from dgc_pose.system.files import write_text

CAMERAS = "cameras.csv"
# Of ln f: below, a pooled camera is better than one that a single pair fits.
KNOWN_FOCAL_STD = 0.05
_STARTS, _STEPS = 101, 50
_MAX_STD_SHARE = 0.9  # of the prior: a wider fit of the focal length is left out
_FAR_CENTRE_STDS = 1.5  # principal points that differ by more are far apart
_MIN_VARIANCE = 1e-9  # of the prior's: keeps an information finite
_COLUMNS = (
    *("name", "fx", "fy", "cx", "cy", "width", "height", "focal_std", "centre_std_px"),
    *("lens_std", "aspect_std", "camera"),
    *("model", "coefficients"),  # of the lens
)


@dataclass(frozen=True)
class PooledCamera:
    """One camera of a folder."""

    cameras: Mapping[str, Camera]  # of its images, by name
    pairs: int  # whose fits enter its focal length
    why: str = ""  # its images have it, unless by their sizes and EXIF data or the K given


@dataclass(frozen=True, eq=False)
class CameraFit:
    """The fit of D parameters of a camera to one pair, as differences from the prior's."""

    value: np.ndarray  # (D,)
    covariance: np.ndarray  # (D, D)
    weight: float = 1.0  # the probability that the pair's pose is right


def fit_of(row: PairRow) -> tuple[Camera, Camera] | None:
    """The cameras that a pair with a pose fits by the assumed camera model."""
    return row.fitted_cameras if row.success and row.camera_model == "assumed" else None


def is_known(camera: Camera) -> bool:
    """Whether a pooled camera is better than one that a single pair fits."""
    return camera.focal_std <= KNOWN_FOCAL_STD and not is_of_part(camera)


def sharing(cameras: Mapping[str, Camera]) -> dict[str, tuple[str, ...]]:
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
    cameras: Mapping[str, Camera], rows: Iterable[PairRow], inside: Collection[str] = ()
) -> list[PooledCamera]:
    """The cameras that have a deviation, one by one, as all pairs fit them.

    cameras: by name, as the pairs had them. inside: images whose cameras are fitted by the pairs of
    one camera, and by those of two images alone. Images of several sizes, and parts without EXIF
    data, share a focal length and no principal point. The same for any order of the rows.
    """
    shared = sharing(cameras)
    fits: dict[tuple[str, ...], list[CameraFit]] = defaultdict(list)
    for row in rows:
        for key, fit in _fits_of(row, cameras, shared, inside).items():
            fits[key].append(fit)
    pooled = []
    for names in dict.fromkeys(shared.values()):
        first = cameras[names[0]]
        prior = np.array(parameter_stds(first)) * ([1, first.focal, first.focal, 1, 1, 1])
        cut = first.focal_source in ("size", "lines") and is_of_part(first) and len(names) > 1
        if cut or len({cameras[name].size for name in names}) > 1:
            prior[1:3] = 0
        open_ = np.flatnonzero(prior)  # what is fitted
        if not len(open_):
            continue
        widest = (_MAX_STD_SHARE * prior[open_[0]]) ** 2
        useful = [
            CameraFit(fit.value[open_], fit.covariance[np.ix_(open_, open_)], fit.weight)
            for fit in fits[names]
            if fit.covariance.diagonal()[open_[0]] < widest and fit.weight > 0
        ]
        value, std = np.zeros(SIZE), np.zeros(SIZE)
        value[open_], std[open_] = pooled_fit(useful, prior[open_], len(names))
        fitted = bool(useful)
        of_names = {name: _pooled(cameras[name], value, std, fitted) for name in names}
        pooled.append(PooledCamera(of_names, len(useful)))
    return pooled


def centre_moved(before: Mapping[str, Camera], after: Mapping[str, Camera]) -> bool:
    """Whether a pooled principal point is so far from the prior's that fits with this prior are
    off, and are better made again around the pooled camera."""
    return any(
        np.abs(after[name].K[:2, 2] - camera.K[:2, 2]).max() > _FAR_CENTRE_STDS * camera.centre_std
        for name, camera in before.items()
        if not camera.exact
    )


def pooled_fit(
    fits: list[CameraFit], prior: np.ndarray, images: int
) -> tuple[np.ndarray, np.ndarray]:
    """The parameters (D,), as differences from the prior's, and their deviations (D,).

    fits: of pairs whose fits contain the prior, of the deviations `prior` (D,). images: that the
    camera took. Fits of pairs that share an image err alike: as many count as there are pairs
    without an image in common. Fits that scatter more than by their covariances widen the result.
    """
    count = len(prior)
    if not fits:
        return np.zeros(count), prior
    fits = sorted(fits, key=lambda fit: tuple(fit.value))  # the same sums for any order
    weight = np.array([fit.weight for fit in fits])
    # In deviations of the prior, whose information is then 1 along each axis.
    values = np.array([fit.value for fit in fits]) / prior
    covariances = np.array([fit.covariance for fit in fits]) / np.outer(prior, prior)
    variances, axes = np.linalg.eigh(covariances)
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
    alike = min(max(1.0, 2 * len(fits) / images), len(fits))
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


def write_cameras(out: Path, cameras: Mapping[str, Camera]) -> None:
    """Write `cameras.csv`, which `--K` reads: a line for each image."""
    table = io.StringIO()
    lines = csv.writer(table, lineterminator="\n")
    lines.writerow(_COLUMNS)
    for name, camera in cameras.items():
        K = camera.K
        numbers = (K[0, 0], K[1, 1], K[0, 2], K[1, 2], *(camera.size or ("", "")))
        stds = (camera.focal_std, camera.centre_std, camera.lens_std, camera.aspect_std)
        lens = camera.distortion
        of_lens = ("", "") if lens is None else (lens.model, " ".join(map(repr, lens.coefficients)))
        lines.writerow([name, *numbers, *stds, camera.identity or "", *of_lens])
    text = table.getvalue().encode(errors="backslashreplace")  # names need be no UTF-8
    write_text(out / CAMERAS, text.decode())


def _fits_of(
    row: PairRow,
    cameras: Mapping[str, Camera],
    shared: Mapping[str, tuple[str, ...]],
    inside: Collection[str],
) -> dict[tuple[str, ...], CameraFit]:
    fits: dict[tuple[str, ...], CameraFit] = {}
    pose, fitted = row.pose, fit_of(row)
    if fitted is not None and pose is not None and pose.camera_covariance is not None:
        first, second = (shared.get(name, (name,)) for name in row.names)
        between = first != second and max(len(first), len(second)) > 1
        known = pose.one_place_probability
        weight = 1.0 if known is None else known
        blocks = pose.camera_covariance[:SIZE, :SIZE], pose.camera_covariance[SIZE:, SIZE:]
        for name, camera, block in zip(row.names, fitted, blocks, strict=True):
            if name in shared and not (between and name in inside):
                value = _parameters(camera) - _parameters(cameras[name])
                fits[shared[name]] = CameraFit(value, block, weight)
    return fits
