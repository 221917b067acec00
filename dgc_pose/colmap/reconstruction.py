"""Reconstruct models, points and a summary from a finished batch, with pycolmap's mappers; in
metres by GPS positions of photographs, the distance between two cameras, or markers."""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.result import Batch
from dgc_pose.colmap.database import share, write_shared
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.tracking import SharedMatches
from dgc_pose.errors import ArgumentName, DgcPoseError, ImageError, InputError, reason
from dgc_pose.estimation.intrinsics_prior import may_be_crop
from dgc_pose.estimation.marker_side import marker_side
from dgc_pose.images.decoding import image_header
from dgc_pose.images.markers import shared_markers
from dgc_pose.model import Model, require_model_folder, upright_model, write_points
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.files import only_writer, replaced, replaced_folder, scratch_folder
from dgc_pose.system.texts import write_json

DATABASE = "database.db"
MODEL = "sparse"
POINTS = "points.ply"
SUMMARY = "summary.json"
OUTPUTS = (DATABASE, MODEL, POINTS, SUMMARY)  # in the order in which they are written
MIN_IMAGES = 3  # of a model
_SEED = 0
_MAX_ERROR_M = 15.0  # inlier threshold of RANSAC for GPS positions
_MAX_RESIDUAL_RATIO = 1.5  # ratio of median residuals up to which another similarity fits as well
_OWN_FRAME = "the model's own"
_MIN_WIDTH = 0.02  # positions whose width is a smaller share of their length lie on a line


# By image name, the metric data that exist before the matching; and the name of their frame.
KnownMetres = tuple[dict[str, Any], str]


class MappingError(DgcPoseError):
    """COLMAP made no model or failed, or the model does not agree with GPS."""


class NoModelError(MappingError):
    """COLMAP found no model of enough images."""


def reconstruct(
    batch: Batch,
    out: Path,
    options: ReconstructionOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
    known: KnownMetres | None = None,
) -> tuple[list[Model], SharedMatches, dict[str, Any]]:
    """Write `database.db`, `sparse/` and `points.ply` into `out`, replacing existing files.

    Returns the models, the one with the most images first; their matches; and the unit and
    frame of the first model, see `to_metres`, or `not_in_metres`, the error for which the model
    kept its scale. The other models show further scenes. They are in `sparse/1`, ... by size, each
    in axes of its own. Bundle adjustment also refines intrinsics if a camera of the batch was
    uncertain, see `refines`. known: what `known_metres` returned for the images, if it was called
    before.

    Raises NoModelError if COLMAP finds no model, MappingError if it fails; InputError if `sparse`
    contains files that are not part of a model, another process writes into `out`, or no pair has a
    pose; ImageError if an image can no longer be read; OSError if the disk is full.
    """
    options = options or ReconstructionOptions()
    plan = batch.plan
    require_model_folder(out / MODEL, several=True)
    out.mkdir(parents=True, exist_ok=True)
    with only_writer(out):
        found, shared = mapped(batch, out, options, progress)
        try:
            metric = to_metres(found[0], {n: plan.root / n for n in plan.names}, options, known)
        except (MappingError, InputError) as error:
            metric = {"not_in_metres": error}
        models = [upright_model(model, plan.root) for model in found]
        write_models(out, models)
    if lost := [text for model in models for text in model.warnings]:
        raise ImageError(lost[0])  # the image could be read before the mapping
    return models, shared, metric


