"""A batch from the source to the result, and its result read again."""

import hashlib
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.local import RunTasks, Workers, local_workers
from dgc_pose.batch.matches_file import PairMatches, group_name, open_matches, read_matches
from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.pair_choice import PairChoice, default_pair_choice, most_similar, similarities
from dgc_pose.batch.plan import Plan, continued, read_plan, write_plan
from dgc_pose.batch.pooling import PooledCamera, centre_moved, pool, write_cameras
from dgc_pose.batch.ray_engine import ray_workers
from dgc_pose.batch.rows import BAD_INPUT, FAILED, PairRow, read_rows
from dgc_pose.batch.schedule import BLOCK, blocks_of, tile_order
from dgc_pose.batch.source import PLAN, Source, survey
from dgc_pose.batch.store import (
    ESTIMATES,
    MATCHES,
    SUMMARY,
    PartStore,
    read_result,
    read_summary,
    rows_path,
)
from dgc_pose.batch.work import FEATURE_BYTES, Describe, Described, Estimate, Job, Match, Matched
from dgc_pose.cameras.calibration import Calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import DgcPoseError, InputError, require
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.status import STATUSES
from dgc_pose.files.inputs import read_bytes
from dgc_pose.files.json_files import write_json
from dgc_pose.files.outputs import only_writer
from dgc_pose.matchers import MatcherOptions
from dgc_pose.network.stored import find_weights, shipped

_ENGINES: Mapping[str, Workers] = {"local": local_workers, "ray": ray_workers}
_BLOCKS_HELD = 4  # of matches in memory, for each worker
Progress = Callable[[str, int, int], None]  # of a stage: its name, how much is done, of how much


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
                yield row, read_matches(file, group_name(row.name1, row.name2))


def run_batch(
    source: Source,
    calibration: Calibration,
    choice: PairChoice | None,
    out: Path,
    *,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
    options: BatchOptions,
    start_workers: Workers | None = None,
    progress: Progress = lambda stage, done, of: None,
) -> Batch:
    """Match the pairs of a source and put the result into `out`.

    choice: how pairs are chosen; None for those of the source, or if it has none, all pairs of up
    to 20 images, and of more each image with its 10 most similar ones. start_workers: None for
    those of `options.engine`.

    Where a focal length has a deviation, each pair fits its own, and the principal point. They are
    pooled over the pairs of a camera, and the poses are estimated again with the pooled cameras,
    from the same matches.

    A batch that is resumed matches the pairs that are not done, that failed, or whose photographs
    have changed since.

    Raises InputError if there is a batch in `out` already and `resume` is not asked for, if that
    one had other settings, images or cameras, or if the input is unusable; OSError if the disk is
    full.
    """
    start = time.perf_counter()
    begin = start_workers or _ENGINES[options.engine]
    needs = {"--engine ray": "ray"} if options.engine == "ray" else {}
    require(needs | ({"--format parquet": "batch"} if options.format == "parquet" else {}))
    # The reasons of bad images name the folder: it must be the same when the batch is resumed.
    source = replace(source, root=source.root.resolve())
    if choice is None and source.pairs is None:
        choice = default_pair_choice(len(source.names))
    settings = {
        "pairs": "source" if choice is None else asdict(choice),
        "weights": matcher.weights,
        "weights_sha256": _weights_hash(matcher.weights),
        "runtime": matcher.runtime,
        "half_precision": matcher.half_precision,
        "matching": asdict(matcher.matching),
        "refinement": asdict(matcher.refinement),
        "estimation": asdict(estimation),
        "format": options.format,
    }
    with _folder_alone(out):
        before = _plan_before(out, options.resume)
        plan = _first_plan(source, calibration, choice, settings)
        if before is not None:
            plan = continued(before, plan, out)
        store: PartStore | None = None
        cameras: list[PooledCamera] = []
        try:
            with ExitStack() as stack:
                images = (plan.root, plan.cameras, plan.bad)
                job = Job(*images, matcher, estimation, options.worker_bytes)
                run = _lazy(lambda: begin(job, options.worker_count), stack)
                if before is None:
                    if choice is not None and choice.way == "auto":
                        plan = _with_similar(plan, choice.number, run, progress)
                    write_plan(out, plan)
                store = whole = PartStore(out, plan, before)
                worked = 0
                if not store.finished:
                    if plan.uncertain and (store.left or store.result_alone):
                        PartStore(out, plan, folder=ESTIMATES).close()  # by other cameras
                    worked = _match(store, plan, run, options, progress)
                    if plan.uncertain:
                        whole = PartStore(out, plan, folder=ESTIMATES)
                        plan, cameras = _estimate(
                            store, whole, plan, before, run, options, progress
                        )
        except DgcPoseError:
            # If no pair was matched, as with bad weights, the folder is left as it was.
            if before is None and store is not None and len(store.left) == len(plan.pairs) > 0:
                store.close()
                (out / PLAN).unlink()
            raise
        if not store.finished:
            whole.assemble()
            if plan.uncertain:
                write_cameras(out, plan.final_cameras)
            if before is not None or plan.uncertain:
                write_plan(out, plan)  # with photographs and focal lengths as they are now
            seconds = time.perf_counter() - start
            _summarise(out, plan, store.bad, cameras, worked, seconds)
        whole.close()
        store.close()
        return read_batch(out)


