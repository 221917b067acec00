"""Key points that the pairs of a finished batch share, as a COLMAP database or hloc's files.

A batch works on upright images. COLMAP reads the stored pixels, and the files refer to these.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from dgc_pose.batch.pairs import PairRow
from dgc_pose.batch.result import GROUP_BYTES, Batch, group_name
from dgc_pose.batch.workers import KNOWN_FOCAL_STD
from dgc_pose.cameras.camera import Camera, colmap_camera
from dgc_pose.colmap.tracking import PairGeometry, SharedMatches, track_corners
from dgc_pose.errors import DgcPoseError, InputError, reason
from dgc_pose.estimation.intrinsics_prior import may_be_crop
from dgc_pose.estimation.status import CONFIGURATIONS
from dgc_pose.geometry.pixels import Size, exif_turn, turn_points
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.decoding import image_header
from dgc_pose.model import HALF_PIXEL
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.files import replaced, require_room, save_text, staged

# Upper bounds of a database's size with SQLite's log: empty, per key point and per match.
_EMPTY_BYTES = 2**18
_KEY_POINT_BYTES = 16
_MATCH_BYTES = 32


class NoPairError(InputError):
    """No pair of a batch has an accepted pose."""


def share(
    batch: Batch, per_image: int, progress: Callable[[int, int], None] = lambda done, of: None
) -> SharedMatches:
    """The shared key points of a batch, in stored pixels. per_image: most corners of an image.

    Raises NoPairError if no pair has an accepted pose or rotation; ImageError if an image can no
    longer be read.
    """
    pairs = pair_geometries(batch)
    if not pairs:
        down = sum(row.rejected for row in batch.rows)
        estimated = [row for row in batch.rows if row.pose is not None] or batch.rows
        first = "".join(f"; the first: {row.reason}" for row in estimated[:1])
        first = f"; {down} are rejected as look-alikes" if down else first
        raise NoPairError(f"{batch.folder}: no pair of this batch has an accepted pose{first}")
    root = batch.plan.root
    masks = batch.plan.settings.get("masks")
    cache = ImageCache(2**29)
    shared = track_corners(pairs, lambda n: cache.read(root, n, masks), per_image, progress)
    key_points = {n: turn_points(p, *to_stored(root / n)) for n, p in shared.key_points.items()}
    return SharedMatches(key_points, shared.pairs)


def to_stored(path: Path) -> tuple[np.ndarray, Size]:
    """The rotation (2, 2) from an upright image to its stored pixels, and its (width, height)."""
    header = image_header(path)
    return exif_turn(header.exif.orientation).T, header.size


def pair_geometries(batch: Batch) -> list[PairGeometry]:
    """The pairs whose pose or rotation the folder accepts, with its inliers, and the cameras that
    the pair fitted or else the folder's cameras."""
    geometries = []
    final = batch.plan.final_cameras
    for pair in batch.pairs():
        row = pair.row
        pose = pair.row.pose
        if pose is not None and pose.status in CONFIGURATIONS and not row.rejected:
            cameras = row.fitted_cameras or (final[row.name1], final[row.name2])
            geometries.append(PairGeometry(row, cameras, pair.matches.subset(pose.inliers)))
    return geometries


def write_shared(batch: Batch, shared: SharedMatches, database: Path) -> None:
    """Write the key points of `share` as a database, replacing an existing file. Raises what
    `write_database` raises."""
    plan = batch.plan
    turns = {name: to_stored(plan.root / name) for name in plan.final_cameras}
    cameras = {name: camera.turned(*turns[name]) for name, camera in plan.final_cameras.items()}
    rows = [
        _as_stored(row, *(turns[name][0] for name in row.names))
        for row in batch.rows
        if row.names in shared.pairs
    ]
    write_database(database, plan.names, cameras, shared, rows)


def _as_stored(row: PairRow, turn1: np.ndarray, turn2: np.ndarray) -> PairRow:
    """The row with its pose for stored pixels. turn1, turn2: rotations (2, 2) from upright."""
    turn1, turn2 = (np.block([[t, np.zeros((2, 1))], [0, 0, 1]]) for t in (turn1, turn2))
    pose = row.pose
    assert pose is not None and pose.R is not None  # by its status
    t = None if pose.t is None else turn2 @ pose.t
    return replace(row, pose=replace(pose, R=turn2 @ pose.R @ turn1.T, t=t))


def write_database(
    path: Path,
    names: Sequence[str],
    cameras: Mapping[str, Camera],
    shared: SharedMatches,
    rows: Iterable[PairRow],
) -> None:
    """Write a database, completely or not at all, replacing an existing file.

    names: all images; images without a camera are skipped. rows: at least the rows of the pairs in
    `shared`.

    Raises InputError if COLMAP cannot hold a camera; OSError, with the path, if the disk is full;
    DgcPoseError if pycolmap fails.
    """
    key_points, matches = (sum(map(len, m.values())) for m in (shared.key_points, shared.pairs))
    size = _EMPTY_BYTES + _KEY_POINT_BYTES * key_points + _MATCH_BYTES * matches
    with written_database(path, size) as temporary:
        # No pycolmap transaction: committing one kills the process when the disk is full. None
        # is needed, because the file does not have its final name yet.
        with pycolmap.Database.open(temporary) as database:
            ids = _write_images(database, names, cameras)
            for name, points in shared.key_points.items():
                database.write_keypoints(ids[name], (points + HALF_PIXEL).astype(np.float32))
            by_pair = {row.names: row for row in rows}
            for pair, index in shared.pairs.items():
                id1, id2 = (ids[name] for name in pair)
                database.write_matches(id1, id2, index)
                geometry = two_view_geometry(by_pair[pair], index)
                database.write_two_view_geometry(id1, id2, geometry)


