"""Fixed cameras in the model of a walk, by one bundle adjustment of the walk and the cameras."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import matrix_camera
from dgc_pose.colmap.mapping import adjust
from dgc_pose.localization.location import Location
from dgc_pose.model import HALF_PIXEL, Model
from dgc_pose.system.colmap_library import pycolmap

# Largest reprojection error of a point that the adjustment takes: pixels, or medians of all points,
# as the location may be off. A camera with fewer points keeps its location.
_MAX_ERROR_PX, _WIDE, _MIN_POINTS = 2.0, 3.0, 30
# Factors of the expected errors of R and the centre, which take the walk's model for exact: of a
# camera that is fitted, and of one that is exact, which cannot compensate for errors of the walk's
# camera. See docs/experiments.md.
_FITTED, _EXACT = (1.5, 1.0), (2.0, 1.5)
WALK = "walk/"  # begins the names of the other images


def extended(
    model: Model, located: Mapping[str, Location], pictures: Mapping[str, Path]
) -> tuple[pycolmap.Reconstruction, dict[str, int]]:
    """COLMAP's form of the model with the located cameras, and their image ids by camera name.

    The names of the other images begin with `walk/`; images without a file are left out. pictures:
    of the cameras, by name.
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
    """The model of `extended` and the image ids, after a bundle adjustment; and the located cameras
    with the poses that all photographs determine together. Cameras that are exact keep their K, and
    the walk keeps its cameras.

    model: with COLMAP's own form. pictures: the upright pictures of the cameras, by name.
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
        poses[name] = replace(
            location.with_pose(image.cam_from_world().matrix(), grown),
            camera=replace(
                matrix_camera(image.camera),
                focal_std=camera.focal_std,
                centre_std=camera.centre_std,
                focal_source=camera.focal_source,
            ),
        )
    return whole, numbers, poses
