"""A camera: its intrinsic matrix K, the image size that K refers to, and its lens distortion.

The centre of the top-left pixel is (0, 0); in COLMAP it is (0.5, 0.5).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from dgc_pose.cameras.colmap_camera import RADIAL, Distortion, intrinsics, parameters
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.geometry.pixels import Size, rescale, turn_points
from dgc_pose.system.arrays import as_numpy
from dgc_pose.system.options import check_type

if TYPE_CHECKING:
    import pycolmap

FocalSource = Literal["given", "exif", "size", "lines", "matches"]
# Grid of ln(f over the longer side) at which the likelihood of the lines is evaluated.
LOG_FOCALS = np.linspace(math.log(0.3), math.log(8.0), 42)
LOGS = np.arange(math.log(0.1), math.log(25.0), 0.01)  # ln(f over the longer side)


class Part(NamedTuple):
    """A normal distribution of ln f, with f over the longer side of the image."""

    log_weight: float  # log-probability of the part, up to a constant
    log_focal: float
    std: float

    def log_density(self, log_focals: np.ndarray | float) -> Any:
        """The logarithms of the density at ln f, times the weight, up to a constant."""
        off = (log_focals - self.log_focal) / self.std
        return self.log_weight - math.log(self.std) - off**2 / 2

    def given(self, lines: np.ndarray) -> Part:
        """Update the part with the log-likelihoods (G,) of the lines on `LOG_FOCALS`; the weight
        includes the evidence."""
        odds = np.interp(LOGS, LOG_FOCALS, lines)
        odds -= ((LOGS - self.log_focal) / self.std) ** 2 / 2
        density = np.exp(odds - odds.max())
        total = float(density.sum())
        mean = float(density @ LOGS) / total
        std = math.sqrt(float(density @ (LOGS - mean) ** 2) / total)
        evidence = float(odds.max()) + math.log(total * (LOGS[1] - LOGS[0]) / self.std)
        return Part(self.log_weight + evidence - math.log(2 * math.pi) / 2, mean, std)


@dataclass(frozen=True, eq=False)
class FocalPrior:
    """The prior of ln f, for a camera without a given K: a mixture of two parts, and the lines."""

    usual: Part  # from EXIF data, or for most photographs
    tail: Part  # for other lenses, or for files with the EXIF data of another image
    lines: np.ndarray  # (G,) log-likelihoods of the image's lines on `LOG_FOCALS`

    def parts(self, lines: Sequence[np.ndarray]) -> tuple[Part, Part]:
        """Both parts, the likelier first, given the lines (G,) of all images of the camera. Images
        of one place have correlated errors, so the evidence grows with the root of their number."""
        together = np.sum(lines, axis=0) / math.sqrt(max(1.0, len(lines) / 2))
        first, second = sorted(
            (part.given(together) for part in (self.usual, self.tail)),
            key=lambda part: -part.log_weight,
        )
        return first, second

    def log_density(self, log_focals: np.ndarray) -> np.ndarray:
        """The logarithms (N,) of the density at ln(f over the longer side), (N,), up to a constant,
        with the lines of this image."""
        each = self.usual.log_density(log_focals), self.tail.log_density(log_focals)
        density: np.ndarray = np.logaddexp(*each)
        return density + np.interp(log_focals, LOG_FOCALS, self.lines)


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera.

    Raises InputError unless K is finite and upper triangular with positive focal lengths and a last
    row of 0 0 1; and for a `lens_std` unless the lens is RADIAL or OPENCV_FISHEYE with two terms.

    Attributes:
        K: Intrinsic matrix (3, 3) float64, pixels. Also accepts fx, fy, cx, cy (4,), (1, 3, 3) or
            (4, 4).
        size: (width, height) of the image that K refers to; None if unknown.
        distortion: Lens distortion; None for a pinhole.
        warnings: Sentences about the origin of K, for the user.
        focal_std: Standard deviation of the logarithm of the focal lengths; 0: exact. If it is
            positive, the estimation fits the focal lengths, with K as the prior.
        centre_std: Standard deviation of each coordinate of the principal point, pixels.
        lens_std: Standard deviation of the first coefficient of a RADIAL lens; 0: exact. If it is
            positive, the estimation fits the coefficient, from 0 if `distortion` is None.
        focal_source: Source of the focal length: a given K, EXIF data, the size of the image, its
            lines, or the matches.
        identity: Equal for images taken by one camera, whose focal lengths are wrong by the same
            factor. None: the camera took no other image.
        projection: Projection of a panorama as its file states it; "" for any other image.
        aspect_std: Standard deviation of the logarithm of fy / fx; 0: exact.
        focal_prior: For a focal length that no K states, see `FocalPrior`; K and `focal_std` are
            its likeliest part.
        picture: The camera of the same image as without K, for a pair whose K is stated; None, as
            in folders: it follows from the size.
    """

    K: np.ndarray
    size: tuple[int, int] | None = None
    distortion: Distortion | None = None
    warnings: tuple[str, ...] = ()
    focal_std: float = 0.0
    centre_std: float = 0.0
    lens_std: float = 0.0
    focal_source: FocalSource = "given"
    identity: str | None = None
    projection: str = ""
    aspect_std: float = 0.0
    focal_prior: FocalPrior | None = None
    picture: Camera | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "K", _checked_matrix(self.K, "K"))
        if self.size is not None and not (self.size[0] > 0 and self.size[1] > 0):
            raise InputError(f"size must be positive, not {self.size[0]} x {self.size[1]}")
        for name in ("focal_std", "centre_std", "lens_std", "aspect_std"):
            check_type(getattr(self, name), float, name)
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be finite and at least 0, not {getattr(self, name)}")
        lens = self.distortion
        if self.lens_std and lens and not self.has_radial_lens:
            raise InputError(
                f"lens_std must be 0 with the lens {lens.model}: it is for RADIAL, and for "
                "OPENCV_FISHEYE of two coefficients"
            )

    @property
    def has_radial_lens(self) -> bool:
        """Whether the lens has two radial coefficients, or is none: `lens_std` may be positive."""
        return self.distortion is None or self.distortion.projection in ("plane", "angles")

    @property
    def exact(self) -> bool:
        """Whether the focal lengths, the principal point and the lens are known exactly."""
        return not (self.focal_std or self.centre_std or self.lens_std or self.aspect_std)

    def as_exact(self) -> Camera:
        """The camera without its standard deviations."""
        return replace(self, focal_std=0.0, centre_std=0.0, lens_std=0.0, aspect_std=0.0)

    def with_deviations(self, variances: np.ndarray) -> Camera:
        """The camera with the standard deviations of its parameters, see
        `estimation.intrinsics_prior`. variances: (6,), of a covariance of these."""
        focal, x, y, lens, _, aspect = np.sqrt(variances.clip(min=0)).tolist()
        return replace(
            self,
            focal_std=focal,
            centre_std=math.sqrt((x**2 + y**2) / 2) * self.focal,
            lens_std=lens,
            aspect_std=aspect,
        )

    @property
    def deviations(self) -> dict[str, float]:
        """The standard deviations by their names in files."""
        return {
            "focal_std": self.focal_std,
            "centre_std_px": self.centre_std,
            "lens_std": self.lens_std,
            "aspect_std": self.aspect_std,
        }

    @property
    def focal(self) -> float:
        """Mean of the focal lengths along x and y, pixels."""
        return float(self.K[0, 0] + self.K[1, 1]) / 2

    def normalise(self, points: np.ndarray) -> np.ndarray:
        """Pixels u (N, 2) to normalised coordinates K^-1 u (N, 2) float64, without distortion.

        NaN for points whose distortion cannot be undone. Raises InputError for another shape.
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"points must have shape (N, 2), not {points.shape}")
        y = (points[:, 1] - self.K[1, 2]) / self.K[1, 1]
        x = (points[:, 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        normalised = np.column_stack([x, y])
        return normalised if self.distortion is None else self.distortion.undo(normalised)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Normalised points (N, 2), x / z and y / z, to pixels; the inverse of `normalise`."""
        points = np.asarray(points, dtype=np.float64)
        distorted = points if self.distortion is None else self.distortion.apply(points)
        return distorted @ self.K[:2, :2].T + self.K[:2, 2]

    def with_focal(self, focal: float) -> Camera:
        """The camera with another mean focal length, pixels, and the same ratio fx / fy."""
        K = self.K.copy()
        K[:2, :2] *= focal / self.focal
        return replace(self, K=K)

    def resized(self, size: tuple[int, int]) -> Camera:
        """The camera of the image resized to (width, height), each side by its own factor.

        Raises InputError if the camera has no size.
        """
        if self.size is None:
            raise InputError("a camera without a size cannot be resized")
        scale = np.array([size[0] / self.size[0], size[1] / self.size[1], 1.0])
        K = self.K * scale[:, None]
        K[:2, 2] = rescale(self.K[:2, 2], self.size, size)
        centre_std = self.centre_std * float(scale[:2].mean())
        return replace(self, K=K, size=(int(size[0]), int(size[1])), centre_std=centre_std)

    def turned(self, turn: np.ndarray, size: Size) -> Camera:
        """The camera after its image of `size` (width, height) is rotated or mirrored.

        turn: of the axes (2, 2), see `exif_turn`. Raises InputError if it is not the identity and
        K has a skew, or if the lens model has a prism or is a cylinder.
        """
        lens = self.distortion
        has_axis = lens is not None and ("PRISM" in lens.model or lens.projection == "cylinder")
        if (self.K[0, 1] or has_axis) and not np.array_equal(turn, np.eye(2)):
            raise InputError(
                "a K with a skew, a prism or a cylinder cannot be rotated: give the rotated "
                "photographs their own upright K"
            )
        K = self.K.copy()
        K[:2, :2] = turn @ K[:2, :2] @ turn.T
        K[:2, 2] = turn_points(self.K[:2, 2], turn, size)
        if lens is not None and lens.model in ("OPENCV", "FULL_OPENCV"):
            k1, k2, p1, p2, *rest = lens.coefficients
            p2, p1 = (turn @ (p2, p1)).tolist()
            lens = replace(lens, coefficients=(k1, k2, p1, p2, *rest))
        width, height = size if turn[0, 0] else size[::-1]
        return replace(self, K=K, size=(width, height), distortion=lens)


