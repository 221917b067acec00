"""The result of an estimate: a pose, or the reason why there is none."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.calibration import camera_data, parse_camera_data
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_model import model_named
from dgc_pose.estimation.covariance import error_radius_deg
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.problem import Hypothesis
from dgc_pose.estimation.status import STATUSES, Status, probability_text, short_text
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.geometry.rotation import quaternion_wxyz
from dgc_pose.system.files import read_as
from dgc_pose.system.texts import finite_or_none, json_text

_PLAIN = (  # in `to_dict` as they are, arrays as lists
    *("status", "success", "R", "t", "length", "length_std", "quaternion_wxyz", "E"),
    *("camera1", "camera2", "num_matches", "num_inliers", "inlier_ratio"),
    *("median_triangulation_angle_deg", "rotation_error_90_deg", "translation_error_90_deg"),
    *("covariance", "probability", "any_probability", "same_place_probability"),
)


@dataclass(frozen=True, eq=False)
class RelativePose:
    """The pose of camera 2 relative to camera 1, x2 = R x1 + t, with the translation up to scale.

    `success` means that R and t are known. With "rotation_only" (also for identical images) R is
    known and t is None; with any other failure both are None.

    Attributes:
        status: "ok" or "planar" with a pose; any other status names why there is none.
        reason: Why there is no pose, or what kind of pose it is: one sentence for people.
        inliers: Which of the matches agree with the pose, (N,) bool, over the matches as passed.
        num_matches: Number of matches used, without non-finite ones, duplicates and the like.
        R: Rotation (3, 3) from camera 1 to camera 2; None if it is not known.
        t: Direction (3,) of the translation, unit length, in camera 2's axes: where camera 1 is
            seen from camera 2. None if it is not known.
        length: Distance between the cameras, metres, if a `ScaleSource` determines it.
        length_std: Standard deviation of `length`; None if it is not known.
        covariance: Covariance (6, 6), rad^2, of rank 5, of a rotation vector w and a change d of t,
            in camera 2's axes; the true pose is exp([w]x) R and t + d. With "rotation_only" it is
            that of R, and the rest is 0. None if R is not known, and if the inliers do not
            determine it. Scaled so that the expected error of right poses holds in nine cases of
            ten. It covers no alternative pose, wrong K or wrong verdict.
        camera1: Camera of image 1 that belongs to the pose: as it was stated, or with the focal
            length from the matches if the stated one had a deviation. None without a pose.
        camera2: Camera of image 2, in the same way.
        camera_covariance: Covariance (12, 12), from the matches, of ln f, the principal point
            (pixels), two radial coefficients and ln fy / fx, of camera 1 and then of camera 2; None
            for cameras that were not fitted.
        evidence: The measurements behind the verdict; None without a hypothesis.
        probability: Probability that R and t are both within 10 degrees of the truth; 0 without a
            hypothesis, with "rotation_only" and with "ambiguous". None if no probability is fitted
            for such matches.
        any_probability: Probability that R and t of one of the `hypotheses` are both within 10
            degrees, if both images show one place; 0 without a hypothesis. None if no probability
            is fitted for such matches.
        same_place_probability: Probability that both images show one place, not two places with a
            similar part, from the surroundings of the matches; 1 if unknown. The probabilities of a
            success and its alternatives, or of the poses of an ambiguous pair, add up to this times
            `any_probability`.
        tested_matchers: Names of the matchers that the probability of key points was tested on;
            () for a network's matches and without a probability.
        alternatives: Poses more than 10 degrees from this one that explain the matches about as
            well, the likeliest first: from a plane, repeated structure, mirrored depth or another
            motion. With "ambiguous" all poses, none if an image may be mirrored; with any other
            failure none.
        hypotheses: All poses that were considered, also those that explain fewer matches, this one
            first. The inliers of hypotheses and alternatives are over the `num_matches` used.
        cameras: Cameras of the hypotheses, also of a rejected pose; None without hypotheses.
        median_triangulation_angle_deg: Of the inliers; None without a hypothesis.
        warnings: Sentences about what makes the pose uncertain, for people.
        seconds: Time spent on "load", the steps of the matching (`dgc_pose.pose`) and "estimate".
    """

    status: Status
    reason: str
    inliers: np.ndarray
    num_matches: int
    R: np.ndarray | None = None
    t: np.ndarray | None = None
    length: float | None = None
    length_std: float | None = None
    covariance: np.ndarray | None = None
    camera1: Camera | None = None
    camera2: Camera | None = None
    camera_covariance: np.ndarray | None = None
    evidence: Evidence | None = None
    probability: float | None = 0.0
    any_probability: float | None = 0.0
    same_place_probability: float = 1.0
    tested_matchers: tuple[str, ...] = ()
    alternatives: tuple[Hypothesis, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    cameras: tuple[Camera, Camera] | None = None
    median_triangulation_angle_deg: float | None = None
    warnings: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        """The result for people, in at most five lines."""
        inliers = f"{self.num_inliers} of {self.num_matches} matches are inliers"
        lines = [f"RelativePose: {self.status}, {inliers}"]
        if not self.success:
            lines.append(f"no pose: {self.reason}")
        if self.R is not None:
            lines.append(f"R {short_text(self.R)}")
        if self.t is not None:
            lines.append(f"t {short_text(self.t)}, {self.length_text}")
        if errors := self.error_texts:
            lines.append(
                f"expected error: {', '.join(errors)} in 90 % of cases, if the pose is right"
            )
        others = [probability_text(other.probability) for other in self.alternatives]
        last = [probability_text(self.probability)] if self.success else []
        if others:
            last.append(f"{len(others)} alternative{'s'[: len(others) != 1]}: {', '.join(others)}")
        return "\n  ".join(lines + ([", ".join(last)] if last else []))

    @property
    def success(self) -> bool:
        """Whether R and t are known."""
        return STATUSES[self.status].has_t

    @property
    def contradicts_K(self) -> bool:
        """Whether the matches agree with other cameras than those of K."""
        if self.evidence is None or not STATUSES[self.status].shows_cameras:
            return False
        return model_named(self.evidence.camera_model).contradicts_K

    @property
    def one_place_probability(self) -> float | None:
        """`probability` if both images show one place."""
        return None if self.probability is None else self.probability / self.same_place_probability

    @property
    def length_text(self) -> str:
        """The length of t for people: `1.234 m +- 0.012 m`, or `up to scale`."""
        if self.length is None:
            return "up to scale"
        return f"{self.length:.4g} m" + (f" +- {self.length_std:.2g} m" if self.length_std else "")

    @property
    def cam2_from_cam1(self) -> np.ndarray | None:
        """[R | t] (3, 4), or None without a pose."""
        return None if self.R is None or self.t is None else np.column_stack([self.R, self.t])

    def matrix(self) -> np.ndarray | None:
        """cam2_from_cam1 (4, 4), for homogeneous points, or None without a pose."""
        rows = self.cam2_from_cam1
        return None if rows is None else np.vstack([rows, (0, 0, 0, 1)])

    @property
    def centre(self) -> np.ndarray | None:
        """-R^T t (3,), unit length: camera 2's centre in camera 1's axes. None without a pose."""
        return None if self.R is None or self.t is None else -self.R.T @ self.t

    @property
    def rotvec(self) -> np.ndarray | None:
        """R as a rotation vector (3,), radians, or None if R is not known."""
        return None if self.R is None else cv2.Rodrigues(self.R)[0].ravel()

    @property
    def quaternion_wxyz(self) -> np.ndarray | None:
        """R as a unit quaternion (w, x, y, z), or None if R is not known."""
        return None if self.R is None else quaternion_wxyz(self.R)

    @property
    def E(self) -> np.ndarray | None:
        """Essential matrix [t]x R (3, 3) of normalised points, or None without a pose."""
        return None if self.R is None or self.t is None else essential_from_pose(self.R, self.t)

    @property
    def K1(self) -> np.ndarray | None:
        """Intrinsic matrix (3, 3) of `camera1`, or None without a pose."""
        return None if self.camera1 is None else self.camera1.K

    @property
    def K2(self) -> np.ndarray | None:
        """Intrinsic matrix (3, 3) of `camera2`, or None without a pose."""
        return None if self.camera2 is None else self.camera2.K

    @property
    def focal_std1(self) -> float | None:
        """Standard deviation of camera 1's focal length as a share of it; 0 if it was known."""
        return None if self.camera1 is None else self.camera1.focal_std

    @property
    def focal_std2(self) -> float | None:
        """Standard deviation of camera 2's focal length as a share of it; 0 if it was known."""
        return None if self.camera2 is None else self.camera2.focal_std

    @property
    def num_inliers(self) -> int:
        """Number of inliers."""
        return int(self.inliers.sum())

    @property
    def inlier_ratio(self) -> float:
        """Share of the matches used that are inliers; 0 without a hypothesis."""
        return self.num_inliers / max(self.num_matches, 1)

    @property
    def rotation_error_90_deg(self) -> float | None:
        """Bound of the error of R for nine right poses in ten, degrees; None if not known."""
        return None if self.covariance is None else error_radius_deg(self.covariance[:3, :3])

    @property
    def translation_error_90_deg(self) -> float | None:
        """The same bound for the angle between t and the true direction."""
        if self.covariance is None or self.t is None:
            return None
        return error_radius_deg(self.covariance[3:, 3:])

    @property
    def error_texts(self) -> list[str]:
        """The bounds that are known, for people: `R within 0.123 deg`, `t within 1.234 deg`."""
        bounds = {"R": self.rotation_error_90_deg, "t": self.translation_error_90_deg}
        return [f"{name} within {e:.3f} deg" for name, e in bounds.items() if e is not None]

    def inverse(self) -> "RelativePose":
        """The pose of camera 1 relative to camera 2: x1 = R^T x2 - R^T t.

        The error of its t combines the errors of R and t. `evidence` is None: it is measured with
        the images in their first order. `reason` and `warnings` keep this order, too.
        """
        R = self.R
        E = self.E
        covariance = self.covariance
        camera_covariance = self.camera_covariance
        if R is not None and covariance is not None:
            by_w = np.zeros((3, 3)) if E is None else -E.T
            by = np.block([[R.T, np.zeros((3, 3))], [by_w, R.T]])  # -w and -d by w and d
            covariance = by @ covariance @ by.T
        return replace(
            self,
            R=None if R is None else R.T,
            t=self.centre,
            covariance=covariance,
            camera1=self.camera2,
            camera2=self.camera1,
            cameras=None if self.cameras is None else self.cameras[::-1],
            camera_covariance=None
            if camera_covariance is None
            else np.roll(camera_covariance, len(camera_covariance) // 2, (0, 1)),
            evidence=None,
            alternatives=tuple(other.inverse() for other in self.alternatives),
            hypotheses=tuple(other.inverse() for other in self.hypotheses),
        )

    def to_dict(self) -> dict[str, Any]:
        """The pose as values of JSON, as `dgc-pose estimate --json` writes it. Unknown and
        non-finite values are None.

        Without a pose, the reason is the first of the warnings. If the pair is ambiguous, the
        alternatives are all of its poses, the likeliest first.
        """
        facts = ("R", "t", "num_inliers", "probability")
        return {
            **{name: plain(getattr(self, name)) for name in _PLAIN},
            "tested_matchers": list(self.tested_matchers),
            "alternatives": [
                {name: plain(getattr(other, name)) for name in facts} for other in self.alternatives
            ],
            "warnings": ([] if self.success else [self.reason]) + list(self.warnings),
            "seconds": {step: round(value, 4) for step, value in self.seconds.items()},
        }

    def to_json(self) -> str:
        """`to_dict` as strict JSON, a newline at its end."""
        return json_text(self.to_dict())

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "RelativePose":
        """The pose in the output of `to_dict` or of `dgc-pose estimate --json`.

        It has no `evidence`, `hypotheses` and `camera_covariance`. Only the number of inliers is
        known, for the alternatives too: `inliers` is (num_inliers,), all True, and `in_front` is
        empty. Raises InputError for other data.
        """
        with read_as("a pose of to_dict", "data"):
            facts = STATUSES[data["status"]]
            lines = tuple(data["warnings"])
            others = [_parsed(other, ["R", "t", "probability"]) for other in data["alternatives"]]
            return cls(
                **_parsed(data, [fact.name for fact in fields(cls) if fact.name in _PLAIN]),
                reason=facts.meaning if facts.has_t else lines[0],
                tested_matchers=tuple(data.get("tested_matchers", ())),  # older results have none
                alternatives=tuple(Hypothesis(**o, in_front=np.zeros(0, bool)) for o in others),
                warnings=lines[not facts.has_t :],
                seconds=data["seconds"],
            )


def plain(value: Any) -> Any:
    """A value of a result for JSON."""
    if isinstance(value, Camera):
        return camera_data(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    return finite_or_none(value) if isinstance(value, float) else value


def _parsed(data: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """The values by name, from data that `plain` made; and `inliers`, with a True for each."""
    values: dict[str, Any] = {name: data[name] for name in names}
    for name, value in values.items():
        if isinstance(value, Mapping):
            values[name] = parse_camera_data(value)
        elif isinstance(value, list):
            values[name] = np.array(value, float)
    return values | {"inliers": np.ones(data["num_inliers"], bool)}
