"""How far apart the answers of ONNX Runtime and of torch are, on pairs of a list."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.benchmarks.table import aligned
from dgc_pose.images.image import load_image
from dgc_pose.matchers import load_matcher
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.pose import Trace, match_and_estimate

LIMIT_DEG = 0.01  # of a difference that is none


@dataclass(frozen=True)
class Difference:
    """Of the two answers to one pair."""

    name1: str
    name2: str
    map_px: float  # median distance of the maps, pixels of image 1
    matchability: float  # largest difference of a cell
    matches: tuple[int, int]  # by ONNX Runtime and by torch
    status: tuple[str, str]
    # Of rotation and translation; None if one of them has no pose or no translation.
    pose_deg: tuple[float, float] | None


def differences(weights: str, pairs: Sequence[Pair]) -> Iterator[Difference]:
    """Of each pair, by the same weights run by both.

    Raises InputError or WeightsError as `load_matcher`, ImageError for an image.
    """
    matchers = [load_matcher(weights, device="cpu", runtime=one) for one in ("onnx", "torch")]
    for pair in pairs:
        images = load_image(pair.path1), load_image(pair.path2)
        yield _difference(
            pair,
            *(match_and_estimate(*images, pair.camera1, pair.camera2, one) for one in matchers),
        )


def _difference(pair: Pair, first: Trace, second: Trace) -> Difference:
    map1, map2 = first.correspondence_map, second.correspondence_map
    assert map1 is not None and map2 is not None
    one, other = first.pose, second.pose
    angles = None
    if one.R is not None and one.t is not None and other.R is not None and other.t is not None:
        angles = rotation_error_deg(one.R, other.R), translation_error_deg(one.t, other.t)
    return Difference(
        pair.name1,
        pair.name2,
        float(np.median(np.linalg.norm(map1.map - map2.map, axis=-1))),
        float(np.abs(map1.matchability - map2.matchability).max()),
        (len(first.matches), len(second.matches)),
        (one.status, other.status),
        angles,
    )


def row(found: Difference) -> str:
    """A difference on one line."""
    pose = "no pose"
    if found.pose_deg is not None:
        pose = "pose {:.2g} and {:.2g} deg".format(*found.pose_deg)
    names = f"{Path(found.name1).name} {Path(found.name2).name}"
    return f"{names}: map {found.map_px:.1g} px, {pose}"


def summary(found: Sequence[Difference]) -> str:
    """Medians and largest values over the pairs; in how many the statuses differ."""
    rows = [("difference", "median", "largest")]
    angles = [each.pose_deg for each in found if each.pose_deg is not None]
    columns = {
        "map, px": [each.map_px for each in found],
        "matchability": [each.matchability for each in found],
        "rotation, deg": [one[0] for one in angles],
        "translation, deg": [one[1] for one in angles],
    }
    for name, values in columns.items():
        if values:
            rows.append((name, f"{np.median(values):.2g}", f"{np.max(values):.2g}"))
    within = sum(max(one) <= LIMIT_DEG for one in angles)
    other = sum(each.status[0] != each.status[1] for each in found)
    return (
        f"{aligned(rows)}\n{within} of {len(angles)} poses within {LIMIT_DEG} degrees; "
        f"the status differs in {other} of {len(found)} pairs"
    )