def mapped(
    batch: Batch,
    out: Path,
    options: ReconstructionOptions,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[list[pycolmap.Reconstruction], SharedMatches]:
    """Write `database.db` into the folder `out` and return COLMAP's models of it, up to scale, the
    one with the most images first, and their matches. Raises as `reconstruct` does."""
    shared = share(batch, options.per_image, progress)
    write_shared(batch, shared, out / DATABASE)
    mapping = replace(options, refine_intrinsics=refines(batch, options))
    found = map_database(out / DATABASE, batch.plan.root, mapping)
    uncertain = []
    for name, camera in batch.plan.final_cameras.items():
        is_refined = options.refine_centres and not camera.exact
        if is_refined or may_be_crop(camera):
            uncertain.append(name)
    for model in found if uncertain else ():
        adjust(model, uncertain, centres=True)
    return found, shared


def write_models(out: Path, models: Sequence[Model]) -> None:
    """Write `sparse/`, `sparse/1/`, ... and the points of the first model, replacing what is there.
    models: with COLMAP's form."""
    with replaced_folder(out / MODEL) as folder:
        for number, model in enumerate(models):
            assert model.colmap is not None
            (folder / str(number or "")).mkdir(exist_ok=True)
            model.colmap.write_binary(folder / str(number or ""))
    with replaced(out / POINTS) as temporary:
        write_points(temporary, models[0].points, models[0].colours)


def require_new(out: Path, names: Sequence[str], *, resume: bool) -> bool:
    """Whether `out` has a file of these names. Raises InputError if it has and `resume` is False,
    and if `sparse` contains files that are not part of a model."""
    there = [out / name for name in names if (out / name).exists()]
    if there and not resume:
        hint = "continues that run and replaces its result"
        raise InputError(f"{there[0]} exists already:", ArgumentName("resume"), hint)
    require_model_folder(out / MODEL, several=True)
    return bool(there)


def refines(batch: Batch, options: ReconstructionOptions) -> bool:
    """Whether bundle adjustment changes the intrinsics: by the option, or if a camera is uncertain
    and models have at least three images. Two images do not determine intrinsics."""
    stds = ((c.focal_std, c.lens_std, c.aspect_std) for c in batch.plan.cameras.values())
    unknown = options.min_images >= MIN_IMAGES and any(map(any, stds))
    return options.refine_intrinsics or unknown


def write_summary(
    out: Path,
    batch: Batch,
    models: Sequence[Model],
    shared: SharedMatches,
    metric: Mapping[str, Any],
    seconds: Mapping[str, float],
) -> dict[str, Any]:
    """Write `summary.json` and return its data. models, shared, metric: from `reconstruct`.
    seconds: by stage."""
    names = batch.plan.names
    largest = models[0]
    colmap = largest.colmap
    assert colmap is not None
    taken: dict[int, list[str]] = {}  # images by camera
    for image in colmap.images.values():
        if image.has_pose:
            taken.setdefault(image.camera_id, []).append(image.name)
    missing = {}
    for name in names:
        if not any(name in model.poses for model in models):
            rows = [row for row in batch.rows if name in row.names]
            posed = sum(row.success for row in rows)
            missing[name] = f"a pose in {posed} of its {len(rows)} pairs"
            if flipped := sum(row.status == "mirrored" for row in rows):
                missing[name] += f", mirrored in {flipped}"
            if down := sum(row.rejected for row in rows):
                missing[name] += f", rejected in {down}"
    data = {
        "images": len(names),
        "registered": len(largest.poses),
        "not_registered": [*missing],
        "not_registered_pairs": missing,
        "models": [{"images": sorted(m.poses), "points": len(m.points)} for m in models],
        "points": len(largest.points),
        "mean_track_length": round(colmap.compute_mean_track_length(), 3),
        "reprojection_error_px": round(colmap.compute_mean_reprojection_error(), 4),
        "pairs": batch.summary["pairs"],
        "poses": batch.summary["poses"],
        "rejected": batch.summary["rejected"],
        "key_points": sum(map(len, shared.key_points.values())),
        "matches": sum(map(len, shared.pairs.values())),
        "bad_images": batch.summary["bad_images"],
        "cameras": [
            {
                "model": camera.model.name,
                "width": camera.width,
                "height": camera.height,
                "params": camera.params.tolist(),
                "focal_px": float(camera.mean_focal_length()),
                "images": len(taken[number]),
                "first_image": min(taken[number]),
            }
            for number in sorted(taken)
            for camera in [colmap.cameras[number]]
        ],
        **{key: str(v) if isinstance(v, DgcPoseError) else v for key, v in metric.items()},
        "seconds": {stage: round(value, 2) for stage, value in seconds.items()},
    }
    write_json(out / SUMMARY, data)
    return data


def map_database(database: Path, images: Path, options: ReconstructionOptions) -> list[Any]:
    """COLMAP's models, the one with the most images first. Raises NoModelError without a model,
    MappingError if pycolmap fails.

    Runs in one thread: with more, models differ in their last digits.
    """
    pycolmap.set_random_seed(_SEED)
    with scratch_folder() as folder:
        try:
            run: Any = getattr(pycolmap, f"{options.mapper}_mapping")
            models = run(database, images, folder, _pipeline_options(options))
        except (RuntimeError, ValueError) as error:
            raise MappingError(f"{database}: pycolmap: {reason(error)}") from error
    if not models:
        raise NoModelError(
            f"{database}: pycolmap's {options.mapper} mapper found no model of "
            f"{options.min_images} images or more"
        )
    return sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))