@dataclass(frozen=True, eq=False)
class TwoViews:
    """The pose x2 = R x1 + t of camera 2 relative to camera 1."""

    camera1: Camera
    camera2: Camera
    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), unit length

    @property
    def E(self) -> np.ndarray:
        """Essential matrix [t]x R (3, 3) of normalised points."""
        return essential_from_pose(self.R, self.t)


def image_size(camera: Camera) -> tuple[float, float]:
    """(width, height) of the image; if unknown, with the principal point in the middle, and at
    least one pixel."""
    x, y = camera.K[:2, 2]
    return camera.size or (max(2 * x + 1, 1.0), max(2 * y + 1, 1.0))


def matrix_camera(K: Any, name: str = "K") -> Camera:
    """The camera from a matrix (3, 3), (1, 3, 3) or (4, 4), from fx, fy, cx, cy (4,), or from a
    `pycolmap.Camera`. Raises InputError, naming `name`."""
    # Does not import pycolmap: a caller with a pycolmap.Camera has imported it
    theirs: Any = getattr(sys.modules.get("pycolmap"), "Camera", ())
    if not isinstance(K, theirs):
        return Camera(_checked_matrix(K, name))
    try:
        matrix, lens = intrinsics(K.model.name, K.params.tolist())
        return Camera(matrix, (K.width, K.height), lens)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def colmap_camera(camera: Camera, name: str) -> pycolmap.Camera:
    """Convert a camera with a size to COLMAP: PINHOLE, the model of its distortion, or RADIAL if
    the lens is unknown. Raises InputError, naming the image `name`, for a K with a skew."""
    from dgc_pose.system.colmap_library import pycolmap

    assert camera.size is not None
    lens = camera.distortion
    if lens is None and camera.lens_std > 0:
        lens = Distortion(RADIAL, (0.0, 0.0))
    try:
        model, values = parameters(camera.K, lens)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    converted = pycolmap.Camera.create_from_model_name(0, model, 1.0, *camera.size)
    converted.params = values
    return converted


