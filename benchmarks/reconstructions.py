"""Photographs of a scene with true camera poses, and reconstructions compared with them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.pair_choice import PairChoice
from dgc_pose.batch.result import Batch
from dgc_pose.batch.run import run_batch
from dgc_pose.batch.source import Source
from dgc_pose.benchmarks.camera_trial import WithheldCameras
from dgc_pose.benchmarks.metrics import folded, pose_auc
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.colmap.database import colmap_camera
from dgc_pose.colmap.mapping import MappingError, map_database
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.reconstruction import DATABASE, SparseModel, reconstruct, sparse_model
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import image_size
from dgc_pose.localization.model import PosedModel
from dgc_pose.matchers import MatcherOptions
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.system.colmap_library import pycolmap

COLMAP_SIFT = "colmap-sift"
COLUMNS = {  # of the table
    "method": "{0.method}",
    "images": "{0.images}",
    "registered": "{0.registered}",
    "R med deg": "{0.rotation_median_deg:.3f}",
    "position rms": "{0.position_rms:.4g}",
    "med": "{0.position_median:.4g}",
    "% of extent": "{0.position_percent:.3f}",
    "points": "{0.points}",
    "track length": "{0.mean_track_length:.2f}",
    "reprojection px": "{0.reprojection_error_px:.3f}",
    "f off %": "{0.focal_percent:.3f}",
    "pairs": "{0.pairs}",
    "poses": "{0.poses}",
    "AUC@5": "{0.pair_auc5:.1f}",
    "pooled f off %": "{0.pooled_focal_percent:.3f}",
    "seconds": "{0.seconds:.0f}",
}


@dataclass(frozen=True, kw_only=True)
class ReconstructionScore:
    """A model compared with the truth. NaN where nothing is known, as of the model if too few
    images are registered."""

    pairs: int = 0  # matched
    poses: int = 0  # pairs with a pose
    # Percent; of max(rotation, folded translation), infinite without a pose
    pair_auc5: float = np.nan
    pooled_focal_percent: float = np.nan  # mean error of the images' focal lengths
    method: str
    images: int
    registered: int = 0
    rotation_median_deg: float = np.nan  # of the relative rotations of all registered pairs
    position_rms: float = np.nan  # after a similarity, the truth's unit
    position_median: float = np.nan
    position_percent: float = np.nan  # position_rms over the largest distance of two cameras
    points: int = 0
    mean_track_length: float = np.nan
    reprojection_error_px: float = np.nan
    focal_percent: float = np.nan  # mean error of the images' focal lengths
    seconds: float


def run_method(
    method: str,
    views: PosedModel,
    out: Path,
    pairs: PairChoice,
    reconstruction: ReconstructionOptions,
    estimation: EstimationOptions,
    options: BatchOptions,
    withheld: WithheldCameras | None = None,
) -> ReconstructionScore:
    """Reconstruct the views by one method: `colmap-sift`, or a matcher by its name.

    Both map with the same options. The folder keeps a matcher's batch, which `resume` goes on with.
    withheld: in place of K, as of --K; bundle adjustment refines the cameras then.
    """
    out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    figures: dict[str, Any] = {}
    try:
        if method == COLMAP_SIFT:
            database, mapping = out / DATABASE, reconstruction.mapping
            database.unlink(missing_ok=True)
            sift_database(database, views.root, views.cameras, mapping.mapper_threads, withheld)
            refines = mapping.refine_intrinsics or withheld is not None
            mapping = replace(mapping, refine_intrinsics=refines)
            model = sparse_model(map_database(database, views.root, mapping)[0])
            figures["pairs"] = figures["poses"] = len(views.poses) * (len(views.poses) - 1) // 2
        else:
            batch = run_batch(
                Source(views.root, tuple(sorted(views.cameras)), None, {}),
                Calibration("the truth", views.cameras)
                if withheld is None
                else read_calibration(withheld),
                pairs,
                out / "batch",
                matcher=MatcherOptions(method),
                estimation=estimation,
                options=options,
            )
            figures = pair_figures(batch, views)
            model, _ = reconstruct(batch, out, reconstruction)
        figures |= model_figures(model, views)
    except MappingError:
        pass  # a score without a model
    seconds = time.perf_counter() - start
    images = len(views.poses)
    return ReconstructionScore(method=method, images=images, seconds=seconds, **figures)


def sift_database(
    database: Path,
    images: Path,
    cameras: Mapping[str, Camera],
    threads: int,
    withheld: WithheldCameras | None = None,
) -> None:
    """Write a new database of SIFT key points and all verified pairs, with pycolmap's defaults.

    cameras: by image name, with their sizes; the focal lengths count as known. withheld: the
    cameras are COLMAP's own guesses instead. Raises InputError if COLMAP cannot hold a camera.
    """
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    extraction.num_threads = matching.num_threads = threads
    extraction.use_gpu = matching.use_gpu = False
    modes = {"auto": "AUTO", "auto:shared": "SINGLE"}
    mode = pycolmap.CameraMode.__members__[modes.get(withheld or "", "PER_IMAGE")]
    pycolmap.extract_features(
        database, images, list(cameras), camera_mode=mode, extraction_options=extraction
    )
    if withheld is None:
        with pycolmap.Database.open(database) as opened:
            for image in opened.read_all_images():
                camera = colmap_camera(cameras[image.name], image.name)
                camera.camera_id = image.camera_id
                camera.has_prior_focal_length = True
                opened.update_camera(camera)
    pycolmap.match_exhaustive(database, matching_options=matching)


def pair_figures(batch: Batch, views: PosedModel) -> dict[str, Any]:
    """The poses and cameras of a batch compared with the true ones, by field of the score."""
    errors = []
    for row in batch.rows:
        error = np.inf
        pose = row.pose
        if pose is not None and pose.R is not None and pose.t is not None:
            first, second = views.poses[row.name1], views.poses[row.name2]
            R = second[:, :3] @ first[:, :3].T
            t = second[:, 3] - R @ first[:, 3]
            rotation = rotation_error_deg(pose.R, R)
            error = max(rotation, folded(translation_error_deg(pose.t, t)))
        errors.append(error)
    focal_lengths = [(name, camera.focal) for name, camera in batch.plan.final_cameras.items()]
    return {
        "pairs": batch.summary["pairs"],
        "poses": batch.summary["poses"],
        "pair_auc5": pose_auc(np.array(errors), (5,))[0] if errors else np.nan,
        "pooled_focal_percent": _focal_percent(focal_lengths, views),
    }


def model_figures(model: SparseModel, views: PosedModel) -> dict[str, Any]:
    """A model's cameras compared with the true ones, by field of the score."""
    names = sorted(model.poses)
    focal_lengths: list[tuple[str, float]] = []
    for camera in model.cameras:
        focal_lengths += [(camera.first_image, camera.focal_px)] * camera.images
    figures = {
        "registered": len(names),
        "points": len(model.points),
        "mean_track_length": model.mean_track_length,
        "reprojection_error_px": model.reprojection_error_px,
        "focal_percent": _focal_percent(focal_lengths, views),
    }
    if len(names) < 3:
        return figures
    rotations = [
        rotation_error_deg(
            model.poses[b][:, :3] @ model.poses[a][:, :3].T,
            views.poses[b][:, :3] @ views.poses[a][:, :3].T,
        )
        for a, b in combinations(names, 2)
    ]
    positions = position_errors(model, views, names)
    rms = float(np.sqrt((positions**2).mean()))
    return figures | {
        "rotation_median_deg": float(np.median(rotations)),
        "position_rms": rms,
        "position_median": float(np.median(positions)),
        "position_percent": 100 * rms / views.extent,
    }


