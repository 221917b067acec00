"""From a finished batch to its models, points and a summary in one folder."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dgc_pose.batch.result import Batch
from dgc_pose.colmap.database import share, write_shared
from dgc_pose.colmap.mapping import MIN_IMAGES, adjust, map_database
from dgc_pose.colmap.metric import to_metres
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.tracking import SharedMatches
from dgc_pose.estimation.intrinsics_prior import is_of_part
from dgc_pose.model import Model, load_model, require_model_folder, write_points
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.files import only_writer, replaced, replaced_folder
from dgc_pose.system.texts import write_json

DATABASE, MODEL, POINTS, SUMMARY = "database.db", "sparse", "points.ply", "summary.json"
OUTPUTS = (DATABASE, MODEL, POINTS, SUMMARY)  # in the order in which they are written


def reconstruct(
    batch: Batch,
    out: Path,
    options: ReconstructionOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[list[Model], SharedMatches, dict[str, Any]]:
    """Write `database.db`, `sparse/` and `points.ply` into `out`, over what is there.

    Returns the models, that with the most images first; what they are of; and the unit and frame of
    the first as `to_metres`. The others, of further scenes, each in axes of its own, are in
    `sparse/1`, ... by their size. Bundle adjustment refines the cameras of a batch that had no
    focal length for one of them.

    Raises MappingError if COLMAP makes no model; InputError if `sparse` holds other files than a
    model's, another process writes into `out`, or no pair has a pose; both as `to_metres` too;
    ImageError if an image cannot be read any more; OSError if the disk is full.
    """
    options = options or ReconstructionOptions()
    mapping = replace(options, refine_intrinsics=refines(batch, options))
    plan = batch.plan
    require_model_folder(out / MODEL, several=True)
    out.mkdir(parents=True, exist_ok=True)
    with only_writer(out):
        shared = share(batch, options.per_image, progress)
        write_shared(batch, shared, out / DATABASE)
        found = map_database(out / DATABASE, plan.root, mapping)
        cameras, whole = plan.final_cameras.items(), options.refine_centres
        cut = [n for n, c in cameras if is_of_part(c) or (whole and not c.exact)]
        for model in found:
            if cut:
                adjust(model, cut, centres=True)
        metric = to_metres(found[0], {n: plan.root / n for n in plan.names}, options)
        with replaced_folder(out / MODEL) as folder:
            for number, model in enumerate(found):
                (folder / str(number or "")).mkdir(exist_ok=True)
                model.write_binary(folder / str(number or ""))
        models = [load_model(out / MODEL / str(n or ""), plan.root) for n in range(len(found))]
        with replaced(out / POINTS) as temporary:
            write_points(temporary, models[0].points, models[0].colours)
    return models, shared, metric


def refines(batch: Batch, options: ReconstructionOptions) -> bool:
    """Whether bundle adjustment changes the cameras: not those of two images, which do not
    determine them."""
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
    """Write `summary.json`. All but the last as of `reconstruct`. seconds: by stage. Returns its
    data."""
    names, largest = batch.plan.names, models[0]
    colmap = largest.colmap
    assert colmap is not None
    left_out = {}
    for name in names:
        if not any(name in model.poses for model in models):
            rows = [row for row in batch.rows if name in row.names]
            posed = sum(row.success for row in rows)
            left_out[name] = f"a pose in {posed} of its {len(rows)} pairs"
            if flipped := sum(row.status == "mirrored" for row in rows):
                left_out[name] += f", mirrored in {flipped}"
            if down := sum(row.turned_down for row in rows):
                left_out[name] += f", turned down in {down}"
    data = {
        "images": len(names),
        "registered": len(largest.poses),
        "not_registered": [*left_out],
        "not_registered_pairs": left_out,
        "models": [{"images": sorted(m.poses), "points": len(m.points)} for m in models],
        "points": len(largest.points),
        "mean_track_length": round(colmap.compute_mean_track_length(), 3),
        "reprojection_error_px": round(colmap.compute_mean_reprojection_error(), 4),
        "pairs": batch.summary["pairs"],
        "poses": batch.summary["poses"],
        "turned_down": batch.summary["turned_down"],
        "key_points": sum(map(len, shared.key_points.values())),
        "matches": sum(map(len, shared.pairs.values())),
        "bad_images": batch.summary["bad_images"],
        "cameras": _camera_facts(colmap),
        **metric,
        "seconds": {stage: round(value, 2) for stage, value in seconds.items()},
    }
    write_json(out / SUMMARY, data)
    return data


def _camera_facts(colmap: pycolmap.Reconstruction) -> list[dict[str, Any]]:
    """The cameras that took an image of a model, as COLMAP has them."""
    taken: dict[int, list[str]] = {}
    for image in colmap.images.values():
        if image.has_pose:
            taken.setdefault(image.camera_id, []).append(image.name)
    cameras = ((colmap.cameras[number], taken[number]) for number in sorted(taken))
    return [
        {
            "model": camera.model.name,
            "width": camera.width,
            "height": camera.height,
            "params": camera.params.tolist(),
            "focal_px": float(camera.mean_focal_length()),
            "images": len(names),
            "first_image": min(names),
        }
        for camera, names in cameras
    ]
