"""The cameras of a folder: which photographs share one, and how all of their pairs fit it.

Photographs of one `identity` share a camera, as long as their pairs agree with it. A photograph
whose pairs do not, and one that is alone of its identity, has a camera of its own, which is fitted
to its pairs with photographs of known cameras: one more unknown camera is determined there far
better than two are. If this agrees with the camera of a group, at the scale of its size, the
photograph has that camera after all.
"""

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.batch.pooling import PooledCamera, by_image, centre_moved, fit_of, pool, sharing
from dgc_pose.batch.poses import Poses, epipolar_error_px
from dgc_pose.batch.rows import MatchedPair, PairRow
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import OTHER_STD, SHARED
from dgc_pose.estimation.camera_model import OF_STATED, with_model
from dgc_pose.estimation.evidence import ModelName
from dgc_pose.geometry.pixels import Size, same_shape

Cameras = Mapping[str, Camera]  # by image name, with the image's size
_MIN_GROUP = 3  # images of a camera that one of them can contradict
_MIN_INLIERS = 50  # of a pair that ought to determine its cameras
_AGREEING_SHARE = 0.5  # of these pairs; a photograph with fewer that agree is fitted by itself
_AGREEING_STDS, _SAME_STDS = 3.0, 2.0  # of ln f: of a pair and its group; of two cameras
_SAME_FOCAL = 0.01  # difference of ln f of one camera, by its focus
_MOST_FOCAL_STD = 0.1  # of ln f, above which a fit agrees with any camera
_PARTNER_FOCAL_STD = 0.15  # of ln f, up to which a camera helps to determine another
_CENTRE_OF_PART = 0.1  # deviation of the principal point of a photograph that may be cut
_LEAST_ERROR_PX = 1e-6  # that has a logarithm
_MOST_PAIRS = 6  # that a camera of its own is fitted to, those of the most inliers


def folder_cameras(poses: Poses, cameras: Cameras) -> list[PooledCamera]:
    """The cameras one by one, of those that had a deviation.

    poses: of pairs that are stored each with its own fit of `cameras`.
    """
    rows = _rows_of(poses.store.pairs("matched"))
    start = _by_models(cameras, rows)
    known = {**start, **by_image(pool(start, rows, inside=start))}
    if start != cameras or centre_moved(start, known):
        start = {name: replace(c, K=known[name].K) for name, c in start.items()}
        rows = _rows_of(poses.estimated(start, fit=True))
        known = {**start, **by_image(pool(start, rows, inside=start))}
    single = {name for name, names in sharing(start).items() if len(names) == 1}
    certain = [n for n, c in known.items() if n not in single and c.focal_std < _PARTNER_FOCAL_STD]
    own = _own_cameras(poses, start, rows, known, certain)
    found = _whose(start, known, certain, own)
    whose = {name: other for name, other in found.items() if cameras[name].identity is not None}
    members = {name: camera for name, camera in start.items() if name not in own}
    kept = [row for row in rows if not {*row.names} & {*own}]
    listed = [*pool(members, kept, inside=certain), *own.values()]
    final = {**start, **by_image(listed)}
    for name, other in whose.items():  # off by the same factor
        resized = final[other].resized(_size(start[name]))
        final[name] = replace(resized, warnings=start[name].warnings)
    for i, one in enumerate(listed):
        others = [whose[name] for name in one.cameras if name in whose]
        why = f"the camera of {others[0]}, at its size" if others else one.why
        if not why and any(cameras[n].identity and not start[n].identity for n in one.cameras):
            why = "most pairs of its size agree with a focal length of each photograph"
        listed[i] = replace(one, cameras={name: final[name] for name in one.cameras}, why=why)
    return listed


def _rows_of(pairs: Iterable[MatchedPair]) -> list[PairRow]:
    return sorted((pair.row for pair in pairs), key=lambda row: row.index)


def _own_cameras(
    poses: Poses,
    start: Cameras,
    rows: Sequence[PairRow],
    known: Cameras,
    certain: Sequence[str],
) -> dict[str, PooledCamera]:
    """The cameras of photographs by themselves: of those that are alone of their identity, and of
    those that most pairs with the others of it contradict.

    known: as the pairs of each identity determine them; certain: the photographs of which they do.
    """
    own: dict[str, PooledCamera] = {}
    exact = {name: camera.as_exact() for name, camera in known.items()}
    for name, names in sharing(start).items():
        camera, agreeing, single = start[name], 0, len(names) == 1
        if not single:
            agreeing, count = _agreement(name, names, known[name], rows)
            stated = camera.focal_source == "given" or camera.identity == SHARED
            if stated or name not in certain or len(names) < _MIN_GROUP:
                continue
            if agreeing >= _AGREEING_SHARE * count:
                continue
        partners = {*certain} - {name}
        chosen = [r for r in rows if name in r.names and partners.intersection(r.names)]
        chosen.sort(key=lambda row: -row.num_inliers)
        some = {row.index for row in chosen[:_MOST_PAIRS]}
        tried = {**known, name: _own(camera, doubted=not single)}
        refitted = _rows_of(poses.estimated(tried, fit=True, only=some))
        (found,) = pool({**exact, name: tried[name]}, refitted)
        # A wide fit contradicts no pairs that agree, or that determine as little.
        contradicts = agreeing == 0 and any(
            _is_ample(row) for row in refitted if row.status != "mirrored"
        )
        fit = found.cameras[name]
        in_group = not single and _agrees(fit, known[name])
        if (fit.focal_std < _MOST_FOCAL_STD or contradicts) and not in_group:
            own[name] = replace(found, why="its pairs agree with no other camera")
        if not single or camera.focal_source == "given":
            continue
        size = _size(camera)
        if other := next((n for n in certain if not same_shape(size, _size(known[n]))), None):
            squeezed = known[other].resized(size)
            # A part of a picture is of another shape too, and has hardly fewer inliers as squeezed.
            either = [{**exact, name: c.as_exact()} for c in (squeezed, fit)]
            errors = zip(*(_log_errors(poses, cameras, some) for cameras in either), strict=True)
            if sum(as_squeezed - as_fit for as_squeezed, as_fit in errors) < 0:
                why = f"the camera of {other}, squeezed"
                own[name] = PooledCamera({name: squeezed}, found.pairs, why)
    return own