def _focal_percent(focal_lengths: Iterable[tuple[str, float]], views: PosedModel) -> float:
    """Mean error of the focal lengths of images, each with its name; NaN without any."""
    errors = [abs(focal / views.cameras[name].focal - 1) for name, focal in focal_lengths]
    return 100 * float(np.mean(errors)) if errors else np.nan


def position_errors(model: SparseModel, views: PosedModel, names: Sequence[str]) -> np.ndarray:
    """Distances (N,) of the positions after the best similarity, the truth's unit."""
    centres = np.stack([model.centre(name) for name in names])
    true = np.stack([views.centre(name) for name in names])
    similarity = pycolmap.estimate_sim3d(centres, true)
    if similarity is None:
        return np.full(len(names), np.nan)
    matrix = similarity.matrix()
    return np.linalg.norm(centres @ matrix[:, :3].T + matrix[:, 3] - true, axis=1)


def views_of_list(path: Path, folder: Path) -> PosedModel:
    """The views of a SuperGlue list whose translations have one unit, chained from pair to pair.

    folder: of the images; names are those of the list relative to it. Raises InputError if the
    pairs do not connect all images.
    """
    cameras: dict[str, Camera] = {}
    steps: dict[str, list[tuple[str, np.ndarray]]] = {}  # by image, others with their poses in it
    for pair in read_pairs(path):
        name1, name2 = _relative(pair.path1, folder), _relative(pair.path2, folder)
        step = np.vstack([np.column_stack([pair.R, pair.t]), [0, 0, 0, 1]])
        steps.setdefault(name1, []).append((name2, step))
        steps.setdefault(name2, []).append((name1, np.linalg.inv(step)))
        cameras.setdefault(name1, pair.camera1)
        cameras.setdefault(name2, pair.camera2)
    reached = [min(steps)]
    poses = {reached[0]: np.eye(4)}
    for name in reached:  # grows on the way
        for other, step in steps[name]:
            if other not in poses:
                poses[other] = step @ poses[name]
                reached.append(other)
    if len(poses) < len(cameras):
        raise InputError(f"{path}: its pairs do not connect all images")
    sized = {
        name: replace(camera, size=image_size(folder / name))
        for name, camera in sorted(cameras.items())
    }
    return PosedModel(folder, sized, {name: pose[:3] for name, pose in poses.items()})


def _relative(path: Path, folder: Path) -> str:
    try:
        return path.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        raise InputError(f"{path}: not an image of the folder {folder}") from None
