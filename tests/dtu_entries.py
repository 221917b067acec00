"""A list of pairs for the DTU benchmark's loop: the two views of `dense_scene`, over and over."""

from __future__ import annotations

from pathlib import Path

import dense_scene
import numpy as np

from dgc_pose.benchmarks.dtu.entries import Entry
from dgc_pose.benchmarks.dtu.methods import Engines, Found, Method
from dgc_pose.benchmarks.dtu.protocols import ShownPair
from dgc_pose.benchmarks.dtu.run import RunOptions
from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.camera import Camera
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchingOptions

METHODS = [Method("net", "net"), Method("net/all", "net", everywhere=True), Method("some", "some")]
FAST = RunOptions(
    "native",
    MatchingOptions(max_matches=400),
    EstimationOptions(runs=2, iterations=100),
)


def entries(folder: Path, count: int) -> list[Entry]:
    """`count` pairs of scan 65, (1, 2), (1, 3) and so on, of the same two pictures."""
    dense_scene.write_pictures(folder)
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    truth = Pair(
        "one.png", "two.png", folder, camera, camera, dense_scene.R, 120 * dense_scene.T
    )
    return [Entry(65, 1, 2 + number, 0.8, truth) for number in range(count)]


def engines() -> Engines:
    """`net` finds the true map with an error that hangs on the pair, `some` a few points of it."""

    def dense(shown: ShownPair) -> Found:
        return dense_scene.true_map(error_px=0.05 * shown.view2)

    def some(shown: ShownPair) -> Found:
        found = dense_scene.true_map()
        inside = found.matchability > 0.5
        rng = np.random.default_rng(shown.view2)
        chosen = rng.choice(int(inside.sum()), 60, replace=False)
        return Matches(found.map[inside][chosen], found.grid[inside][chosen], np.ones(60), 0.5)

    return Engines(
        {
            "net": lambda shown: [dense(one) for one in shown],
            "some": lambda shown: [some(one) for one in shown],
        },
        caches={},
        fingerprints={},
        refiners={},
    )
