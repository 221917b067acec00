"""Models with known cameras: compare reconstructions with them, and locate their images."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.result import Batch
from dgc_pose.batch.run import run_batch
from dgc_pose.batch.source import PairChoice, Source
from dgc_pose.benchmarks.evaluate import folded, pose_auc
from dgc_pose.benchmarks.report import Columns, Summary
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera, colmap_camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.reconstruction import DATABASE, MappingError, map_database, reconstruct
from dgc_pose.errors import ImageError, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.decoding import image_size
from dgc_pose.localization.locate import Locator
from dgc_pose.matchers import MatcherOptions
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.model import Model, load_model
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.training.posed_frames import read_rgbd

COLMAP_SIFT = "colmap-sift"
# The figures of a model compared with the truth; NaN if unknown, for example without enough images.
COLUMNS: Columns = {
    "images": ("images", 0),
    "registered": ("registered", 0),
    "R med deg": ("rotation_median_deg", 3),  # of relative rotations, all registered pairs
    "position rms": ("position_rms", 5),  # after a similarity, in the truth's unit
    "med": ("position_median", 5),
    "% of extent": ("position_percent", 3),  # rms over the largest distance between cameras
    "points": ("points", 0),
    "track length": ("mean_track_length", 2),
    "reprojection px": ("reprojection_error_px", 3),
    "f off %": ("focal_percent", 3),  # mean error of focal length over the images
    "pairs": ("pairs", 0),  # matched
    "poses": ("poses", 0),  # pairs with a pose
    # Percent, of max(rotation, folded translation); infinite error without a pose
    "AUC@5": ("pair_auc5", 1),
    "seconds": ("seconds", 0),
}
_CLAIMS = (0.5, 0.9, 0.99)  # least probabilities for which the precision is reported


def true_model(path: Path, images: Path | None) -> Model:
    """Read a model (see `load_model`), a list of pairs in SuperGlue's format (see `views_of_list`),
    or a folder of posed RGB-D images (see `read_rgbd`).

    images: default for a list: the folder with its name; for a model: images/ in or beside it.
    Raises ImageError if an image that is there cannot be used; what `load_model` raises.
    """
    if path.is_file() and path.suffix == ".txt":
        return views_of_list(path, images or path.parent / path.stem.removesuffix("_pairs"))
    if (path / "poses.txt").is_file():
        frames = {frame.image.name: frame for frame in read_rgbd(path)}
        cameras = {n: replace(f.camera, size=image_size(f.image)) for n, f in frames.items()}
        poses = {name: frame.cam_from_world[:3] for name, frame in frames.items()}
        return Model(path / "images", cameras, poses)
    model = load_model(path, images or path / "images")
    if model.bad:
        raise ImageError("; ".join(model.bad.values()))
    return model


def views_of_list(path: Path, folder: Path) -> Model:
    """Chain the poses of a SuperGlue list from pair to pair; all translations must have one unit.

    folder: the images' folder; the model's names are relative to it. Raises InputError if the pairs
    do not connect all images.
    """
    cameras: dict[str, Camera] = {}
    steps: dict[str, list[tuple[str, np.ndarray]]] = {}  # by image: other, other_from_image
    for pair in read_pairs(path):
        name1 = _name_in(folder, pair.path1)
        name2 = _name_in(folder, pair.path2)
        step = np.vstack([np.column_stack([pair.R, pair.t]), [0, 0, 0, 1]])
        steps.setdefault(name1, []).append((name2, step))
        steps.setdefault(name2, []).append((name1, np.linalg.inv(step)))
        cameras.setdefault(name1, pair.camera1)
        cameras.setdefault(name2, pair.camera2)
    reached = [min(steps)]
    poses = {reached[0]: np.eye(4)}
    for name in reached:  # grows in the loop
        for other, step in steps[name]:
            if other not in poses:
                poses[other] = step @ poses[name]
                reached.append(other)
    if len(poses) < len(cameras):
        raise InputError(f"{path}: its pairs do not connect all images")
    sized = {n: replace(c, size=image_size(folder / n)) for n, c in sorted(cameras.items())}
    return Model(folder, sized, {name: pose[:3] for name, pose in poses.items()})


def _name_in(folder: Path, path: Path) -> str:
    try:
        return path.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        raise InputError(f"{path}: not an image of the folder {folder}") from None


def run_method(
    method: str,
    views: Model,
    out: Path,
    pairs: PairChoice,
    reconstruction: ReconstructionOptions,
    estimation: EstimationOptions,
    options: BatchOptions,
) -> Summary:
    """Reconstruct the views with `colmap-sift` or a matcher; return the figures of COLUMNS.

    All methods use the true K and the same mapping options. The folder keeps a matcher's batch,
    which `resume` continues.
    """
    out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    count = len(views.poses)
    figures: dict[str, Any] = dict.fromkeys((name for name, _ in COLUMNS.values()), np.nan)
    figures |= {"method": method, "images": count, "registered": 0}
    try:
        if method == COLMAP_SIFT:
            database = out / DATABASE
            database.unlink(missing_ok=True)
            sift_database(database, views, options.worker_count)
            mapped = map_database(database, views.root, reconstruction)
            model = Model.of_colmap(mapped[0], views.root)
            figures["pairs"] = figures["poses"] = count * (count - 1) // 2
        else:
            batch = run_batch(
                Source(views.root, tuple(sorted(views.cameras)), None, {}),
                Calibration("the truth", views.cameras),
                pairs,
                out / "batch",
                matcher=MatcherOptions(method),
                estimation=estimation,
                options=options,
            )
            figures |= pair_figures(batch, views)
            (model, *_), *_ = reconstruct(batch, out, reconstruction)
        figures |= model_figures(model, views)
    except MappingError:
        pass  # the figures of a model stay NaN
    return figures | {"seconds": time.perf_counter() - start}


def sift_database(database: Path, views: Model, threads: int) -> None:
    """Write a database of SIFT key points and all verified pairs, with pycolmap's defaults.

    The focal lengths count as known. Raises InputError if COLMAP has no model for a camera.
    """
    extraction = pycolmap.FeatureExtractionOptions()
    matching = pycolmap.FeatureMatchingOptions()
    extraction.num_threads = matching.num_threads = threads
    extraction.use_gpu = matching.use_gpu = False
    mode = pycolmap.CameraMode.PER_IMAGE
    names = list(views.cameras)
    pycolmap.extract_features(
        database, views.root, names, camera_mode=mode, extraction_options=extraction
    )
    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            camera = colmap_camera(views.cameras[image.name], image.name)
            camera.camera_id = image.camera_id
            camera.has_prior_focal_length = True
            opened.update_camera(camera)
    pycolmap.match_exhaustive(database, matching_options=matching)


def pair_figures(batch: Batch, views: Model) -> dict[str, Any]:
    """The poses of a batch compared with the true ones, by name."""
    errors = []
    for row in batch.rows:
        error = np.inf
        pose = row.pose
        if pose is not None and pose.R is not None and pose.t is not None:
            R, t = _relative(views, row.name1, row.name2)
            rotation = rotation_error_deg(pose.R, R)
            error = max(rotation, folded(translation_error_deg(pose.t, t)))
        errors.append(error)
    return {
        "pairs": batch.summary["pairs"],
        "poses": batch.summary["poses"],
        "pair_auc5": pose_auc(errors, 5) if errors else np.nan,
    }


def model_figures(model: Model, views: Model) -> dict[str, Any]:
    """A model's cameras compared with the true ones, by name."""
    names = sorted(model.poses)
    off = [abs(c.focal / views.cameras[name].focal - 1) for name, c in model.cameras.items()]
    figures = {
        "registered": len(names),
        "points": len(model.points),
        "focal_percent": 100 * float(np.mean(off)),
    }
    if model.colmap is not None:
        figures["mean_track_length"] = model.colmap.compute_mean_track_length()
        figures["reprojection_error_px"] = model.colmap.compute_mean_reprojection_error()
    if len(names) < 3:
        return figures
    rotations = [
        rotation_error_deg(_relative(model, *pair)[0], _relative(views, *pair)[0])
        for pair in combinations(names, 2)
    ]
    # Distances between estimated and true positions, after the best similarity.
    centres = np.stack([model.centre(name) for name in names])
    true = np.stack([views.centre(name) for name in names])
    similarity = pycolmap.estimate_sim3d(centres, true)
    positions = np.full(len(names), np.nan)
    if similarity is not None:
        positions = np.linalg.norm([similarity * centre for centre in centres] - true, axis=1)
    rms = float(np.sqrt((positions**2).mean()))
    return figures | {
        "rotation_median_deg": float(np.median(rotations)),
        "position_rms": rms,
        "position_median": float(np.median(positions)),
        "position_percent": 100 * rms / views.extent,
    }


