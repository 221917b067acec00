"""From a finished batch to its models, points and a summary in one folder."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.result import Batch
from dgc_pose.colmap.export import Exported, share, write_shared
from dgc_pose.colmap.mapping import MappingError, map_database, refine_centres
from dgc_pose.colmap.metric import to_metres
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.points_file import write_model_points
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.intrinsics_prior import is_of_part
from dgc_pose.files.json_files import write_json
from dgc_pose.files.outputs import only_writer, replaced, replaced_folder, require_room
from dgc_pose.system.colmap_library import pycolmap

DATABASE, MODEL, POINTS, SUMMARY = "database.db", "sparse", "points.ply", "summary.json"
OUTPUTS = (DATABASE, MODEL, POINTS, SUMMARY)  # in the order in which they are written
_KEY_POINT_BYTES, _POINT_BYTES = 40, 120  # more than a model and its point file take for each
_MODEL_FILES = {"cameras", "images", "points3D", "frames", "rigs", "project"}  # without endings


@dataclass(frozen=True)
class ModelCamera:
    """A camera of a model, as COLMAP has it: (0, 0) is the corner of the top-left pixel."""

    model: str  # COLMAP's name
    width: int
    height: int
    params: tuple[float, ...]
    focal_px: float
    images: int  # that it took
    first_image: str


@dataclass(frozen=True, eq=False)
class SparseModel:
    """Cameras and points, in the model's unit and axes. Pixels have (0, 0) at the first pixel's
    centre."""

    poses: Mapping[str, np.ndarray]  # cam_from_world (3, 4) by image name
    points: np.ndarray  # (N, 3) float64
    colours: np.ndarray  # (N, 3) uint8, RGB
    mean_track_length: float
    reprojection_error_px: float  # mean over the observations
    cameras: tuple[ModelCamera, ...]
    shapes: Mapping[str, np.ndarray]  # width and height (2,) over the focal length by image name
    metric: Mapping[str, Any] = field(default_factory=dict)  # unit and frame, see `to_metres`
    others: tuple["SparseModel", ...] = ()  # smaller ones of the same batch, each in its own axes

    def centre(self, name: str) -> np.ndarray:
        """Position (3,) of a camera."""
        pose = self.poses[name]
        return -pose[:, :3].T @ pose[:, 3]


def reconstruct(
    batch: Batch,
    out: Path,
    options: ReconstructionOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[SparseModel, Exported]:
    """Write `database.db`, `sparse/` and `points.ply` into `out`, over what is there.

    The model is that with the most images; its `others`, of further scenes, are in `sparse/1`, ...
    by their size. Bundle adjustment refines the cameras of a batch that had no focal length for
    one of them.

    Raises MappingError if COLMAP makes no model; InputError if `sparse` holds other files than a
    model's, another process writes into `out`, or no pair has a pose; both as `to_metres` too;
    ImageError if an image cannot be read any more; OSError if the disk is full.
    """
    options = options or ReconstructionOptions()
    mapping = replace(options.mapping, refine_intrinsics=refines(batch, options))
    require_model_folder(out / MODEL, several=True)
    out.mkdir(parents=True, exist_ok=True)
    with only_writer(out):
        try:
            shared, pairs = share(batch, options.per_image, progress)
            exported = write_shared(batch, shared, pairs, out / DATABASE)
            found = map_database(out / DATABASE, batch.plan.root, mapping)
        except (InputError, MappingError) as error:
            raise type(error)(*error.args, *_what_stays(batch)) from error
        cut = [name for name, c in batch.plan.final_cameras.items() if is_of_part(c)]
        for model in found:
            refine_centres(model, cut, mapping.mapper_threads)
        metric = to_metres(found[0], batch.plan.root, batch.plan.names, options)
        # pycolmap raises nothing for a disk that is full.
        points = _POINT_BYTES * sum(model.num_points3D() for model in found)
        require_room(out / MODEL, _KEY_POINT_BYTES * len(found) * exported.key_points + points)
        with replaced_folder(out / MODEL) as folder:
            for number, model in enumerate(found):
                (folder / str(number or "")).mkdir(exist_ok=True)
                model.write_binary(folder / str(number or ""))
        with replaced(out / POINTS) as temporary:
            write_model_points(temporary, found[0], out / POINTS)
    largest, *others = map(sparse_model, found)
    return replace(largest, metric=metric, others=tuple(others)), exported


def refines(batch: Batch, options: ReconstructionOptions) -> bool:
    """Whether bundle adjustment changes the cameras."""
    stds = ((c.focal_std, c.lens_std, c.aspect_std) for c in batch.plan.cameras.values())
    return options.mapping.refine_intrinsics or any(map(any, stds))


def _what_stays(batch: Batch) -> tuple[str, ...]:
    """The end of a message, if in most pairs most matches stay within a pixel; else nothing."""
    found = (pair.matches for pair in batch.pairs() if len(pair.matches))
    count = sum(np.median(np.hypot(*(m.points2 - m.points1).T)) < 1 for m in found)
    facts = f"(in {count} of {len(batch.rows)} pairs most matches stay at the same pixels:"
    end = (facts, ArgumentName("masks"), "leaves a background that stands still out)")
    return end if 2 * count > len(batch.rows) else ()


def require_model_folder(folder: Path, *, several: bool = False) -> None:
    """Raise InputError unless this is a folder of nothing but a model's files, or not there.

    several: whether it may have the folders 1, 2, ... of further models.
    """
    inside = [*folder.rglob("*")]
    models = {folder / str(number) for number in range(1, several * len(inside))}
    own = (path in models if path.is_dir() else path.stem in _MODEL_FILES for path in inside)
    if not all(own) or (folder.exists() and not folder.is_dir()):
        raise InputError(f"{folder}: holds other files than those of a model, and is kept")


def sparse_model(reconstruction: pycolmap.Reconstruction) -> SparseModel:
    """COLMAP's model as arrays, with the cameras that took an image of it."""
    points = list(reconstruction.points3D.values())
    images = [image for image in reconstruction.images.values() if image.has_pose]
    taken: dict[int, list[str]] = {}  # the images of each camera
    for image in images:
        taken.setdefault(image.camera_id, []).append(image.name)
    return SparseModel(
        poses={image.name: np.array(image.cam_from_world().matrix()) for image in images},
        points=np.array([point.xyz for point in points]).reshape(-1, 3),
        colours=np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3),
        mean_track_length=float(reconstruction.compute_mean_track_length()),
        reprojection_error_px=float(reconstruction.compute_mean_reprojection_error()),
        cameras=tuple(
            ModelCamera(
                camera.model.name,
                int(camera.width),
                int(camera.height),
                tuple(camera.params.tolist()),
                float(camera.mean_focal_length()),
                len(taken[number]),
                min(taken[number]),
            )
            for number, camera in sorted(reconstruction.cameras.items())
            if number in taken
        ),
        shapes={
            image.name: np.divide([camera.width, camera.height], camera.mean_focal_length())
            for image in images
            for camera in [image.camera]
        },
    )


