"""COLMAP's cameras: parameters, and distortion by pycolmap."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.geometry.radial import (
    Projection,
    distorted,
    projected,
    undistorted,
    unprojected,
)

if TYPE_CHECKING:
    import pycolmap


# Error of a point after undistortion and distortion, in focal lengths: 0.01 px at f = 1000 px.
_MAX_ROUND_TRIP_ERROR = 1e-5
# Skew and fx - fy over the focal length: rounding in a calibration, below 0.01 px in the image.
_MOST_SKEW = 1e-5
_MOST_FOCAL_DIFFERENCE = 1e-6
# Models without a lens; they need no import of pycolmap.
_PINHOLES = {"SIMPLE_PINHOLE": ["f", "cx", "cy"], "PINHOLE": ["fx", "fy", "cx", "cy"]}
RADIAL = "RADIAL"
FISHEYE = "OPENCV_FISHEYE"
CYLINDER = "CYLINDER"
# For a model with one focal length: the same with two, and its number of coefficients.
_TWO_FOCALS = {
    "SIMPLE_RADIAL": ("OPENCV", 4),
    "RADIAL": ("OPENCV", 4),
    "SIMPLE_RADIAL_FISHEYE": ("OPENCV_FISHEYE", 4),
    "RADIAL_FISHEYE": ("OPENCV_FISHEYE", 4),
    "SIMPLE_DIVISION": ("DIVISION", 1),
    "SIMPLE_FISHEYE": ("FISHEYE", 0),
}


class OwnLens(NamedTuple):
    """A lens that is computed without pycolmap."""

    coefficients: int  # their number
    # The functions of `Distortion`, of points (N, 2) float64 and the coefficients.
    undo: Callable[[np.ndarray, Sequence[float]], np.ndarray]
    apply: Callable[[np.ndarray, Sequence[float]], np.ndarray]
    # In `geometry.radial`, which also has the derivatives. Coefficients after the second must be
    # zero: pycolmap computes the lens otherwise.
    projection: Projection | None = None


def _radial_lens(projection: Projection, coefficients: int) -> OwnLens:
    def undo(points: np.ndarray, coefficients: Sequence[float]) -> np.ndarray:
        return unprojected(undistorted(points, _first_two(coefficients)), projection)

    def apply(points: np.ndarray, coefficients: Sequence[float]) -> np.ndarray:
        return distorted(projected(points, projection), _first_two(coefficients))

    return OwnLens(coefficients, undo, apply, projection)


def _first_two(coefficients: Sequence[float]) -> tuple[float, float]:
    first, second = (*coefficients, 0.0, 0.0)[:2]
    return first, second


# COLMAP has no CYLINDER: a camera with a lens that COLMAP lacks cannot be exported.
_OWN: Mapping[str, OwnLens] = {
    RADIAL: _radial_lens("plane", 2),
    FISHEYE: _radial_lens("angles", 4),
    CYLINDER: _radial_lens("cylinder", 0),
}


@dataclass(frozen=True)
class Distortion:
    """Lens distortion by one of COLMAP's models, in normalised coordinates, independent of K.

    Raises InputError if COLMAP has no such model, or if the coefficients do not fit it.

    Attributes:
        model: COLMAP's name, such as "OPENCV" or "SIMPLE_RADIAL".
        coefficients: The parameters after focal length and principal point.
    """

    model: str
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        names = ""
        own = _OWN.get(self.model)
        expected = -1 if own is None else own.coefficients
        if len(self.coefficients) != expected:
            camera = _model(self.model)
            names = camera.params_info
            expected = len(camera.extra_params_idxs())
        if len(self.coefficients) != expected:
            raise InputError(
                f"{self.model} takes {expected} coefficients ({names}), "
                f"not {len(self.coefficients)}"
            )
        if not np.isfinite(self.coefficients).all():
            raise InputError(f"{self.model} has coefficients that are not finite")

    @property
    def projection(self) -> Projection | None:
        """The projection in `geometry.radial`; None for a lens of another kind."""
        return None if self._own is None else self._own.projection

    @property
    def _own(self) -> OwnLens | None:
        """How the lens is computed here; None if pycolmap computes it."""
        own = _OWN.get(self.model)
        if own is None or (own.projection is not None and any(self.coefficients[2:])):
            return None
        return own

    @property
    def radial(self) -> tuple[float, float]:
        """The coefficients for `geometry.radial`."""
        return _first_two(self.coefficients)

    def undo(self, points: np.ndarray) -> np.ndarray:
        """Undistort normalised points (N, 2), to x / z and y / z float64.

        NaN where the model has no inverse: for rays at 90 degrees or more from the axis, and beyond
        the radius at which the distorted radius stops growing.
        """
        if self._own is not None:
            return self._own.undo(np.asarray(points, np.float64), self.coefficients)
        ideal = np.asarray(self._camera().cam_from_img(np.ascontiguousarray(points)))
        undone = np.abs(self.apply(ideal) - points).max(axis=1, initial=0) <= _MAX_ROUND_TRIP_ERROR
        return np.where(undone[:, None], ideal, np.nan)

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Distort normalised points (N, 2), x / z and y / z, to float64."""
        if self._own is not None:
            return self._own.apply(np.asarray(points, np.float64), self.coefficients)
        return np.asarray(
            self._camera().img_from_cam(np.column_stack([points, np.ones(len(points))]))
        )

    def _camera(self) -> pycolmap.Camera:
        """A camera of focal length 1 with the principal point (0, 0)."""
        camera = _model(self.model)
        parameters = np.zeros(len(camera.params))
        parameters[camera.focal_length_idxs()] = 1
        parameters[camera.extra_params_idxs()] = self.coefficients
        camera.params = parameters.tolist()
        return camera


