"""Many calls in one process, four threads at once, and spawned processes: the same bits, no growth.

PYTHONPATH=tests python -m fuzz.endurance --calls 1000
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
from fuzz.trial import resident

from dgc_pose import EstimationOptions, estimate_relative_pose, load_matcher
from dgc_pose.benchmarks.pair_list import bundled_pair

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
    print(f"four threads and two spawned processes: {'the same' if same else 'OTHER'} bits")
    warm = 0.0
    for call in range(1, given.calls + 1):
        same = same and digest(call, matcher) == first
        if call == max(1, given.calls // 10):
            warm = resident()
    grown = (resident() - warm) / 2**20
    print(
        f"{given.calls} calls: {warm / 2**20:.0f} MiB after a tenth of them, {grown:+.0f} MiB since"
    )
    return 0 if same and grown < 20 else 1


if __name__ == "__main__":
    sys.exit(main())
