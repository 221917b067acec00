"""A model in metres: by GPS positions of photographs, the distance of two cameras, or markers."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.colmap.mapping import MIN_IMAGES, MappingError
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import ArgumentName, ImageError, InputError
from dgc_pose.estimation.markers import marker_side
from dgc_pose.images.decoding import image_header, read_pixels
from dgc_pose.images.markers import find_markers
from dgc_pose.model import Model
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.parallel import in_threads

_MAX_ERROR_M = 15.0  # of a GPS position that agrees with the model
_AS_WELL = 1.5  # times the median residual, up to which another similarity fits as well
_OWN_FRAME = "the model's own"
_MIN_WIDTH = 0.02  # of GPS positions, as a share of their length: less is a line


def known_metres(
    paths: Mapping[str, Path], options: ReconstructionOptions
) -> tuple[dict[str, Any], str]:
    """What is known before the matching, and the frame: of GPS the positions (3,) by name, metres
    from the first; of `scale` the distance, by both names.

    Raises InputError for fewer than three positions or a line of them, and for an unknown name.
    """
    if options.scale:
        *pair, metres = options.scale.split(",")
        with suppress(ValueError):
            if len({*paths} & {*pair}) == len(pair) == 2 and float(metres) > 0:
                return dict.fromkeys(pair, float(metres)), _OWN_FRAME
        needed = f"must be two of the {len(paths)} images and metres"
        raise InputError(ArgumentName("scale"), f"{needed}, not {options.scale!r}")
    if not options.gps:
        return {}, _OWN_FRAME
    tags = {}
    for name, path in paths.items():
        with suppress(ImageError):
            tags[name] = image_header(path).exif.position
    tags = {name: position for name, position in tags.items() if position}
    places = np.array([*tags.values()]).reshape(-1, 3)
    if len(tags) < MIN_IMAGES:
        count = f"{len(tags)} of {len(paths)} photographs have a GPS position"
        raise InputError(ArgumentName("gps"), f"needs {MIN_IMAGES} positions, and {count}")
    frame = "east, north, up; origin at {:.7f}, {:.7f}, {:.2f} m".format(*places[0])
    places = pycolmap.GPSTransform().ellipsoid_to_enu(places, *places[0])
    length, width, _ = np.linalg.svd(places - places.mean(0), compute_uv=False)
    if width <= _MIN_WIDTH * length:
        raise InputError(ArgumentName("gps"), f"has {len(tags)} positions on one line")
    return dict(zip(tags, places, strict=True)), frame


def to_metres(
    model: pycolmap.Reconstruction, paths: Mapping[str, Path], options: ReconstructionOptions
) -> dict[str, Any]:
    """Bring a model into metres, by a scale or, by GPS, a similarity of RANSAC; for the summary the
    unit, the frame and the errors, nothing without an option for it.

    Raises MappingError if GPS does not agree with the model, InputError as `known_metres`, as
    `marker_side` and for a camera of `scale` that is not in the model; ImageError.
    """
    known, frame = known_metres(paths, options)
    centres = {i.name: i.projection_center() for i in model.images.values() if i.has_pose}
    both = [name for name in known if name in centres]
    errors: dict[str, Any] = {}
    if options.scale:
        for name in known.keys() - centres.keys():
            raise InputError(ArgumentName("scale"), f"{name} is not in the model")
        apart = np.linalg.norm(np.subtract(*(centres[name] for name in both)))
        similarity = pycolmap.Sim3d(known[both[0]] / apart, pycolmap.Rotation3d(), np.zeros(3))
    elif options.gps:
        places = np.array([known[name] for name in both]).reshape(-1, 3)
        ransac = pycolmap.RANSACOptions(max_error=_MAX_ERROR_M, random_seed=0)
        args = model, both, places, MIN_IMAGES, ransac
        aligned = pycolmap.align_reconstruction_to_locations(*args)
        if aligned is None:
            cameras = f"{len(both)} cameras to {_MAX_ERROR_M:g} m from their GPS positions"
            raise MappingError(f"pycolmap has no similarity that brings {cameras}")
        similarity = _upright(aligned, model, np.array([centres[n] for n in both]), places)
        off = [np.linalg.norm(similarity * centres[name] - known[name]) for name in both]
        errors["median_gps_residual_m"] = round(float(np.median(off)), 3)
        errors["largest_gps_residual_m"] = round(float(max(off)), 3)
    elif options.marker:
        posed = Model.of_colmap(model, Path())
        corners = in_threads(lambda name: find_markers(read_pixels(paths[name])), [*posed.poses])
        found = marker_side(corners, [*posed.cameras.values()], [*posed.poses.values()])
        similarity = pycolmap.Sim3d(options.marker / found.side, pycolmap.Rotation3d(), np.zeros(3))
        errors = {"scale_relative_std": round(found.std, 5), "marker_images": found.images}
    else:
        return {}
    model.transform(similarity)
    return {"unit": "m", "frame": frame, **errors}


def _upright(
    aligned: pycolmap.Sim3d, model: pycolmap.Reconstruction, centres: np.ndarray, places: np.ndarray
) -> pycolmap.Sim3d:
    """A similarity, or if it turns cameras in a plane at `centres`, (N, 3), upside down, it and 180
    degrees about their length, where that brings them as near to `places`, (N, 3) metres: of a
    narrow survey the noise of the altitudes would decide. One of cameras on a line is kept.
    """
    at = aligned * centres
    _, (length, width, _), (axis, _, normal) = np.linalg.svd(at - at.mean(0), full_matrices=False)
    posed = [image.cam_from_world().rotation for image in model.images.values() if image.has_pose]
    # Down is y of an upright photograph, and z of one from above.
    lower = aligned.rotation * np.sum([(0, 2, 1) @ turn.matrix() for turn in posed], 0)
    half = 2 * np.outer(axis, axis) - np.eye(3)
    by_half = pycolmap.Sim3d(1.0, pycolmap.Rotation3d(half), at.mean(0) - half @ at.mean(0))
    off, off_turned = (np.median(np.linalg.norm(p - places, axis=1)) for p in (at, by_half * at))
    is_down = (lower @ normal) * normal[2] <= 0
    is_kept = is_down or width <= _MIN_WIDTH * length or off_turned > _AS_WELL * off
    return aligned if is_kept else by_half * aligned