def adjust(
    model: pycolmap.Reconstruction, names: Collection[str], *, centres: bool = False
) -> None:
    """Run bundle adjustment, in which only these images' cameras change their intrinsics. centres:
    whether their principal points change too."""
    images = [image for image in model.images.values() if image.has_pose]
    cameras = {image.camera_id for image in images if image.name in names}
    config = pycolmap.BundleAdjustmentConfig()
    for image in images:
        config.add_image(image.image_id)
    for camera in {*model.cameras} - cameras:
        config.set_constant_cam_intrinsics(camera)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions(refine_principal_point=centres, print_summary=False)
    options.ceres.solver_options.num_threads = 1
    options.ceres.use_gpu = False
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()


def _pipeline_options(options: ReconstructionOptions) -> Any:
    settings: Any
    refine = options.refine_intrinsics
    if options.mapper == "incremental":
        settings = pycolmap.IncrementalPipelineOptions()
        if options.min_images < MIN_IMAGES:  # a pair with an accepted pose is a model
            settings.mapper.init_min_num_inliers = settings.mapper.abs_pose_min_num_inliers
            settings.mapper.init_min_tri_angle = settings.mapper.filter_min_tri_angle
            settings.triangulation.ignore_two_view_tracks = False
        settings.ba_refine_focal_length = settings.ba_refine_extra_params = refine
        settings.mapper.abs_pose_refine_focal_length = refine
        settings.mapper.abs_pose_refine_extra_params = refine
    else:
        settings = pycolmap.GlobalPipelineOptions()
        settings.mapper.bundle_adjustment.refine_focal_length = refine
        settings.mapper.bundle_adjustment.refine_extra_params = refine
        settings.mapper.bundle_adjustment.ceres.use_gpu = False
        settings.mapper.global_positioning.use_gpu = False
    settings.min_model_size = options.min_images
    settings.num_threads = 1
    settings.random_seed = settings.mapper.random_seed = _SEED
    return settings