@contextmanager
def _folder_alone(out: Path) -> Iterator[None]:
    """The folder to this process alone; made if missing, and removed if nothing is written."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is there already, and no folder of `dgc-pose batch`")
    made = [path for path in (out, *out.parents) if not path.exists()]
    out.mkdir(parents=True, exist_ok=True)
    try:
        with only_writer(out):
            yield
    finally:
        with suppress(OSError):  # it holds something
            for path in made:
                path.rmdir()


def read_batch(out: Path) -> Batch:
    """The result of a finished batch. Raises InputError, with the path, if it is not finished, or
    a file of it is broken."""
    plan = read_plan(out)
    if not (out / SUMMARY).is_file():
        raise InputError(f"{out}: the batch there is not finished: --resume goes on with it")
    return Batch(out, plan, list(read_result(out, plan)), read_summary(out))


def _plan_before(out: Path, resume: bool) -> Plan | None:
    """The plan of the batch in `out`, which is to be resumed; None without one."""
    if not (out / PLAN).is_file():
        if any(not path.name.startswith(".") for path in out.iterdir()):
            raise InputError(f"{out}: is there already, and no folder of `dgc-pose batch`")
        return None
    if not resume:
        raise InputError(f"{out}: holds a batch already: --resume goes on with it")
    return read_plan(out)


def _first_plan(
    source: Source,
    calibration: Calibration,
    choice: PairChoice | None,
    settings: Mapping[str, Any],
) -> Plan:
    """The plan; without pairs where they are chosen by the images' features."""
    if choice is not None:
        chosen = choice.pairs(len(source.names))
    else:
        position = {name: i for i, name in enumerate(source.names)}
        chosen = [(position[a], position[b]) for a, b in source.pairs or ()]
    pairs = np.array(chosen, dtype=np.int64).reshape(-1, 2)
    return Plan(source.root, *survey(source, calibration), source.names, pairs, settings)


def _lazy(start: Callable[[], AbstractContextManager[RunTasks]], stack: ExitStack) -> RunTasks:
    """Runs tasks by workers that are started by the first of them: unusable input needs none."""
    workers = cache(lambda: stack.enter_context(start()))
    return lambda tasks: workers()(tasks) if tasks else iter(())


def _with_similar(plan: Plan, number: int, run: RunTasks, progress: Progress) -> Plan:
    """The plan with the pairs of each image and its `number` most similar ones, and with the bad
    images that showed up."""
    features: dict[str, np.ndarray] = {}
    bad = dict(plan.bad)
    for outcome in run([Describe(tuple(names)) for names in blocks_of(plan.names, 4)]):
        assert isinstance(outcome, Described)
        bad.update(outcome.bad)
        features.update(outcome.features)
        progress("images", len(features) + len(bad), len(plan.names))
    usable = [i for i, name in enumerate(plan.names) if name in features]
    scores = similarities([features[plan.names[i]] for i in usable])
    pairs = [(usable[i], usable[j]) for i, j in most_similar(scores, number)]
    return replace(plan, bad=bad, pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2))


