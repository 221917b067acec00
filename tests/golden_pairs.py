"""Forty rendered pairs and the answers recorded for them in golden_pairs.csv.

    python tests/golden_pairs.py

writes the answers of the code as it is. They are recorded again where a change of the answers is
intended, and the change is reported.
"""

import csv
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rendered import RenderedPair, render_scene_pair

from dgc_pose import EstimationOptions, Matcher, estimate_relative_pose, load_matcher
from dgc_pose.images.image import Image, load_pair
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

RECORDED = Path(__file__).with_suffix(".csv")
SIZE = (480, 360)
# By group: number of pairs, kind of the scene, degrees between the cameras.
GROUPS = {
    "easy": (10, "general", 15.0),
    "wide": (10, "general", 65.0),
    "planar": (8, "planar", 20.0),
    "rotation_only": (6, "rotation_only", 15.0),
    "unrelated": (6, "general", 15.0),
}
# All pairs are estimated with "auto", and every third in each other way.
CASES = [
    (group, number, way)
    for way in ("auto", "fast", "thorough", "sift", "K=auto")
    for group, (count, _, _) in GROUPS.items()
    for number in range(0, count, 1 if way == "auto" else 3)
]


class Answer(NamedTuple):
    """What one way of estimation makes of one pair."""

    group: str
    number: int
    way: str
    status: str
    probability: float | None  # of one place; None for key points
    same_place: float | None  # probability that both images show one
    rotation_error_deg: float | None  # None without R
    translation_error_deg: float | None  # None without t


@lru_cache(maxsize=1)
def rendered(group: str, number: int) -> RenderedPair:
    _, kind, angle = GROUPS[group]
    seed = 1000 * list(GROUPS).index(group) + number
    pair = render_scene_pair(seed, size1=SIZE, size2=SIZE, rotation_deg=angle, kind=kind)
    if group != "unrelated":
        return pair
    other = render_scene_pair(seed + 500, size1=SIZE, size2=SIZE, rotation_deg=angle, kind=kind)
    return replace(pair, image2=other.image2, K2=other.K2)


@lru_cache(maxsize=1)
def images(group: str, number: int) -> tuple[Image, Image]:
    """The pictures of a pair, of which each way has the same features."""
    pair = rendered(group, number)
    return load_pair((pair.image1, pair.image2))


@cache
def matcher(name: str) -> Matcher:
    return load_matcher(name)


def answer(group: str, number: int, way: str) -> Answer:
    """Estimate a pair in one way."""
    pair = rendered(group, number)
    effort = way if way in ("fast", "thorough") else "auto"
    K1, K2 = ("auto", "auto") if way == "K=auto" else (pair.K1, pair.K2)
    pose = estimate_relative_pose(
        *images(group, number),
        K1,
        K2,
        matcher=matcher("sift" if way == "sift" else "dgcm-lite0"),
        options=EstimationOptions(effort=effort),
    )
    R = None if pose.R is None else rotation_error_deg(pose.R, pair.R)
    t = None
    if pose.t is not None and np.linalg.norm(pair.t) > 0:
        t = translation_error_deg(pose.t, pair.t / np.linalg.norm(pair.t))
    probabilities = pose.one_place_probability, pose.same_place_probability
    return Answer(group, number, way, pose.status, *probabilities, R, t)


def recorded() -> list[Answer]:
    """The answers of golden_pairs.csv."""
    with RECORDED.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    return [
        Answer(
            row["group"],
            int(row["number"]),
            row["way"],
            row["status"],
            *(float(row[name]) if row[name] else None for name in Answer._fields[4:]),
        )
        for row in rows
    ]


def main() -> None:
    with RECORDED.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(Answer._fields)
        for case in CASES:
            found = answer(*case)
            numbers = ["" if value is None else f"{value:.4f}" for value in found[4:]]
            writer.writerow([*found[:4], *numbers])


if __name__ == "__main__":
    main()
