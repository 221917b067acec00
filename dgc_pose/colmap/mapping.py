"""A reconstruction from a COLMAP database, by pycolmap's incremental or global mapper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from dgc_pose.errors import DgcPoseError, reason
from dgc_pose.files.outputs import scratch_folder

if TYPE_CHECKING:
    import pycolmap

MapperName = Literal["incremental", "global"]
LEAST_IMAGES = 3  # of a model


@dataclass(frozen=True)
class MappingOptions:
    """How images are mapped."""

    mapper: MapperName = "incremental"
    refine_intrinsics: bool = False  # focal lengths and distortion, in bundle adjustment
    seed: int = 0
    threads: int = 1  # with more, models differ in their last digits; -1: all cores


class MappingError(DgcPoseError):
    """No reconstruction was found."""


def map_database(database: Path, images: Path, options: MappingOptions) -> pycolmap.Reconstruction:
    """The model with the most images. Raises MappingError if there is none."""
    from dgc_pose.system.colmap_library import pycolmap

    pycolmap.set_random_seed(options.seed)
    with scratch_folder() as folder:
        try:
            if options.mapper == "incremental":
                models = pycolmap.incremental_mapping(
                    database, images, folder, _incremental(options)
                )
            else:
                models = pycolmap.global_mapping(database, images, folder, _global(options))
        except (RuntimeError, ValueError) as error:
            raise MappingError(f"{database}: pycolmap: {reason(error)}") from error
    if not models:
        raise MappingError(
            f"{database}: pycolmap's {options.mapper} mapper made no model of {LEAST_IMAGES} images"
        )
    return max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()))


def _incremental(options: MappingOptions) -> pycolmap.IncrementalPipelineOptions:
    from dgc_pose.system.colmap_library import pycolmap

    made = pycolmap.IncrementalPipelineOptions()
    made.min_model_size = LEAST_IMAGES
    made.ba_refine_focal_length = options.refine_intrinsics
    made.ba_refine_extra_params = options.refine_intrinsics
    made.num_threads = options.threads
    made.random_seed = options.seed
    made.mapper.abs_pose_refine_focal_length = options.refine_intrinsics
    made.mapper.abs_pose_refine_extra_params = options.refine_intrinsics
    made.mapper.random_seed = options.seed
    return made


def _global(options: MappingOptions) -> pycolmap.GlobalPipelineOptions:
    from dgc_pose.system.colmap_library import pycolmap

    made = pycolmap.GlobalPipelineOptions()
    made.min_model_size = LEAST_IMAGES
    made.num_threads = options.threads
    made.random_seed = options.seed
    made.mapper.random_seed = options.seed
    made.mapper.bundle_adjustment.refine_focal_length = options.refine_intrinsics
    made.mapper.bundle_adjustment.refine_extra_params = options.refine_intrinsics
    made.mapper.bundle_adjustment.ceres.use_gpu = False
    made.mapper.global_positioning.use_gpu = False
    return made
