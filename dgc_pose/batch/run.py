"""Run a batch, from the source to the result."""

import hashlib
import shlex
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from dgc_pose.batch.folder_cameras import PooledCamera, by_image, folder_cameras
from dgc_pose.batch.groups import joining
from dgc_pose.batch.look_alikes import folder_probabilities
from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.pairs import FAILED, MatchedPair, PairRow
from dgc_pose.batch.result import (
    MATCHES,
    MISSING,
    PAIRS,
    SUMMARY,
    Batch,
    read_batch,
    require_groups,
    summary_of,
    write_files,
)
from dgc_pose.batch.source import STORE, PairChoice, Source, most_similar, similarities, survey
from dgc_pose.batch.store import BatchStore, Plan, continued, open_store
from dgc_pose.batch.workers import (
    FEATURE_BYTES,
    Job,
    PoseRunner,
    Run,
    Worker,
    block_size,
    blocks_of,
    local_workers,
    ray_workers,
    tile_order,
)
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.matchers import MatcherOptions, default_runtime, device_type
from dgc_pose.matching.lightglue import (
    LightGlueMatcher,
    as_second,
    installed_fingerprint,
    is_available,
)
from dgc_pose.network.weights import find_weights, shipped
from dgc_pose.pose import wants_second
from dgc_pose.system.files import only_writer, read_bytes

