"""The row of a pair in a batch, a line of JSON."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.evidence import ModelName
from dgc_pose.files.inputs import open_regular, read_as
from dgc_pose.files.outputs import writing
from dgc_pose.system.options import check_options

# Statuses of pairs that were not matched: an image or camera cannot be used; matching or estimation
# raised an error that is not about its input, after which --resume matches the pair again.
BAD_INPUT, FAILED = "bad_input", "failed"


@dataclass(frozen=True)
class HypothesisRow:
    """A pose that explains the matches about as well as that of the row, or of the others if the
    row is ambiguous."""

    R: tuple[float, ...]  # 9 numbers, row by row
    t: tuple[float, ...]  # 3 numbers, unit length
    num_inliers: int
    probability: float | None  # as of the row


@dataclass(frozen=True)
class PairRow:
    """The pose of one pair, cam2_from_cam1: x2 = R x1 + t, with the translation up to scale.

    Unknown values are None. There is no time in it: the same input gives the same row.
    """

    name1: str
    name2: str
    status: str  # of `dgc_pose.estimation.status.Status`, or "bad_input" or "failed"
    success: bool  # whether R and t are known
    reason: str  # one sentence for people
    # That R and t are both within 10 degrees; None if no model of it is fitted for such matches.
    probability: float | None = None
    R: tuple[float, ...] | None = None  # 9 numbers, row by row
    t: tuple[float, ...] | None = None  # 3 numbers, unit length
    rotation_error_90_deg: float | None = None  # nine times in ten the error is below
    translation_error_90_deg: float | None = None  # of the direction
    num_matches: int = 0
    num_inliers: int = 0
    inlier_ratio: float | None = None
    median_triangulation_angle_deg: float | None = None
    error_px: float | None = None  # expected error of a match, pixels of the originals
    # Of the cameras that the pose is of: the focal length, pixels, and the standard deviation of
    # its logarithm, 0 if it is exact.
    focal1: float | None = None
    focal2: float | None = None
    focal_std1: float | None = None
    focal_std2: float | None = None
    camera_model: ModelName = "assumed"  # that the matches agree with, where no K states it
    alternatives: tuple[HypothesisRow, ...] = ()  # if ambiguous all poses, the likeliest first
    warnings: tuple[str, ...] = ()  # about the images, the cameras and the pose

    @property
    def names(self) -> tuple[str, str]:
        return self.name1, self.name2


# Fields that a row has as `RelativePose.to_dict` has them.
_OF_POSE = (
    *("status", "success", "probability", "rotation_error_90_deg", "translation_error_90_deg"),
    *("num_matches", "num_inliers", "inlier_ratio", "median_triangulation_angle_deg"),
)


def row_of(names: tuple[str, str], pose: RelativePose, error_px: float) -> PairRow:
    """The row of an estimated pose."""
    data = pose.to_dict()
    values = {name: data[name] for name in _OF_POSE}
    for number, camera in enumerate((pose.camera1, pose.camera2), start=1):
        if camera is not None:
            values |= {f"focal{number}": camera.focal, f"focal_std{number}": camera.focal_std}
    return PairRow(
        *names,
        reason=pose.reason,
        R=None if pose.R is None else _numbers(pose.R),
        t=None if pose.t is None else _numbers(pose.t),
        error_px=error_px,
        camera_model="assumed" if pose.evidence is None else pose.evidence.camera_model,
        alternatives=tuple(
            HypothesisRow(_numbers(o.R), _numbers(o.t), o.num_inliers, o.probability)
            for o in pose.alternatives
        ),
        warnings=pose.warnings,
        **values,
    )


def parse_row(data: Any, where: str) -> PairRow:
    """A row of JSON. Raises InputError, with `where`, if it is none."""
    try:
        row: PairRow = _parsed(PairRow, data)
        others = tuple(_parsed(HypothesisRow, other) for other in row.alternatives)
        row = replace(row, alternatives=others)
        for pose in (row, *others):
            check_options(pose)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    except (KeyError, TypeError):
        raise InputError(f"{where}: not a row of a batch") from None
    lengths, *of_others = ((len(pose.R or ()), len(pose.t or ())) for pose in (row, *others))
    if lengths not in ((0, 0), (9, 0), (9, 3)) or {*of_others} - {(9, 3)}:
        raise InputError(f"{where}: R has 9 numbers and t has 3")
    return row


def _parsed(kind: Any, data: Any) -> Any:
    """A dataclass of the values of its fields; lists become tuples."""
    values = ((field.name, data[field.name]) for field in fields(kind))
    return kind(**{name: tuple(v) if isinstance(v, list) else v for name, v in values})


def write_rows(path: Path, rows: Iterable[PairRow]) -> None:
    """Rows as JSON Lines, strict JSON."""
    with writing(path), path.open("w", encoding="utf-8") as stream:
        stream.writelines(json.dumps(asdict(row), allow_nan=False) + "\n" for row in rows)


def read_rows(path: Path) -> Iterator[PairRow]:
    """The rows of a file that `write_rows` wrote. Raises InputError, with the path, if it is cut
    short or none of these."""
    with read_as("a table of poses", path), open_regular(path) as stream:
        for number, line in enumerate(stream, start=1):
            try:
                data = json.loads(line)
            except (ValueError, RecursionError):
                raise InputError(f"{path}:{number}: not a whole line of JSON") from None
            yield parse_row(data, f"{path}:{number}")


def _numbers(array: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in array.ravel())
