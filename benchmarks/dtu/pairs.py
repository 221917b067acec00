"""Pairs of DTU views with a chosen rotation and overlap, drawn at random from the calibration."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.dtu.calibration import IMAGE_SIZE, View, read_view, relative_pose
from dgc_pose.benchmarks.dtu.overlap import overlap
from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.metrics import rotation_error_deg


@dataclass(frozen=True)
class PairOptions:
    """Which pairs to draw."""

    pairs: int = 64
    min_rotation: float = 5.0  # degrees
    max_rotation: float = 40.0  # degrees
    min_overlap: float = 0.4  # share of points seen by both views, 0 to 1
    bins: int = 7  # equal rotation bins, drawn from in turn
    seed: int = 0

    def __post_init__(self) -> None:
        if self.pairs < 1 or self.bins < 1:
            raise InputError("pairs and bins must be at least 1")
        if not 0 <= self.min_rotation < self.max_rotation <= 180:
            raise InputError(
                "rotations must satisfy 0 <= min-rotation < max-rotation <= 180, "
                f"not {self.min_rotation:g} and {self.max_rotation:g}"
            )
        if not 0 <= self.min_overlap <= 1:
            raise InputError(f"min-overlap must lie in 0 to 1, not {self.min_overlap:g}")


@dataclass(frozen=True)
class Scan:
    """One scan of the raw layout, under one light."""

    root: Path
    views: Mapping[int, View]  # by view number, from 1
    images: Mapping[int, str]  # by view number, relative to root
    absent: int  # views left out, since the calibration or the image is not there


@dataclass(frozen=True)
class Candidate:
    """Two views that may make a pair."""

    view1: int
    view2: int
    rotation_deg: float


def open_scan(root: str | Path, scan: int, light: int) -> Scan:
    """Find the views of a scan in the raw layout.

    A view is `Calibration/cal18/pos_NNN.txt` and `Rectified/scanN/rect_NNN_L_r5000.png` or `.jpg`;
    views of which either is missing are left out and counted. Raises InputError with the path
    where fewer than two views are left, or for a file that is no calibration.
    """
    root = Path(root)
    folder = root / "Calibration" / "cal18"
    positions = _numbered(folder, r"pos_(\d{3})\.txt")
    name = rf"rect_(\d{{3}})_{light}_r5000\.(?:png|jpg)"
    images = _numbered(root / "Rectified" / f"scan{scan}", name)
    present = sorted(positions.keys() & images.keys())
    if len(present) < 2:
        raise InputError(
            f"{root}: fewer than two views of scan {scan} under light {light}: "
            f"{len(positions)} positions in Calibration/cal18, "
            f"{len(images)} images in Rectified/scan{scan}"
        )
    return Scan(
        root=root,
        views={view: read_view(positions[view]) for view in present},
        images={view: images[view].relative_to(root).as_posix() for view in present},
        absent=len(positions.keys() | images.keys()) - len(present),
    )


def find_candidates(views: Mapping[int, View], options: PairOptions) -> list[Candidate]:
    """All pairs of views (the smaller number first) within the rotation and overlap asked for."""
    candidates = []
    for view1, view2 in combinations(sorted(views), 2):
        R, _ = relative_pose(views[view1], views[view2])
        rotation = rotation_error_deg(R, np.eye(3))
        if not options.min_rotation <= rotation <= options.max_rotation:
            continue
        if overlap(views[view1], views[view2]) >= options.min_overlap:
            candidates.append(Candidate(view1, view2, rotation))
    return candidates


def draw(candidates: list[Candidate], options: PairOptions) -> list[Candidate]:
    """Draw pairs at random, one from each rotation bin in turn.

    So every start of the list is spread over the rotations. The same seed draws the same pairs.
    Bins that run out are passed over: fewer pairs than asked for come back only where there are
    fewer candidates.
    """
    rng = np.random.default_rng(options.seed)
    edges = np.linspace(options.min_rotation, options.max_rotation, options.bins + 1)
    places = np.digitize([c.rotation_deg for c in candidates], edges[1:-1])
    queues: list[list[Candidate]] = [[] for _ in range(options.bins)]
    for candidate, place in zip(candidates, places, strict=True):
        queues[place].append(candidate)
    for queue in queues:
        rng.shuffle(queue)
    drawn: list[Candidate] = []
    while len(drawn) < min(options.pairs, len(candidates)):
        drawn.extend(queue.pop() for queue in queues if queue)
    return drawn[: options.pairs]


def make_pairs(scan: Scan, drawn: list[Candidate]) -> list[Pair]:
    """The pairs with their cameras and true poses (t in millimetres), as a pair list takes them."""
    return [_pair(scan, candidate.view1, candidate.view2) for candidate in drawn]


def _pair(scan: Scan, number1: int, number2: int) -> Pair:
    view1, view2 = scan.views[number1], scan.views[number2]
    R, t = relative_pose(view1, view2)
    return Pair(
        name1=scan.images[number1],
        name2=scan.images[number2],
        root=scan.root,
        camera1=Camera(K=view1.K, size=IMAGE_SIZE),
        camera2=Camera(K=view2.K, size=IMAGE_SIZE),
        R=R,
        t=t,
    )


def _numbered(folder: Path, pattern: str) -> dict[int, Path]:
    """The files of a folder whose names match, by the number in the name; of a png and a jpg with
    the same number, the png."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected DTU's raw layout")
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        match = re.fullmatch(pattern, path.name)
        if match:  # in sorted order, so a png comes after a jpg and replaces it
            found[int(match[1])] = path
    return found
