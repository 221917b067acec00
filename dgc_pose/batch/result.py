"""The result of a batch: `pairs.jsonl`, `matches.h5`, `summary.json`, and `cameras.csv` of pooled
cameras, in the order of the pairs whatever the order in which they were done."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py

from dgc_pose.batch.matches_file import (
    PairMatches,
    group_name,
    open_matches,
    read_matches,
    write_matches,
)
from dgc_pose.batch.plan import Plan, read_plan
from dgc_pose.batch.pooling import PooledCamera
from dgc_pose.batch.rows import BAD_INPUT, FAILED, PairRow, read_rows, write_rows
from dgc_pose.batch.work import Matched
from dgc_pose.errors import InputError
from dgc_pose.estimation.status import STATUSES
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import replaced, require_room

PAIRS, MATCHES, SUMMARY = "pairs.jsonl", "matches.h5", "summary.json"


@dataclass(frozen=True, eq=False)
class Batch:
    """The result of a batch, as its folder holds it."""

    folder: Path
    plan: Plan
    rows: Sequence[PairRow]  # in the order of the pairs
    summary: Mapping[str, Any]

    def matches(self) -> Iterator[tuple[PairRow, PairMatches]]:
        """Each row with its matches. Raises InputError if the file is cut short."""
        with open_matches(self.folder / MATCHES) as file:
            for row in self.rows:
                yield row, read_matches(file, group_name(*row.names))


def is_finished(out: Path) -> bool:
    """Whether the folder has a result; not whether it is whole."""
    return (out / SUMMARY).is_file()


def read_batch(out: Path) -> Batch:
    """The result of a finished batch. Raises InputError, with the path, if it is not finished, or
    a file of it is broken."""
    plan = read_plan(out)
    if not is_finished(out):
        raise InputError(f"{out}: the batch there is not finished: --resume goes on with it")
    rows = list(read_rows(out / PAIRS))
    if len(rows) != len(plan.pairs):
        raise InputError(
            f"{out / PAIRS}: {len(rows)} rows, and the plan has {len(plan.pairs)} pairs"
        )
    summary = read_json(out / SUMMARY, "the summary of a batch")
    if not isinstance(summary, dict) or not isinstance(summary.get("bad_images"), dict):
        raise InputError(f"{out / SUMMARY}: not the summary of a batch")
    return Batch(out, plan, rows, summary)


def write_pairs(out: Path, blocks: Iterable[Matched], size: int) -> list[PairRow]:
    """Write the rows and the matches of all pairs, and return the rows in the order of the pairs.

    size: of the matches, bytes, roughly.
    """
    with replaced(out / PAIRS) as pairs, replaced(out / MATCHES) as matches:
        require_room(out / MATCHES, size)
        by_index: dict[int, PairRow] = {}
        with h5py.File(matches, "w") as file:
            for block in blocks:
                by_index |= zip(block.indices, block.rows, strict=True)
                for row, of_pair in zip(block.rows, block.matches, strict=True):
                    write_matches(file.create_group(group_name(*row.names)), of_pair)
        rows = [by_index[index] for index in sorted(by_index)]
        write_rows(pairs, rows)
    return rows


def summary_of(
    plan: Plan, rows: Sequence[PairRow], bad: Mapping[str, str], cameras: Sequence[PooledCamera]
) -> dict[str, Any]:
    """The content of `summary.json`. bad: the reasons by image; cameras: the pooled ones."""
    by_status = Counter(row.status for row in rows)
    return {
        "images": len(plan.names),
        "bad_images": dict(sorted(bad.items())),
        "cameras": [_camera_facts(pooled) for pooled in cameras],
        "pairs": len(plan.pairs),
        "poses": sum(by_status[status] for status, facts in STATUSES.items() if facts.has_t),
        "bad_pairs": by_status[BAD_INPUT],
        "failed_pairs": by_status[FAILED],
        "by_status": dict(sorted(by_status.items())),
    }


def _camera_facts(pooled: PooledCamera) -> dict[str, Any]:
    first, camera = next(iter(pooled.cameras.items()))
    return {
        "images": len(pooled.cameras),
        "first_image": first,
        "focal_px": camera.focal,
        "focal_std": camera.focal_std,
        "focal_source": camera.focal_source,
        "centre_px": camera.K[:2, 2].tolist(),
        "centre_std_px": camera.centre_std,
        "lens_std": camera.lens_std,
        "pairs": pooled.pairs,
        "why": pooled.why,
    }
