"""The result of a batch: `pairs.jsonl`, `matches.h5`, `summary.json`, and `cameras.csv` of pooled
cameras, in the order of the pairs whatever the order in which they were done."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dgc_pose.batch.matches_file import write_matches
from dgc_pose.batch.plan import Plan
from dgc_pose.batch.pooling import PooledCamera, write_cameras
from dgc_pose.batch.rows import BAD_INPUT, FAILED, MatchedPair, PairRow
from dgc_pose.batch.source import STORE
from dgc_pose.batch.store import BatchStore, open_store
from dgc_pose.errors import InputError
from dgc_pose.estimation.status import STATUSES
from dgc_pose.files.json_files import write_json
from dgc_pose.files.outputs import replaced, require_room, writing

PAIRS, MATCHES, SUMMARY = "pairs.jsonl", "matches.h5", "summary.json"


@dataclass(frozen=True, eq=False)
class Batch:
    """The result of a batch, as its folder holds it."""

    folder: Path
    plan: Plan
    rows: Sequence[PairRow]  # in the order of the pairs
    summary: Mapping[str, Any]

    def pairs(self) -> Iterator[MatchedPair]:
        """Each pair with its matches. Raises InputError if the store is broken."""
        with open_store(self.folder) as store:
            yield from store.pairs("result")


def stored_plan(out: Path) -> Plan | None:
    """The plan of the batch in a folder; None if there is none. Raises InputError, with the path,
    if it is broken."""
    if not (out / STORE).is_file():
        return None
    with open_store(out) as store:
        return store.plan


def read_batch(out: Path) -> Batch:
    """The result of a finished batch. Raises InputError, with the path, if it is not finished, or
    broken."""
    if (plan := stored_plan(out)) is None:
        raise InputError(f"{out}: no folder of `dgc-pose batch` (it has no plan in {STORE})")
    with open_store(out) as store:
        summary = store.summary
        if summary is None:
            raise InputError(f"{out}: the batch there is not finished: --resume goes on with it")
        rows = store.rows("result")
    if [row.names for row in rows] != [plan.pair(i) for i in range(len(plan.pairs))]:
        raise InputError(f"{out / STORE}: the rows are of other pairs than the plan's")
    return Batch(out, plan, rows, summary)


def write_files(out: Path, store: BatchStore, plan: Plan, summary: Mapping[str, Any]) -> None:
    """Write the files of a result, whose pairs are in the store."""
    if plan.uncertain:
        write_cameras(out, plan.final_cameras)
    with replaced(out / PAIRS) as file, writing(file), file.open("w", encoding="utf-8") as stream:
        stream.writelines(f"{line}\n" for _, line in store.lines("result"))
    with replaced(out / MATCHES) as file:
        require_room(out / MATCHES, store.byte_count())
        write_matches(file, store.pairs("result"))
    write_json(out / SUMMARY, summary)


def summary_of(
    plan: Plan, rows: Sequence[PairRow], cameras: Sequence[PooledCamera]
) -> dict[str, Any]:
    """The content of `summary.json`. cameras: the pooled ones."""
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
