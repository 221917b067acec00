"""The cameras of a folder: what all of their pairs say of a focal length, as one number.

Each pair has fitted the focal lengths of its own cameras, with a prior. The fits of one camera are
pooled here: robustly, weighted by their deviations, and with the prior once instead of once a pair.
"""

import csv
import io
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgc_pose.batch.rows import PairRow
from dgc_pose.cameras.camera import Camera
from dgc_pose.files.outputs import write_text

CAMERAS = "cameras.csv"
_CAUCHY = 2.385  # deviations at which a fit's weight is halved; 95 % efficient for normal errors
_STARTS, _FOR_STARTS, _STEPS = 101, 4096, 50
# A pair whose fit is hardly narrower than the prior says nothing of the focal length.
_LEAST_TOLD = 0.9
_COLUMNS = ("name", "fx", "fy", "cx", "cy", "width", "height", "focal_std", "camera")


@dataclass(frozen=True)
class PooledCamera:
    """One camera of a folder."""

    names: tuple[str, ...]  # its images
    camera: Camera  # of its first image
    pairs: int  # that told its focal length


@dataclass(frozen=True, order=True)
class Told:
    """What one pair says of a camera: the logarithm of its focal length over the prior's."""

    value: float
    std: float
    weight: float = 1.0  # the probability that the pair's pose is right


def pool(
    cameras: Mapping[str, Camera], rows: Iterable[PairRow]
) -> tuple[dict[str, Camera], list[PooledCamera]]:
    """The cameras by image name with the focal lengths pooled over the rows, and one by one those
    that had a deviation.

    cameras: by name, as the pairs had them; those without a deviation stay as they are. The same
    for the rows in any order.
    """
    groups: dict[tuple[str, str], list[str]] = defaultdict(list)
    for name, camera in cameras.items():
        if camera.focal_std > 0:
            groups[_key(camera, name)].append(name)
    told: dict[tuple[str, str], list[Told]] = defaultdict(list)
    for row in rows:
        for key, value in _told_by(row, cameras).items():
            told[key].append(value)
    pooled, listed = dict(cameras), []
    for key, names in groups.items():
        prior = cameras[names[0]].focal_std
        useful = [fit for fit in told[key] if fit.std < _LEAST_TOLD * prior and fit.weight > 0]
        log_ratio, std = pooled_focal(useful, prior, len(names))
        for name in names:
            camera = with_focal(cameras[name], cameras[name].focal * np.exp(log_ratio))
            source = "matches" if useful else camera.focal_source
            pooled[name] = replace(camera, focal_std=std, focal_source=source)
        listed.append(PooledCamera(tuple(names), pooled[names[0]], len(useful)))
    return pooled, listed


def pooled_focal(told: list[Told], prior_std: float, images: int) -> tuple[float, float]:
    """The logarithm of the focal length over the prior's, and its deviation.

    told: of pairs whose fits contain the prior, of mean 0 and deviation `prior_std`. images: that
    the camera took. Fits of pairs that share an image err alike: as many count as there are pairs
    without an image in common. Fits that scatter more than their deviations say widen the result.
    """
    if not told:
        return 0.0, prior_std
    prior = prior_std**-2
    told = sorted(told)  # sums to the last digit whatever the order of the rows
    value, std, weight = np.array([(fit.value, fit.std, fit.weight) for fit in told]).T
    precision = std**-2 - prior  # of the pairs' matches alone
    value = value * std**-2 / precision
    # From the value that most pairs agree with: a few of great precision may be wrong.
    starts = np.quantile(value, np.linspace(0, 1, _STARTS), method="nearest")
    some = slice(None, None, 1 + len(told) // _FOR_STARTS)
    distances = (value[some] - starts[:, None]) ** 2 * precision[some]
    middle = starts[(weight[some] * np.log1p(distances / _CAUCHY**2)).sum(1).argmin()]
    for _ in range(_STEPS):
        distance = (value - middle) ** 2 * precision
        robust = weight / (1 + distance / _CAUCHY**2)
        trusted = robust * precision
        before, middle = middle, (trusted * value).sum() / (trusted.sum() + prior)
        if abs(middle - before) < 1e-9:
            break
    scatter = max(1.0, float((robust * distance).sum() / robust.sum()))
    alike = min(max(1.0, 2 * len(told) / images), len(told))
    of_pairs = float(trusted.sum()) / (scatter * alike)
    return float(middle), float((of_pairs + prior) ** -0.5)


def with_focal(camera: Camera, focal: float) -> Camera:
    """The camera with another focal length, pixels."""
    K = camera.K.copy()
    K[:2, :2] *= focal / camera.focal
    return replace(camera, K=K)


def write_cameras(out: Path, cameras: Mapping[str, Camera]) -> None:
    """Write `cameras.csv`, which `--K` reads: a line for each image."""
    table = io.StringIO()
    lines = csv.writer(table, lineterminator="\n")
    lines.writerow(_COLUMNS)
    for name, camera in cameras.items():
        K = camera.K
        centre = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        size = camera.size or ("", "")
        lines.writerow(
            [name, *map(float, centre), *size, float(camera.focal_std), camera.identity or ""]
        )
    text = table.getvalue().encode(errors="backslashreplace")  # names need be no UTF-8
    write_text(out / CAMERAS, text.decode())


def _key(camera: Camera, name: str) -> tuple[str, str]:
    """Equal for images of one camera."""
    return ("image", name) if camera.identity is None else ("camera", camera.identity)


def _told_by(row: PairRow, cameras: Mapping[str, Camera]) -> dict[tuple[str, str], Told]:
    """What a pair says of its cameras; one camera of both images once."""
    told = {}
    for name, focal, std in (
        (row.name1, row.focal1, row.focal_std1),
        (row.name2, row.focal2, row.focal_std2),
    ):
        if row.success and focal is not None and std is not None and std > 0:
            ratio = float(np.log(focal / cameras[name].focal))
            weight = 1.0 if row.probability is None else row.probability
            told[_key(cameras[name], name)] = Told(ratio, std, weight)
    return told