@contextmanager
def written_database(path: Path, size: int) -> Iterator[Path]:
    """Yield the file of a new database, of at most `size` bytes, which then replaces `path`. Raises
    what `write_database` raises."""
    require_room(path, size)  # pycolmap omits the system's error; SQLite may lose its log without
    with replaced(path) as temporary:
        try:
            yield temporary
        except RuntimeError as error:
            raise DgcPoseError(f"{path}: pycolmap: {reason(error)}") from error
        for ending in ("-wal", "-shm", "-journal"):
            # SQLite would apply a log of the old database to the new one.
            Path(f"{path}{ending}").unlink(missing_ok=True)


def two_view_geometry(row: PairRow, matches: np.ndarray) -> pycolmap.TwoViewGeometry:
    """COLMAP's two-view geometry of a row with a status in `CONFIGURATIONS`.

    matches: (M, 2) uint32, indices of key points, all inliers.
    """
    geometry = pycolmap.TwoViewGeometry()
    geometry.inlier_matches = matches
    configurations = pycolmap.TwoViewGeometryConfiguration
    geometry.config = getattr(configurations, CONFIGURATIONS[row.status])
    pose = row.pose
    assert pose is not None and pose.R is not None  # by its status
    t = np.zeros(3) if pose.t is None else pose.t
    geometry.cam2_from_cam1 = pycolmap.Rigid3d(pycolmap.Rotation3d(pose.R), t)
    if pose.E is not None:
        geometry.E = pose.E
        if pose.median_triangulation_angle_deg is not None:
            geometry.tri_angle = float(np.radians(pose.median_triangulation_angle_deg))
    return geometry


def _write_images(
    database: pycolmap.Database, names: Sequence[str], cameras: Mapping[str, Camera]
) -> dict[str, int]:
    """Write images, cameras, rigs and frames; return the id of each image. Images with equal K,
    size and distortion share a camera, unless it is uncertain and without an identity or possibly
    of a crop."""
    camera_ids: dict[tuple[object, ...], int] = {}
    ids = {}
    for name in (name for name in names if name in cameras):
        camera = colmap_camera(cameras[name], name)
        ours = cameras[name]
        camera.has_prior_focal_length = ours.focal_std < KNOWN_FOCAL_STD
        own_name = name if not ours.exact and (ours.identity is None or may_be_crop(ours)) else None
        size = (camera.width, camera.height)
        key = (own_name, camera.model.name, *size, *camera.params.tolist())
        if key not in camera_ids:
            camera_ids[key] = camera.camera_id = database.write_camera(camera)
            rig = pycolmap.Rig(rig_id=camera_ids[key])
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        image = pycolmap.Image(name=name, camera_id=camera_ids[key])
        image.image_id = ids[name] = database.write_image(image)
        frame = pycolmap.Frame(frame_id=image.image_id, rig_id=camera_ids[key])
        frame.add_data_id(image.data_id)
        database.write_frame(frame, use_frame_id=True)
    return ids


def write_hloc(folder: Path, shared: SharedMatches) -> None:
    """Write hloc's three files of shared key points, replacing existing files.

    `features.h5` has `<image>/keypoints` (float32, (0, 0) the centre of the first pixel) and
    `scores`; `matches.h5` has `name0/name1` with `matches0` (int32, -1 for none) and
    `matching_scores0` (float16); `pairs.txt` has two names a line. Raises InputError for a name
    with a blank, which a pairs file cannot hold.
    """
    for names in shared.pairs:
        if any(len(name.split()) != 1 for name in names):
            raise InputError(
                f"the names {names} contain blanks, which hloc's pairs file cannot hold"
            )
    folder.mkdir(parents=True, exist_ok=True)
    counts = {name: len(points) for name, points in shared.key_points.items()}
    size = 12 * sum(counts.values()) + 6 * sum(counts[name0] for name0, _ in shared.pairs)
    groups = GROUP_BYTES * (len(counts) + len(shared.pairs))
    require_room(folder / "features.h5", size + groups)  # HDF5 ends the process on a full disk
    paths = [str(folder / name) for name in ("features.h5", "matches.h5", "pairs.txt")]
    with staged(*paths) as stage:
        features, matches, pairs = map(stage, paths)
        with h5py.File(features, "w") as file:
            for name, points in shared.key_points.items():
                file[f"{name}/keypoints"] = points.astype(np.float32)
                file[f"{name}/scores"] = np.ones(len(points), np.float32)
        with h5py.File(matches, "w") as file:
            for names, index in shared.pairs.items():
                matches0 = np.full(len(shared.key_points[names[0]]), -1, np.int32)
                matches0[index[:, 0]] = index[:, 1]
                file[f"{group_name(*names)}/matches0"] = matches0
                scores = (matches0 >= 0).astype(np.float16)
                file[f"{group_name(*names)}/matching_scores0"] = scores
        save_text(pairs, "".join(f"{name0} {name1}\n" for name0, name1 in shared.pairs))