def known_metres(paths: Mapping[str, Path], options: ReconstructionOptions) -> KnownMetres:
    """The metric data that exist before the matching, by image name, and the name of their frame.
    With `gps`, positions (3,) in metres from the first; with `scale`, the distance for both names;
    with `marker`, what `shared_markers` finds.

    Raises InputError for fewer than three GPS positions, for positions on a line, for a `scale`
    that is not two images and metres, and if no marker is in two images.
    """
    if options.marker:
        return dict(shared_markers(paths)), _OWN_FRAME
    if options.scale:
        *pair, metres = options.scale.split(",")
        with suppress(ValueError):
            if len({*paths} & {*pair}) == len(pair) == 2 and float(metres) > 0:
                return dict.fromkeys(pair, float(metres)), _OWN_FRAME
        first = min(paths, default="")
        needed = f"must be two of the {len(paths)} images (such as {first}) and metres"
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
    model: pycolmap.Reconstruction,
    paths: Mapping[str, Path],
    options: ReconstructionOptions,
    known: KnownMetres | None = None,
) -> dict[str, Any]:
    """Bring a model into metres: by a scale factor, or with `gps` by a similarity from RANSAC.
    Returns unit, frame, errors and `warnings`, if there are any, for the summary; empty if no
    option is set. known: what `known_metres` returned for these images.

    Raises MappingError if GPS does not agree with the model; InputError for a camera of `scale`
    that is not in the model; what `known_metres` and `marker_side` raise; ImageError.
    """
    data, frame = known or known_metres(paths, options)
    centres = {i.name: i.projection_center() for i in model.images.values() if i.has_pose}
    both = [name for name in data if name in centres]
    errors: dict[str, Any] = {}
    if options.scale:
        for name in data.keys() - centres.keys():
            raise InputError(ArgumentName("scale"), f"{name} is not in the model")
        apart = np.linalg.norm(np.subtract(*(centres[name] for name in both)))
        similarity = pycolmap.Sim3d(data[both[0]] / apart, pycolmap.Rotation3d(), np.zeros(3))
    elif options.gps:
        places = np.array([data[name] for name in both]).reshape(-1, 3)
        ransac = pycolmap.RANSACOptions(max_error=_MAX_ERROR_M, random_seed=0)
        args = model, both, places, MIN_IMAGES, ransac
        aligned = pycolmap.align_reconstruction_to_locations(*args)
        if aligned is None:
            cameras = f"{len(both)} cameras to {_MAX_ERROR_M:g} m from their GPS positions"
            raise MappingError(f"no similarity brings {cameras}")
        similarity = _upright(aligned, model, np.array([centres[n] for n in both]), places)
        off = [np.linalg.norm(similarity * centres[name] - data[name]) for name in both]
        errors["median_gps_residual_m"] = round(float(np.median(off)), 3)
        errors["largest_gps_residual_m"] = round(float(max(off)), 3)
    elif options.marker:
        posed = Model.of_colmap(model, Path())
        corners = [data[name] for name in posed.poses]
        around = [_points_seen(posed, name) for name in posed.poses]
        found = marker_side(corners, [*posed.cameras.values()], [*posed.poses.values()], around)
        similarity = pycolmap.Sim3d(options.marker / found.side, pycolmap.Rotation3d(), np.zeros(3))
        errors = {"marker_images": found.images}
        if found.std is not None:
            errors["scale_relative_std"] = round(found.std, 5)
        if found.warnings:
            errors["warnings"] = [*found.warnings]
    else:
        return {}
    model.transform(similarity)
    return {"unit": "m", "frame": frame, **errors}


def _points_seen(model: Model, name: str) -> tuple[np.ndarray, np.ndarray]:
    """The normalised points (N, 2) of the model's points in an image, and their depths (N,)."""
    if name not in model.seen:
        return np.empty((0, 2)), np.empty(0)
    which, pixels = model.seen[name]
    axis = model.poses[name][2]
    return model.cameras[name].normalise(pixels), model.points[which] @ axis[:3] + axis[3]


def _upright(
    aligned: pycolmap.Sim3d, model: pycolmap.Reconstruction, centres: np.ndarray, places: np.ndarray
) -> pycolmap.Sim3d:
    """The similarity `aligned`, rotated by 180 degrees about the long axis of the camera centres
    (N, 3) if it puts cameras in a plane upside down and the rotated one fits `places` (N, 3) in
    metres as well: in a narrow survey the noise of altitudes would decide. Cameras on a line keep
    `aligned`."""
    at = aligned * centres
    _, (length, width, _), (axis, _, normal) = np.linalg.svd(at - at.mean(0), full_matrices=False)
    posed = [image.cam_from_world().rotation for image in model.images.values() if image.has_pose]
    # Down is y in an upright photograph, and z in one taken from above.
    lower = aligned.rotation * np.sum([(0, 2, 1) @ turn.matrix() for turn in posed], 0)
    half = 2 * np.outer(axis, axis) - np.eye(3)
    by_half = pycolmap.Sim3d(1.0, pycolmap.Rotation3d(half), at.mean(0) - half @ at.mean(0))
    off, off_turned = (np.median(np.linalg.norm(p - places, axis=1)) for p in (at, by_half * at))
    is_down = (lower @ normal) * normal[2] <= 0
    is_kept = is_down or width <= _MIN_WIDTH * length or off_turned > _MAX_RESIDUAL_RATIO * off
    return aligned if is_kept else by_half * aligned
