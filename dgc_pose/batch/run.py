"""A batch from the source to the result."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.folder_cameras import folder_cameras
from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.pair_choice import PairChoice, default_pair_choice, most_similar, similarities
from dgc_pose.batch.plan import Plan, continued, read_plan, write_plan
from dgc_pose.batch.pooling import PooledCamera, by_image, write_cameras
from dgc_pose.batch.poses import Poses, compared
from dgc_pose.batch.result import SUMMARY, Batch, is_finished, read_batch, summary_of, write_pairs
from dgc_pose.batch.rows import FAILED
from dgc_pose.batch.schedule import block_size, blocks_of, tile_order
from dgc_pose.batch.source import PLAN, Source, survey
from dgc_pose.batch.store import PairStore
from dgc_pose.batch.work import FEATURE_BYTES, Describe, Job, Match, Matched
from dgc_pose.batch.workers import RunTasks, local_workers, ray_workers
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.inputs import read_bytes
from dgc_pose.files.json_files import write_json
from dgc_pose.files.outputs import only_writer
from dgc_pose.matchers import MatcherOptions
from dgc_pose.network.stored import find_weights, shipped
from dgc_pose.runtime.load import default_runtime, device_type

Progress = Callable[[str, int, int], None]  # of a stage: its name, how much is done, of how much
_RESUME = ArgumentName("resume")


def run_batch(
    source: Source,
    calibration: Calibration,
    choice: PairChoice | None,
    out: Path,
    *,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
    options: BatchOptions,
    progress: Progress = lambda stage, done, of: None,
) -> Batch:
    """Match the pairs of a source and put the result into `out`.

    choice: how pairs are chosen; None for those of the source, or if it has none, all pairs of up
    to 20 images, and of more each image with its 10 most similar ones.

    Where a focal length has a deviation, each pair fits its own, and the principal point. From them
    come the cameras of the folder (`folder_cameras`), and with these the poses are estimated again,
    from the same matches.

    A batch that is resumed matches the pairs that are not done, that failed, or whose photographs
    have changed since; all of them if photographs have changed after a result without bad pairs.

    Raises InputError if there is a batch in `out` already and `resume` is not asked for, if that
    one had other settings, images or cameras, or if the input is unusable; OSError if the disk is
    full.
    """
    start = time.perf_counter()
    # The reasons of bad images name the folder: it must be the same when the batch is resumed.
    masks = source.masks and source.masks.resolve()
    source = replace(source, root=source.root.resolve(), masks=masks)
    if choice is None and source.pairs is None:
        choice = default_pair_choice(len(source.names))
    digest, runtime = _weights_hash(matcher.weights), matcher.runtime
    if runtime == "auto" and digest is not None:  # it differs from machine to machine
        runtime = default_runtime(matcher.weights, matcher.device)
    settings = {
        "pairs": "source" if choice is None else asdict(choice),
        "masks": masks and str(masks),
        "weights": matcher.weights,
        "weights_sha256": digest,
        "runtime": runtime,
        "device": device_type(matcher.device),
        "half_precision": matcher.half_precision,
        "matching": asdict(matcher.matching),
        "estimation": asdict(estimation),
        "format": "jsonl",  # of the rows
    }
    with _folder_alone(out):
        if (out / PLAN).is_file() and not options.resume:
            raise InputError(f"{out}: holds a batch already:", _RESUME, "goes on with it")
        before = read_plan(out) if (out / PLAN).is_file() else None
        plan = _first_plan(source, calibration, choice, settings)
        if before is not None:
            plan = continued(before, plan, out)
            if is_finished(out) and plan.same_files(plan.names, before.states):
                result = read_batch(out)
                if all(row.status != FAILED for row in result.rows):
                    return result
        limit = options.worker_bytes
        job = Job(plan.root, plan.cameras, plan.bad, matcher, estimation, limit, masks)
        # What a matcher cannot load is an error before anything is written.
        start_workers = ray_workers if options.engine == "ray" else local_workers
        with start_workers(job, options.worker_count) as run:
            if before is None:
                if choice is not None and choice.way == "auto":
                    plan = _with_similar(plan, choice.number, run, progress)
                write_plan(out, plan)
            (out / SUMMARY).unlink(missing_ok=True)  # the result of before is none any more
            store = PairStore(out, plan)
            poses = Poses(store, run, options.worker_count)
            worked = _match(store, plan, run, options, progress)
            cameras: list[PooledCamera] = []
            blocks, alone = store.blocks(), store.rows
            if plan.uncertain:
                cameras = folder_cameras(poses, plan.cameras)
                plan = replace(plan, pooled=by_image(cameras))
                flipped = [i for i, row in enumerate(alone) if row.status == "mirrored"]
                others = [i for i, row in enumerate(alone) if row.status != "mirrored"]
                first = list(poses.estimated(plan.final_cameras, fit=False, only=flipped))
                for block in first:  # perhaps not by the folder's cameras
                    for index, row in zip(block.indices, block.rows, strict=True):
                        alone[index] = row
                blocks = chain(first, poses.estimated(plan.final_cameras, fit=False, only=others))
                blocks = _counted(blocks, plan, progress)
            blocks = compared(blocks, alone)
            rows = write_pairs(out, blocks, store.byte_count)
        if plan.uncertain:
            write_cameras(out, plan.final_cameras)
        write_plan(out, plan)  # with photographs and focal lengths as they are now
        summary = summary_of(plan, rows, store.bad, cameras)
        seconds = round(time.perf_counter() - start, 2)
        write_json(out / SUMMARY, summary | {"matched_now": worked, "seconds": seconds})
        if not (summary["failed_pairs"] or summary["bad_pairs"]):
            store.remove()
        return read_batch(out)


@contextmanager
def _folder_alone(out: Path) -> Iterator[None]:
    """The folder to this process alone; made if missing, and removed if nothing is written."""
    is_used = out.exists() and (not out.is_dir() or any(p.name[0] != "." for p in out.iterdir()))
    if is_used and not (out / PLAN).is_file():
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


def _with_similar(plan: Plan, number: int, run: RunTasks, progress: Progress) -> Plan:
    """The plan with the pairs of each image and its `number` most similar ones, and with the bad
    images that showed up."""
    features: dict[str, np.ndarray] = {}
    bad = dict(plan.bad)
    for outcome in run([Describe(tuple(names)) for names in blocks_of(plan.names, 4)]):
        assert isinstance(outcome, dict)
        for name, described in outcome.items():
            if isinstance(described, str):
                bad[name] = described
            else:
                features[name] = described
        progress("images", len(features) + len(bad), len(plan.names))
    usable = [i for i, name in enumerate(plan.names) if name in features]
    scores = similarities([features[plan.names[i]] for i in usable])
    pairs = [(usable[i], usable[j]) for i, j in most_similar(scores, number)]
    return replace(plan, bad=bad, pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2))


def _match(
    store: PairStore, plan: Plan, run: RunTasks, options: BatchOptions, progress: Progress
) -> int:
    """Match the pairs that are left; returns their number."""
    left = np.array(store.left, dtype=np.int64)
    order = left[tile_order(plan.pairs[left], len(plan.names), _capacity(plan, options))]
    size = block_size(len(left), options.worker_count)
    tasks = [
        Match(tuple(block), tuple(plan.pair(index) for index in block))
        for block in blocks_of(order.tolist(), size)
    ]
    progress("pairs", len(store), len(plan.pairs))
    for outcome in run(tasks):
        assert isinstance(outcome, Matched)
        store.add(outcome)
        progress("pairs", len(store), len(plan.pairs))
    return len(left)


def _counted(blocks: Iterator[Matched], plan: Plan, progress: Progress) -> Iterator[Matched]:
    """The blocks, whose pairs are counted as they come."""
    done = 0
    for block in blocks:
        yield block
        done += len(block.indices)
        progress("poses", done, len(plan.pairs))


def _capacity(plan: Plan, options: BatchOptions) -> int:
    """Images that fit into the memory of one worker."""
    sizes = [camera.size for camera in plan.cameras.values() if camera.size is not None]
    largest = max((3 * width * height for width, height in sizes), default=1)
    return max(2, options.worker_bytes // (largest + FEATURE_BYTES))


def _weights_hash(weights: str) -> str | None:
    """The first digits of the SHA-256 of a weights file; None for a matcher without weights."""
    path = find_weights(weights) if weights in shipped() else Path(weights)
    return hashlib.sha256(read_bytes(path)).hexdigest()[:16] if path.is_file() else None