def _relative(model: Model, name1: str, name2: str) -> tuple[np.ndarray, np.ndarray]:
    """R (3, 3) and t (3,) of cam2_from_cam1."""
    pose1 = model.poses[name1]
    pose2 = model.poses[name2]
    R = pose2[:, :3] @ pose1[:, :3].T
    return R, pose2[:, 3] - R @ pose1[:, 3]


def thinned(items: Sequence[str], count: int | None) -> list[str]:
    """`count` of the items, evenly chosen; all if `count` is None."""
    most = len(items) if count is None else min(count, len(items))
    return [items[int(i)] for i in np.linspace(0, len(items) - 1, most)]


def placed(locator: Locator, name: str, apart: int) -> dict[str, Any]:
    """Locate an image of the model; return its figures, NaN if unknown.

    The database images are those at least `apart` away in the order of names. Positions are in the
    model's unit.
    """
    model = locator.model
    start = time.perf_counter()
    names = sorted(model.poses)
    number = names.index(name)
    out = names[max(0, number - apart + 1) : number + apart]
    location = locator.locate(model.root / name, model.cameras[name], excluded=out)
    figures = {
        "name": name,
        "status": location.status,
        "probability": np.nan if location.probability is None else location.probability,
        "database_images": len(location.database_images),  # matched ones
        "seconds": time.perf_counter() - start,
        "pair_seconds": location.seconds["match"],  # part of the above
        "rotation_deg": np.nan,
        "position": np.nan,
        "position_percent": np.nan,  # of the extent
        "rotation_error_90_deg": location.rotation_error_90_deg or np.nan,  # expected
        "position_error_90": location.position_error_90 or np.nan,
    }
    if location.R is not None and location.centre is not None:
        position = float(np.linalg.norm(location.centre - model.centre(name)))
        figures["rotation_deg"] = rotation_error_deg(location.R, model.poses[name][:, :3])
        figures |= {"position": position, "position_percent": 100 * position / model.extent}
    return figures


