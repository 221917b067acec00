"""A reconstruction from a COLMAP database, by pycolmap's incremental or global mapper."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import DgcPoseError, reason
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.files import scratch_folder

MIN_IMAGES = 3  # of a model
_SEED = 0


class MappingError(DgcPoseError):
    """COLMAP made no model."""


def map_database(database: Path, images: Path, options: ReconstructionOptions) -> list[Any]:
    """COLMAP's models, that with the most images first. Raises MappingError if there is none.

    One thread alone: with more, models differ in their last digits.
    """
    pycolmap.set_random_seed(_SEED)
    with scratch_folder() as folder:
        try:
            run: Any = getattr(pycolmap, f"{options.mapper}_mapping")
            models = run(database, images, folder, _pipeline_options(options))
        except (RuntimeError, ValueError) as error:
            raise MappingError(f"{database}: pycolmap: {reason(error)}") from error
    if not models:
        raise MappingError(
            f"{database}: pycolmap's {options.mapper} mapper made no model of {options.min_images} "
            "images"
        )
    return sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))


def adjust(
    model: pycolmap.Reconstruction, names: Collection[str], *, centres: bool = False
) -> None:
    """Bundle adjustment of a model, which changes the cameras of these images, and keeps all other
    cameras. centres: whether it changes their principal points too."""
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
        if options.min_images < MIN_IMAGES:  # a pair whose pose holds is a model
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
    settings.min_model_size, settings.num_threads = options.min_images, 1
    settings.random_seed = settings.mapper.random_seed = _SEED
    return settings
