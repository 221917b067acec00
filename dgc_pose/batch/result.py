"""The files of a batch's result: `pairs.jsonl`, `matches.h5`, `summary.json`, and `cameras.csv` if
cameras were pooled. Pairs are in the order of the plan, not of the work.

`matches.h5` has hloc's layout: a group `name1/name2` ("/" inside a name becomes "-") holds
`keypoints0`, `keypoints1` (N, 2) float32, pixels of the images, (0, 0) the centre of the top-left
pixel, `scores` (N,) float32, and `inliers` (N,) bool, which hloc ignores.
"""

import csv
import io
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dgc_pose.batch.folder_cameras import PooledCamera
from dgc_pose.batch.groups import connected
from dgc_pose.batch.pairs import BAD_INPUT, FAILED, MatchedPair, PairRow
from dgc_pose.batch.source import STORE
from dgc_pose.batch.store import BatchStore, Plan, open_store
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation.status import STATUSES
from dgc_pose.system.files import naming_path, replaced, require_room, write_text
from dgc_pose.system.texts import write_json

PAIRS = "pairs.jsonl"
MATCHES = "matches.h5"
SUMMARY = "summary.json"
CAMERAS = "cameras.csv"
MISSING = "missing"  # in place of the second matcher's fingerprint, if it is not installed
GROUP_BYTES = 4096  # more than HDF5 needs for a pair, without its arrays


@dataclass(frozen=True, eq=False)
class Batch:
    """The result of a batch, read from its folder."""

    folder: Path
    plan: Plan
    rows: Sequence[PairRow]  # in the order of the pairs
    summary: Mapping[str, Any]

    def pairs(self) -> Iterator[MatchedPair]:
        """Each pair with its matches. Raises InputError if the store is broken."""
        with open_store(self.folder) as store:
            yield from store.pairs("result")


def read_batch(out: Path) -> Batch:
    """The result of a finished batch. Raises InputError, with the path, if the batch is unfinished
    or its store is broken."""
    if not (out / STORE).is_file():
        raise InputError(f"{out} has no {STORE}: it is not a batch folder of this version")
    with open_store(out) as store:
        plan = store.plan
        summary = store.summary
        if plan is None or summary is None:
            raise InputError(f"{out}: the batch is unfinished: --resume continues it")
        rows = store.rows("result")
    if [row.names for row in rows] != [plan.pair(i) for i in range(len(plan.pairs))]:
        raise InputError(f"{out / STORE}: its rows and its plan list different pairs")
    return Batch(out, plan, rows, summary)


def write_files(out: Path, store: BatchStore, plan: Plan, summary: Mapping[str, Any]) -> None:
    """Write the files of a result from the pairs in the store."""
    if plan.uncertain:
        write_cameras(out, plan.final_cameras)
    with (
        replaced(out / PAIRS) as file,
        naming_path(file),
        file.open("w", encoding="utf-8") as stream,
    ):
        stream.writelines(f"{line}\n" for _, line in store.lines("result"))
    with replaced(out / MATCHES) as file:
        room = store.byte_count() + GROUP_BYTES * len(plan.pairs)
        require_room(out / MATCHES, room)  # HDF5 ends the process when a disk is full
        write_matches(file, store.pairs("result"))
    write_json(out / SUMMARY, summary)


def write_cameras(out: Path, cameras: Mapping[str, Camera]) -> None:
    """Write `cameras.csv`, which `--K` reads: a line for each image."""
    rows = [_camera_row(name, camera) for name, camera in cameras.items()]
    table = io.StringIO()
    lines = csv.DictWriter(table, rows[0] if rows else [], lineterminator="\n")
    lines.writeheader()
    lines.writerows(rows)
    text = table.getvalue().encode(errors="backslashreplace")  # names may not be UTF-8
    write_text(out / CAMERAS, text.decode())


def _camera_row(name: str, camera: Camera) -> dict[str, Any]:
    K = camera.K
    width, height = camera.size or ("", "")
    lens = camera.distortion
    return {
        "name": name,
        "fx": K[0, 0],
        "fy": K[1, 1],
        "cx": K[0, 2],
        "cy": K[1, 2],
        "width": width,
        "height": height,
        **camera.deviations,
        "camera": camera.identity or "",
        "model": "" if lens is None else lens.model,
        "coefficients": "" if lens is None else " ".join(map(repr, lens.coefficients)),
    }


def summary_of(
    plan: Plan, rows: Sequence[PairRow], cameras: Sequence[PooledCamera]
) -> dict[str, Any]:
    """The content of `summary.json`. cameras: the pooled cameras."""
    by_status = Counter(row.status for row in rows)
    bad = dict(plan.bad)
    for row in rows:
        bad.update(row.bad_images)
    return {
        "images": len(plan.names),
        "bad_images": dict(sorted(bad.items())),
        "cameras": [_camera_facts(pooled) for pooled in cameras],
        "pairs": len(plan.pairs),
        "poses": sum(by_status[status] for status, facts in STATUSES.items() if facts.has_t),
        "bad_pairs": by_status[BAD_INPUT],
        "failed_pairs": by_status[FAILED],
        "rejected": _rejected_between_groups(rows),
        "judged_together": sum(row.folder_probability is not None for row in rows),
        "by_status": dict(sorted(by_status.items())),
    }


def _camera_facts(pooled: PooledCamera) -> dict[str, Any]:
    first, camera = next(iter(pooled.cameras.items()))
    return {
        "images": len(pooled.cameras),
        "first_image": first,
        "focal_px": camera.focal,
        "focal_source": camera.focal_source,
        "centre_px": camera.K[:2, 2].tolist(),
        **camera.deviations,
        "pairs": pooled.pairs,
        "why": pooled.why,
    }


def _rejected_between_groups(rows: Sequence[PairRow]) -> list[dict[str, Any]]:
    """The numbers of rejected pairs between groups of images, or within a group. Accepted pairs
    connect the images of a group."""
    accepted = (row for row in rows if row.folder_probability is not None and not row.rejected)
    group = connected(rows, accepted)
    between = Counter(frozenset(group[n] for n in row.names) for row in rows if row.rejected)
    return [
        {"pairs": count, "groups": sorted(sorted(images) for images in groups)}
        for groups, count in between.most_common()
    ]


def group_name(name1: str, name2: str) -> str:
    """The group of a pair in hloc's layout."""
    return "/".join(name.replace("/", "-") for name in (name1, name2))


def require_groups(plan: Plan) -> None:
    """Raise InputError if two pairs would share a group of `matches.h5`."""
    groups: dict[str, tuple[str, str]] = {}
    for pair in map(plan.pair, range(len(plan.pairs))):
        if (other := groups.setdefault(group_name(*pair), pair)) != pair:
            raise InputError(f"{' '.join(pair)} and {' '.join(other)} have one name in {MATCHES}")


def write_matches(path: Path, pairs: Iterable[MatchedPair]) -> None:
    """Write the matches of pairs."""
    with h5py.File(path, "w") as file:
        for pair in pairs:
            group = group_name(*pair.row.names)
            matches = pair.matches
            pose = pair.row.pose
            file[f"{group}/keypoints0"] = matches.points1.astype(np.float32)
            file[f"{group}/keypoints1"] = matches.points2.astype(np.float32)
            file[f"{group}/scores"] = matches.confidence.astype(np.float32)
            file[f"{group}/inliers"] = np.zeros(0, bool) if pose is None else pose.inliers