def write_summary(
    out: Path, batch: Batch, model: SparseModel, exported: Exported, seconds: Mapping[str, float]
) -> dict[str, Any]:
    """Write `summary.json`. seconds: by stage. Returns its data."""
    names, models = batch.plan.names, (model, *model.others)
    left_out = {}
    for name in names:
        if not any(name in each.poses for each in models):
            rows = [row for row in batch.rows if name in row.names]
            posed = sum(row.success for row in rows)
            left_out[name] = f"a pose in {posed} of its {len(rows)} pairs"
            if flipped := sum(row.status == "mirrored" for row in rows):
                left_out[name] += f", mirrored in {flipped}"
    data = {
        "images": len(names),
        "registered": len(model.poses),
        "not_registered": [*left_out],
        "not_registered_pairs": left_out,
        "models": [{"images": sorted(m.poses), "points": len(m.points)} for m in models],
        "points": len(model.points),
        "mean_track_length": round(model.mean_track_length, 3),
        "reprojection_error_px": round(model.reprojection_error_px, 4),
        "pairs": batch.summary["pairs"],
        "poses": batch.summary["poses"],
        "key_points": exported.key_points,
        "matches": exported.matches,
        "tracks_by_length": exported.tracks_by_length,
        "bad_images": batch.summary["bad_images"],
        "cameras": [asdict(camera) for camera in model.cameras],
        **model.metric,
        "seconds": {stage: round(value, 2) for stage, value in seconds.items()},
    }
    write_json(out / SUMMARY, data)
    return data