def _match(
    store: PartStore, plan: Plan, run: RunTasks, options: BatchOptions, progress: Progress
) -> int:
    """Match the pairs that are left; returns their number."""
    left = np.array(store.left, dtype=np.int64)
    order = left[tile_order(plan.pairs[left], len(plan.names), _capacity(plan, options))]
    # Small batches in small blocks, so that all workers have something to do.
    size = int(min(BLOCK, max(1, len(left) // (4 * options.worker_count))))
    tasks = [
        Match(tuple(block), tuple(plan.pair(index) for index in block))
        for block in blocks_of(order.tolist(), size)
    ]
    total = len(plan.pairs)
    done = total - len(left)
    progress("pairs", done, total)
    for outcome in run(tasks):
        assert isinstance(outcome, Matched)
        store.add(outcome)
        done += len(outcome.indices)
        progress("pairs", done, total)
    return len(left)


def _estimate(
    store: PartStore,
    whole: PartStore,
    plan: Plan,
    before: Plan | None,
    run: RunTasks,
    options: BatchOptions,
    progress: Progress,
) -> tuple[Plan, list[PooledCamera]]:
    """Pool the focal lengths of all pairs, and estimate the poses that `whole` lacks again.

    store: of the pairs as they are matched, each with its own focal lengths. before: the plan of an
    earlier result. Returns the plan with the pooled cameras, and those one by one.
    """
    total = len(plan.pairs)

    def estimated(
        blocks: Iterator[Matched], cameras: Mapping[str, Camera], done: int, *, fit: bool
    ) -> Iterator[Matched]:
        while chunk := list(islice(blocks, _BLOCKS_HELD * options.worker_count)):
            tasks = []
            for block in chunk:
                names = {name for row in block.rows for name in (row.name1, row.name2)}
                of_block = {name: cameras[name] for name in names & cameras.keys()}
                rows, matches = tuple(block.rows), tuple(block.matches)
                tasks.append(Estimate(block.indices, rows, matches, of_block, fit))
            for outcome in run(tasks):
                assert isinstance(outcome, Matched)
                yield outcome
                done += len(outcome.indices)
                progress("poses", done, total)

    if before is not None:
        # As if they had just been matched: the result has the poses by the pooled cameras.
        done = total - len(store.result_alone)
        for outcome in estimated(store.result_blocks(before, BLOCK), plan.cameras, done, fit=True):
            store.add(outcome)
    cameras, pooled = pool(plan.cameras, _pairs(store.blocks()))
    if centre_moved(plan.cameras, cameras):
        middle = {name: replace(c, K=cameras[name].K) for name, c in plan.cameras.items()}
        again = estimated(store.blocks(), middle, 0, fit=True)
        cameras, pooled = pool(middle, _pairs(again))
    left = set(whole.left)
    blocks = (block for block in store.blocks() if not left.isdisjoint(block.indices))
    for outcome in estimated(blocks, cameras, total - len(left), fit=False):
        whole.add(outcome)
    return replace(plan, pooled=cameras), pooled


def _pairs(blocks: Iterable[Matched]) -> Iterator[tuple[PairRow, PairMatches]]:
    """The rows and matches one by one."""
    for block in blocks:
        yield from zip(block.rows, block.matches, strict=True)


def _capacity(plan: Plan, options: BatchOptions) -> int:
    """Images that fit into the memory of one worker."""
    sizes = [camera.size for camera in plan.cameras.values() if camera.size is not None]
    largest = max((3 * width * height for width, height in sizes), default=1)
    return max(2, options.worker_bytes // (largest + FEATURE_BYTES))


def _summarise(
    out: Path,
    plan: Plan,
    bad: Mapping[str, str],
    cameras: Sequence[PooledCamera],
    worked: int,
    seconds: float,
) -> None:
    """summary.json; its `seconds` and `matched_now` are those of the last run."""
    by_status = Counter(row.status for row in read_rows(rows_path(out, plan)))
    data = {
        "images": len(plan.names),
        "bad_images": dict(sorted(bad.items())),
        "cameras": [
            {
                "images": len(pooled.names),
                "first_image": pooled.names[0],
                "focal_px": pooled.camera.focal,
                "focal_std": pooled.camera.focal_std,
                "focal_source": pooled.camera.focal_source,
                "centre_px": pooled.camera.K[:2, 2].tolist(),
                "centre_std_px": pooled.camera.centre_std,
                "pairs": pooled.pairs,
            }
            for pooled in cameras
        ],
        "pairs": len(plan.pairs),
        "poses": sum(by_status[status] for status, facts in STATUSES.items() if facts.has_t),
        "bad_pairs": by_status[BAD_INPUT],
        "failed_pairs": by_status[FAILED],
        "by_status": dict(sorted(by_status.items())),
        "matched_now": worked,
        "seconds": round(seconds, 2),
    }
    write_json(out / SUMMARY, data)


def _weights_hash(weights: str) -> str | None:
    """The first digits of the SHA-256 of a weights file; None for a matcher without weights."""
    path = find_weights(weights) if weights in shipped() else Path(weights)
    return hashlib.sha256(read_bytes(path)).hexdigest()[:16] if path.is_file() else None