def location_report(queries: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Name and value of each figure over queries; each query is a result of `placed`."""
    column = {name: np.array([query[name] for query in queries]) for name in queries[0]}
    rotation = column["rotation_deg"]
    position = column["position"]
    located = column["status"] == "located"
    right = (rotation < 5) & (column["position_percent"] < 5)
    counted = {
        "located": located,
        "right: within 5 deg and 5 % of the extent": right,
        "within 2 deg and 0.05 of the unit": (rotation < 2) & (position < 0.05),
        **{
            f"right of those at {least:g} or more": right[column["probability"] >= least]
            for least in _CLAIMS
        },
        "R within its expected error": (rotation < column["rotation_error_90_deg"])[located],
        "position within its expected error": (position < column["position_error_90"])[located],
    }
    seconds = column["seconds"]
    pair_seconds = column["pair_seconds"]
    matched = pair_seconds > 0
    medians = {
        "R, median, deg": rotation[located],
        "position, median, % of the extent": column["position_percent"][located],
        "position, median, unit": position[located],
        "database images, median": column["database_images"],
        "seconds, median": seconds,
        "seconds over pair seconds, median": seconds[matched] / pair_seconds[matched],
    }
    lines = [(name, f"{flags.sum()} of {len(flags)}") for name, flags in counted.items()]
    return lines + [
        (name, f"{np.median(values):.3g}" if len(values) else "-")
        for name, values in medians.items()
    ]