def intrinsics(model: str, parameters: list[float]) -> tuple[np.ndarray, Distortion | None]:
    """K (3, 3) and the distortion (None for a pinhole) from COLMAP's parameter list.

    The principal point is half a pixel less than in the list. Raises InputError if COLMAP has no
    such model, or if the number of parameters does not fit it.
    """
    layout = _PINHOLES.get(model) or _model(model).params_info.split(", ")
    if len(parameters) != len(layout):
        raise InputError(
            f"{model} takes {len(layout)} parameters ({', '.join(layout)}), not {len(parameters)}"
        )
    focals = 2 if layout[0] == "fx" else 1  # the principal point and the coefficients follow
    cx, cy, *coefficients = parameters[focals:]
    K = np.array([[parameters[0], 0, cx - 0.5], [0, parameters[focals - 1], cy - 0.5], [0, 0, 1]])
    return K, None if model in _PINHOLES else Distortion(model, tuple(coefficients))


def parameters(K: np.ndarray, distortion: Distortion | None) -> tuple[str, list[float]]:
    """COLMAP's model and parameters of a camera; the inverse of `intrinsics`.

    The model is PINHOLE without a distortion. A model with one focal length is replaced by the one
    with two if K has two. Raises InputError for a K with a skew, which COLMAP does not support.
    """
    fx = float(K[0, 0])
    fy = float(K[1, 1])
    skew = float(K[0, 1])
    if abs(skew) > _MOST_SKEW * fx:
        raise InputError(f"K has a skew of {skew:g}, which COLMAP cannot hold")
    model = "PINHOLE" if distortion is None else distortion.model
    coefficients = () if distortion is None else distortion.coefficients
    focals = [fx, fy]
    if distortion is not None and len(_model(model).focal_length_idxs()) == 1:
        if abs(fx - fy) > _MOST_FOCAL_DIFFERENCE * fx:
            model, count = _TWO_FOCALS[model]
            coefficients = (*coefficients, *[0.0] * (count - len(coefficients)))
        else:
            focals = [fx]
    return model, [*focals, float(K[0, 2]) + 0.5, float(K[1, 2]) + 0.5, *coefficients]


def model_of_id(model_id: int) -> tuple[str, int]:
    """The name and number of parameters of a model in COLMAP's binary files. Raises InputError."""
    from dgc_pose.system.colmap_library import pycolmap

    names = {int(value): name for name, value in pycolmap.CameraModelId.__members__.items()}
    name = names.get(model_id, f"model {model_id}")
    return name, len(_model(name).params)


def _model(name: str) -> pycolmap.Camera:
    """A camera of this model with arbitrary parameters."""
    from dgc_pose.system.colmap_library import pycolmap

    if name != "INVALID" and name in pycolmap.CameraModelId.__members__:
        camera = pycolmap.Camera.create_from_model_name(0, name, 1.0, 1, 1)
        if len(camera.focal_length_idxs()):
            return camera
    raise InputError(f"{name!r} is not a COLMAP model with a focal length, such as OPENCV")