Progress = Callable[[str, int, int], None]  # stage, items done, all items
_RESUME = ArgumentName("resume")
_EXHAUSTIVE_UP_TO = 20  # images
_MOST_SECOND = 4  # workers that load the second matcher, which takes 1 GB
_MIN_KEPT_INLIERS = 0.5  # of the inliers that a pair had on its own: with fewer there is a warning


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

    choice: how pairs are chosen. None: the pairs of the source; if it has none, all pairs of up to
    20 images, or above 20 each image with its 10 most similar images.

    If a camera has a deviation, each pair fits its own cameras. `folder_cameras` pools these fits,
    and the poses are estimated again with the pooled cameras, from the same matches.

    A resumed batch matches the pairs that are missing, that failed, or whose photographs have
    changed.

    Raises InputError if `out` has a batch and `resume` is not set, if that batch had other
    settings, images or cameras, or if the input is unusable; OSError if the disk is full.
    """
    start = time.perf_counter()
    # Reasons of bad images contain the path, which must be the same when the batch is resumed.
    masks = source.masks and source.masks.resolve()
    source = replace(source, root=source.root.resolve(), masks=masks)
    if choice is None and source.pairs is None:
        many = len(source.names) > _EXHAUSTIVE_UP_TO
        choice = PairChoice("auto", 10) if many else PairChoice("exhaustive")
    weights = matcher.weights
    runtime = matcher.runtime
    file = find_weights(weights) if weights in shipped() else Path(weights)
    digest = hashlib.sha256(read_bytes(file)).hexdigest()[:16] if file.is_file() else None
    if runtime == "auto" and digest is not None:  # the default differs between machines
        runtime = default_runtime(weights, matcher.device)
    second = None
    if source.given is None and matcher.takes_second and wants_second(estimation):
        with as_second():
            second = installed_fingerprint() if is_available() else MISSING
    settings = {
        "command": shlex.join(sys.argv),
        "pairs": "source" if choice is None else asdict(choice),
        "masks": masks and str(masks),
        "weights": weights,
        "weights_sha256": digest,
        "runtime": runtime,
        "device": device_type(matcher.device),
        "matching": asdict(matcher.matching),
        "estimation": asdict(estimation),
        "second": second,
        "given": source.given and [source.given.state, source.given.with_images],
    }
    with _locked_folder(out):
        before: Plan | None = None
        matched: list[PairRow] = []
        if (out / STORE).is_file():
            with open_store(out) as store:
                before = store.plan
                is_finished = store.summary is not None
                if before is not None:
                    matched = store.rows("matched")
        again = {row.index for row in matched if row.status == FAILED}
        if before is not None and not options.resume:
            raise InputError(f"{out} has a batch already:", _RESUME, "continues it")
        place = {name: i for i, name in enumerate(source.names)}
        chosen = [(place[a], place[b]) for a, b in source.pairs or ()]
        if choice is not None:  # "auto" has no pairs before the images are compared
            chosen = choice.pairs(len(source.names))
        pairs = np.array(chosen, dtype=np.int64).reshape(-1, 2)
        plan = Plan(source.root, *survey(source, calibration), source.names, pairs, settings)
        if before is not None:
            plan = continued(before, plan, out)
            changed = {n for n in plan.names if plan.states.get(n) != before.states.get(n)}
            again |= {i for i in range(len(plan.pairs)) if changed.intersection(plan.pair(i))}
            same_second = before.settings.get("second") == second
            if again or not same_second:  # the second matcher's pairs are chosen anew
                again |= {row.index for row in matched if row.second}
            is_written = all((out / name).is_file() for name in (PAIRS, MATCHES, SUMMARY))
            if is_finished and is_written and same_second and not again:
                return read_batch(out)
        limit = options.worker_bytes
        job = Job(
            plan.root, plan.cameras, plan.bad, matcher, estimation, limit, masks, source.given
        )
        # A matcher that cannot be loaded raises before anything is written.
        start_workers = ray_workers if options.engine == "ray" else local_workers
        with start_workers(job, options.worker_count) as run:
            if before is None and choice is not None and choice.way == "auto":
                plan = _with_similar(plan, choice.number, run, progress)
            require_groups(plan)
            with open_store(out, create=True) as store:
                store.begin(plan, again)
                (out / SUMMARY).unlink(missing_ok=True)  # the old result is no longer valid
                worked = _match(store, plan, run, options, progress)
                if second not in (None, MISSING):
                    _match_again(store, plan, run, options, progress)
                poses = PoseRunner(store, run, options.worker_count)
                with store.change():
                    plan, cameras = _pose(store, plan, poses, progress)
                    store.rewrite(folder_probabilities(store.pairs("result"), plan))
                    summary = summary_of(plan, store.rows("result"), cameras)
                    summary["matched_now"] = worked
                    summary["seconds"] = round(time.perf_counter() - start, 2)
                    store.finish(plan, summary)
                    write_files(out, store, plan, summary)
        return read_batch(out)


def _pose(
    store: BatchStore, plan: Plan, poses: PoseRunner, progress: Progress
) -> tuple[Plan, list[PooledCamera]]:
    """Store the pairs of the result, with poses by the cameras of the folder. Returns the plan with
    these cameras, and the list of the pooled cameras."""
    cameras: list[PooledCamera] = []
    pairs = store.pairs("matched")
    earlier = store.rows("matched")
    if plan.uncertain:
        cameras = folder_cameras(poses, plan.cameras)
        plan = replace(plan, pooled=by_image(cameras))
        flipped = [row.index for row in earlier if row.status == "mirrored"]
        others = [row.index for row in earlier if row.status != "mirrored"]
        first = list(poses.estimate(plan.final_cameras, fit=False, only=flipped))
        for pair in first:  # with the folder's cameras, a pair may no longer be mirrored
            earlier[pair.row.index] = pair.row
        pairs = chain(first, poses.estimate(plan.final_cameras, fit=False, only=others))
    for done, pair in enumerate(_with_folder_checks(pairs, earlier), start=1):
        store.add("result", [pair])
        if plan.uncertain:
            progress("poses", done, len(plan.pairs))
    return plan, cameras


def _with_folder_checks(
    pairs: Iterable[MatchedPair], earlier: Sequence[PairRow]
) -> Iterator[MatchedPair]:
    """Yield the pairs. A pose between a mirrored photograph and another becomes "mirrored"; a pose
    that lost most of its inliers gets a warning. earlier: the earlier rows, to compare with."""
    mirrored = _mirrored(earlier)
    inliers = {row.names: row.num_inliers if row.success else 0 for row in earlier}
    for pair in pairs:
        row = pair.row
        pose = pair.row.pose
        one = mirrored.intersection(row.names)
        if pose is not None and pose.t is not None and len(one) == 1:
            why = f"most pairs show {one.pop()} as a mirror image of the other photographs"
            none = np.zeros_like(pose.inliers)
            pose = RelativePose("mirrored", why, none, pose.num_matches)
            row = replace(row, status=pose.status, reason=why, pose=pose)
        elif pose is not None and row.num_inliers < _MIN_KEPT_INLIERS * (
            before := inliers[row.names]
        ):
            few = f"only {row.num_inliers} of {before} inliers remain with the folder's cameras"
            row = replace(row, pose=replace(pose, warnings=(*pose.warnings, few)))
        yield replace(pair, row=row)


def _mirrored(rows: Sequence[PairRow]) -> set[str]:
    """The mirrored photographs. Each photograph is put on one of two sides so that few pairs are
    contradicted: pairs with a pose lie on one side, `mirrored` pairs join both."""
    signs: dict[str, list[tuple[str, int]]] = defaultdict(list)
    for row in rows:
        if row.success or row.status == "mirrored":
            for name, other in (row.names, row.names[::-1]):
                signs[name].append((other, 1 if row.success else -1))
    side = dict.fromkeys(signs, 1)
    while side:
        agreement = {
            name: side[name] * sum(sign * side[other] for other, sign in linked)
            for name, linked in signs.items()
        }
        worst = min(agreement, key=lambda name: agreement[name])
        if agreement[worst] >= 0:
            break
        side[worst] = -side[worst]
    return {name for name in side if side[name] < 0}


@contextmanager
def _locked_folder(out: Path) -> Iterator[None]:
    """Lock the folder for this process. Creates it if missing; removes it if it stays empty."""
    is_used = out.exists() and (not out.is_dir() or any(p.name[0] != "." for p in out.iterdir()))
    if is_used and not (out / STORE).is_file():
        raise InputError(f"{out}: exists already, and is not a batch folder of this version")
    made = [path for path in (out, *out.parents) if not path.exists()]
    out.mkdir(parents=True, exist_ok=True)
    try:
        with only_writer(out):
            yield
    finally:
        with suppress(OSError):  # not empty
            for path in made:
                path.rmdir()


def _with_similar(plan: Plan, number: int, run: Run, progress: Progress) -> Plan:
    """The plan with the pairs of each image and its `number` most similar images, and with the
    images that turned out to be unusable."""
    features: dict[str, np.ndarray] = {}
    bad = dict(plan.bad)
    for described in run(Worker.describe, [(names,) for names in blocks_of(plan.names, 4)]):
        for name, found in described.items():
            if isinstance(found, str):
                bad[name] = found
            else:
                features[name] = found
        progress("images", len(features) + len(bad), len(plan.names))
    usable = [i for i, name in enumerate(plan.names) if name in features]
    found = [features[plan.names[i]] for i in usable]
    scores = similarities(found, partial(progress, "comparisons"))
    pairs = [(usable[i], usable[j]) for i, j in most_similar(scores, number)]
    return replace(plan, bad=bad, pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2))


def _match(
    store: BatchStore, plan: Plan, run: Run, options: BatchOptions, progress: Progress
) -> int:
    """Match the pairs that are not matched yet; return their number."""
    matched = set(store.indices("matched"))
    left = [i for i in range(len(plan.pairs)) if i not in matched]
    size = block_size(len(left), options.worker_count)
    blocks = blocks_of(_ordered(plan, left, options), size)
    found = run(Worker.match, [(block,) for block in blocks])
    _store_each(store, found, partial(progress, "pairs"), len(matched), len(plan.pairs))
    return len(left)


def _match_again(
    store: BatchStore, plan: Plan, run: Run, options: BatchOptions, progress: Progress
) -> None:
    """Match the pairs that would join two groups again, with the second matcher."""
    chosen = joining(store.rows("matched"))
    left = [row.index for row in chosen if not row.second]
    if not left:
        return
    with as_second():
        LightGlueMatcher()  # raises if it is damaged
    workers = options.worker_count
    size = block_size(len(left), workers)
    if workers > _MOST_SECOND:
        size = -(-len(left) // _MOST_SECOND)
    blocks = blocks_of(_ordered(plan, left, options), size)
    found = run(Worker.match, [(block, "auto") for block in blocks])
    before = len(chosen) - len(left)
    _store_each(store, found, partial(progress, "pairs in doubt"), before, len(chosen))


def _store_each(
    store: BatchStore,
    found: Iterable[Sequence[MatchedPair]],
    progress: Callable[[int, int], None],
    done: int,
    total: int,
) -> None:
    """Store matched pairs, block by block. done: pairs of the total that were matched before."""
    progress(done, total)
    for pairs in found:
        with store.change():
            store.add("matched", pairs)
        done += len(pairs)
        progress(done, total)


def _ordered(
    plan: Plan, indices: Sequence[int], options: BatchOptions
) -> list[tuple[int, tuple[str, str]]]:
    chosen = np.array(indices, dtype=np.int64)
    sizes = [camera.size for camera in plan.cameras.values() if camera.size is not None]
    largest = max((3 * width * height for width, height in sizes), default=1)
    capacity = options.worker_bytes // (largest + FEATURE_BYTES)
    order = chosen[tile_order(plan.pairs[chosen], capacity)]
    return [(index, plan.pair(index)) for index in order.tolist()]
