"""Many calls in one process, four threads at once, and spawned processes: the same bits, no growth.

PYTHONPATH=tests python -m fuzz.endurance --calls 1000
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import scipy.stats
from fuzz.trial import resident

from dgc_pose import EstimationOptions, estimate_relative_pose, load_matcher
from dgc_pose.cameras.pair_list import bundled_pair

STEP = 20  # calls between two lines
GROWTH = 20 * 2**20  # bytes that 1,000 calls may keep
RUNS = EstimationOptions(runs=2, iterations=200)


def digest(_: int = 0, matcher: object = None) -> str:
    """Of the bundled pair's pose and inliers."""
    pair = bundled_pair()
    own = matcher or load_matcher(refinement=None)
    pose = estimate_relative_pose(
        pair.path1, pair.path2, pair.camera1, pair.camera2, matcher=own, options=RUNS
    )
    assert pose.R is not None and pose.t is not None
    parts = (pose.R, pose.t, pose.inliers)
    return hashlib.sha256(
        b"".join(np.ascontiguousarray(one).tobytes() for one in parts)
    ).hexdigest()


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--calls", type=int, default=1000)
    given = parser.parse_args()
    matcher = load_matcher(refinement=None)
    first = digest(matcher=matcher)
    with ThreadPoolExecutor(4) as threads:
        threaded = set(threads.map(lambda k: digest(k, matcher), range(8)))
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as processes:
        spawned = set(processes.map(digest, range(2)))
    same = threaded == spawned == {first}
    print(
        f"four threads and two spawned processes: {'the same' if same else 'OTHER'} bits",
        flush=True,
    )
    held: list[float] = []  # bytes resident after each call
    for call in range(1, given.calls + 1):
        same = same and digest(call, matcher) == first
        held.append(resident())
        if call % STEP == 0:
            print(f"call {call}: {held[-1] / 2**20:.1f} MiB", flush=True)
    grown, slope = growth(held)
    bits = "the same" if same else "OTHER"
    print(
        f"{given.calls} calls, {bits} bits: most {max(held) / 2**20:.0f} MiB, "
        f"{grown / 2**20:+.1f} MiB from the second tenth to the last, "
        f"{slope / 2**10:+.1f} KiB a call"
    )
    return 0 if same and grown < GROWTH else 1


def growth(held: Sequence[float]) -> tuple[float, float]:
    """Bytes gained from the second tenth of the calls to the last, and bytes a call over all but
    the first tenth.

    held: bytes resident after each call. Medians and the slope of Theil and Sen: what one call
    returns late does not count.
    """
    tenth = max(1, len(held) // 10)
    kept = np.array(held[tenth:] or held)
    grown = float(np.median(kept[-tenth:]) - np.median(kept[:tenth]))
    slope = float(scipy.stats.theilslopes(kept).slope) if len(kept) > 1 else 0.0
    return grown, slope


if __name__ == "__main__":
    sys.exit(main())
