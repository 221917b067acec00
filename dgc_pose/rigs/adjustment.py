"""Located cameras in their final model, and in metres. With a walk, one bundle adjustment refines
the walk and the cameras; without a walk, the cameras' own batch determines the poses."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgc_pose.batch.result import Batch
from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.colmap.reconstruction import adjust
from dgc_pose.localization.location import Location
from dgc_pose.model import HALF_PIXEL, Model
from dgc_pose.system.colmap_library import pycolmap

# Largest reprojection error of a point in the adjustment: in pixels, or times the median error, as
# the location may be off. A camera with fewer than `_MIN_POINTS` keeps its location.
_MAX_ERROR_PX, _WIDE, _MIN_POINTS = 2.0, 3.0, 30
# Factors of the expected errors of R and the centre, which treat the walk's model as exact. The
# first are for a fitted camera; the second for an exact K, which cannot compensate for errors of
# the walk's camera. See docs/experiments.md.
_FITTED, _EXACT = (1.5, 1.0), (2.0, 1.5)
WALK = "walk/"  # prefix of the names of the walk's images


def extended(
    model: Model, located: Mapping[str, Location], pictures: Mapping[str, Path]
) -> tuple[pycolmap.Reconstruction, dict[str, int]]:
    """COLMAP's form of the model with the located cameras, and their image ids by camera name.

    The other images get the prefix `walk/`; those without a file, which `model` lacks, lose their
    pose. pictures: of the cameras, by name.
    """
    views = {pictures[name]: (of.camera, of.cam_from_world) for name, of in located.items()}
    whole = model.extended(
        {p: (c, pose) for p, (c, pose) in views.items() if c and pose is not None}
    )
    ids = sorted(whole.images)
    new = dict(zip(located, ids[len(ids) - len(located) :], strict=True))
    by_file = {Path(name).name: name for name in model.poses}
    for image in [whole.images[number] for number in ids if number not in new.values()]:
        name = image.name if image.name in model.poses else by_file.get(Path(image.name).name)
        if name is not None:
            image.name = WALK + name
        elif image.has_pose:
            whole.deregister_frame(image.frame_id)
    return whole, new


def adjusted(
    model: Model, located: Mapping[str, Location], pictures: Mapping[str, Path]
) -> tuple[pycolmap.Reconstruction, dict[str, int], dict[str, Location]]:
    """Bundle adjustment of the model of `extended`: the model, the image ids, and the located
    cameras with their new poses. Exact cameras keep their K, and the walk keeps its cameras.

    model: with COLMAP's form. pictures: the upright pictures of the cameras, by name.
    """
    whole, numbers = extended(model, located, pictures)
    assert model.colmap is not None
    keys, open_ = np.array([*model.colmap.points3D]), []
    for name, location in located.items():
        image = whole.images[numbers[name]]
        agreeing = [of for of in location.database_images if of.agrees]
        points = np.concatenate([of.points for of in agreeing])
        seen = np.concatenate([of.seen for of in agreeing])
        if len(points) < _MIN_POINTS:
            continue
        shown = [image.project_point(xyz) for xyz in model.points[points]]
        behind = np.full(2, np.nan)
        at = np.array([behind if pixel is None else pixel - HALF_PIXEL for pixel in shown])
        error = np.abs(at.reshape(-1, 2) - seen).max(1)
        good = np.flatnonzero(error < max(_MAX_ERROR_PX, _WIDE * float(np.nanmedian(error))))
        good = good[np.unique(points[good], return_index=True)[1]]
        if len(good) < _MIN_POINTS:
            continue
        if location.camera is not None and not location.camera.exact:
            open_.append(image.name)
        pixels = [pycolmap.Point2D(pixel + HALF_PIXEL) for pixel in seen[good]]
        image.points2D = pycolmap.Point2DList(pixels)
        for index, key in enumerate(keys[points[good]].tolist()):
            whole.add_observation(key, pycolmap.TrackElement(image.image_id, index))
    adjust(whole, open_)
    poses = {}
    for name, location in located.items():
        image, camera = whole.images[numbers[name]], location.camera
        assert camera is not None  # of a location
        grown = np.diag(np.repeat(_EXACT if camera.exact else _FITTED, 3))
        placed = location.with_pose(image.cam_from_world().matrix(), grown)
        adjusted_camera = _with_stds(matrix_camera(image.camera), camera)
        poses[name] = replace(placed, camera=adjusted_camera)
    return whole, numbers, poses


def _with_stds(camera: Camera, of: Camera) -> Camera:
    """The camera with the deviations and the focal source of another one."""
    source = of.focal_source
    return replace(camera, focal_std=of.focal_std, centre_std=of.centre_std, focal_source=source)


def in_model_of_batch(
    cameras: Mapping[str, Location], files: Mapping[str, str], model: Model, batch: Batch
) -> dict[str, Location]:
    """The locations of pictures with the poses and cameras of the model of their own batch.

    The expected errors are at least those of the picture's best pair, since the points of the model
    depend on the pictures.
    """
    found = dict(cameras)
    for name, of in cameras.items():
        if not of.success:
            continue
        if (file := files[name]) not in model.poses:
            reason = "it has a pose, and COLMAP did not take it into the model"
            found[name] = Location("nowhere", reason, of.database_images)
            continue
        errors: list[tuple[float, float]] = []
        for row in batch.rows:
            if row.success and row.pose and file in row.names and {*row.names} <= {*model.poses}:
                apart = float(np.linalg.norm(np.subtract(*map(model.centre, row.names))))
                angle = math.radians(row.pose.translation_error_90_deg or 0.0)
                errors.append((row.pose.rotation_error_90_deg or 0.0, angle * apart))
        stated = np.array([of.rotation_error_90_deg, of.position_error_90])
        least = np.array(errors or [(0.0, 0.0)]).min(0)
        grown = np.diag(np.repeat(np.maximum(least / stated, 1.0), 3))
        camera = _with_stds(model.cameras[file], batch.plan.final_cameras[file])
        found[name] = replace(of.with_pose(model.poses[file], grown), camera=camera)
    return found


def in_metres(location: Location, pose: np.ndarray, scale: float) -> Location:
    """The location with its pose (3, 4) in a frame that is scaled by `scale`."""
    assert location.R is not None
    turn = np.eye(6)
    turn[3:, 3:] = scale * pose[:, :3].T @ location.R
    return location.with_pose(pose, turn)
