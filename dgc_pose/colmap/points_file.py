"""Points with colours as PLY, as COLMAP writes them."""

from pathlib import Path

import numpy as np

from dgc_pose.errors import DgcPoseError
from dgc_pose.system.colmap_library import pycolmap

_POINT_BYTES = 15  # three floats and three colours


def write_points(file: Path, points: np.ndarray, colours: np.ndarray, name: str | Path) -> None:
    """Write points (N, 3) and their colours (N, 3) uint8 RGB. Raises as `write_model_points`."""
    model = pycolmap.Reconstruction()
    for point, colour in zip(points, colours, strict=True):
        model.add_point3D(point, pycolmap.Track(), colour)
    write_model_points(file, model, name)


def write_model_points(file: Path, model: pycolmap.Reconstruction, name: str | Path) -> None:
    """Write the points of a model.

    Raises DgcPoseError, with the output's name, if the file is not whole: COLMAP raises nothing for
    a full disk.
    """
    model.export_PLY(file)
    size, least = file.stat().st_size, _POINT_BYTES * model.num_points3D()
    if size < least:
        raise DgcPoseError(f"{name}: {size} of {least} bytes were written")