def _whose(
    start: Cameras, known: Cameras, certain: Sequence[str], own: Mapping[str, PooledCamera]
) -> dict[str, str]:
    """By photograph the other whose camera it has, but for its size: one of a larger group, or of
    any if it has a camera of its own."""
    groups = sharing(start)

    def rank(name: str) -> tuple[int, tuple[str, ...]]:
        names = groups.get(name, ())
        return 1 if name in own else -len(names), names or (name,)

    of_groups = {name: known[name] for name in certain if name in groups}
    whose = {}
    for name, camera in {**of_groups, **by_image(own.values())}.items():
        larger = (n for n in certain if n not in own and rank(n) < rank(name))
        others = (n for n in larger if _agrees(camera, known[n]))
        if start[name].focal_source != "given" and (other := next(others, None)):
            whose[name] = other
    return whose


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


def _agreement(
    name: str, names: Sequence[str], camera: Camera, rows: Sequence[PairRow]
) -> tuple[int, int]:
    """How many pairs of an image with its group agree with the group's camera, and how many ought
    to determine it."""
    agreeing, count = 0, 0
    for row in rows:
        if name in row.names and {*row.names} <= {*names}:
            count += _is_ample(row)
            if (fitted := fit_of(row)) is not None:
                of_pair = fitted[row.names.index(name)]
                agreeing += _same_focal(of_pair, camera, _AGREEING_STDS)
    return agreeing, count


def _is_ample(row: PairRow) -> bool:
    """Whether a pair has what it takes to determine its cameras."""
    if row.status == "mirrored":  # perhaps because of a wrong camera
        return row.num_matches >= _MIN_INLIERS
    return row.num_inliers >= _MIN_INLIERS and row.status not in ("rotation_only", "same_picture")


def _log_errors(poses: Poses, cameras: Cameras, only: Collection[int]) -> list[float]:
    """By pair the logarithm of the median epipolar error of its matches by these cameras, pixels;
    of a pair that has no pose with them that of a pixel."""
    errors = {}
    for pair in poses.estimated(cameras, fit=False, only=only):
        row, error = pair.row, np.ones(1)
        if row.pose is not None and row.pose.t is not None:
            of_pair = [cameras[name] for name in row.names]
            error = epipolar_error_px(row, of_pair, pair.matches.points1, pair.matches.points2)
        errors[row.index] = math.log(min(max(float(np.median(error)), _LEAST_ERROR_PX), 1.0))
    return [errors[index] for index in sorted(errors)]


def _own(camera: Camera, *, doubted: bool) -> Camera:
    """The camera of a photograph by itself, which may be zoomed or cut unless EXIF data state it
    and nothing contradicts them."""
    camera = replace(camera, identity=None)
    if not doubted and camera.focal_source == "exif" and camera.focal_std < OTHER_STD:
        return camera
    centre_std = _CENTRE_OF_PART * max(camera.size or (0,))
    return replace(camera, focal_std=OTHER_STD, centre_std=centre_std)


def _agrees(camera: Camera, other: Camera) -> bool:
    """Whether a camera that is fitted by itself is that of another image, perhaps resized."""
    size = _size(camera)
    if camera.focal_std > _MOST_FOCAL_STD or not same_shape(size, _size(other)):
        return False
    other = other.resized(size)
    shift = float(np.abs(camera.K[:2, 2] - other.K[:2, 2]).max())
    near = shift < _AGREEING_STDS * math.hypot(camera.centre_std, other.centre_std)
    return near and _same_focal(camera, other, _SAME_STDS)


def _same_focal(camera: Camera, other: Camera, stds: float) -> bool:
    off = abs(math.log(camera.focal / other.focal))
    return off < stds * math.hypot(camera.focal_std, other.focal_std, _SAME_FOCAL)


def _size(camera: Camera) -> Size:
    assert camera.size is not None
    return camera.size