def view_camera(fov_deg: float, size: tuple[int, int]) -> Camera:
    """The camera of an image of `size` (width, height) with a horizontal field of view from edge to
    edge, and the principal point in the middle. Raises InputError outside 1 to 150 degrees."""
    check_type(fov_deg, float, "fov")
    if not 1 <= fov_deg <= 150:
        raise InputError(
            ArgumentName("fov"), f"must be an angle of 1 to 150 degrees, not {fov_deg}"
        )
    focal = size[0] / 2 / math.tan(math.radians(fov_deg) / 2)
    K = [focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2]
    return Camera(np.array(K), size, identity=f"fov {size[0]} x {size[1]}")


def _checked_matrix(value: Any, name: str) -> np.ndarray:
    """A read-only K (3, 3) float64 from any of the forms of `Camera.K`."""
    K = np.array(as_numpy(value, name), dtype=np.float64)
    if K.ndim == 3 and len(K) == 1:
        K = K[0]
    if K.shape == (4, 4) and np.array_equal(K[3], (0, 0, 0, 1)) and not K[:3, 3].any():
        K = K[:3, :3]
    if K.shape == (4,):
        K = np.array([[K[0], 0, K[2]], [0, K[1], K[3]], [0, 0, 1]])
    if K.shape != (3, 3):
        raise InputError(f"{name} must have shape (3, 3) or (4,), not {K.shape}")
    if not np.isfinite(K).all():
        raise InputError(f"{name} has values that are not finite")
    is_triangular = np.abs(K[2] - (0, 0, 1)).max() <= 1e-9 and abs(K[1, 0]) <= 1e-9 * K[1, 1]
    if not (is_triangular and K[0, 0] > 0 and K[1, 1] > 0):
        rows = ", ".join(" ".join(f"{number:g}" for number in row) for row in K)
        raise InputError(
            f"{name} must be upper triangular with positive focal lengths and the last row 0 0 1, "
            f"not {rows}"
        )
    K[1, 0] = 0
    K[2] = (0, 0, 1)
    K.setflags(write=False)
    return K
