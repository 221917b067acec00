"""A data set for the evaluation's loop: the two views of `dense_scene`, over and over."""

from pathlib import Path
from types import SimpleNamespace

import dense_scene
import numpy as np

from dgc_pose.benchmarks.evaluate import score
from dgc_pose.benchmarks.methods import Method, parse_methods
from dgc_pose.benchmarks.posed_pairs import ListedPairs
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import Image
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher, MatchingOptions, MatchResult, select_matches

MATCHER = MatcherOptions(matching=MatchingOptions(max_matches=400, aligned="none"))
ESTIMATION = EstimationOptions(runs=2, iterations=100)
METHODS = parse_methods(["net", "net/all", "some"], MATCHER, ESTIMATION)


class Net(Matcher):
    """Matches by the true map with an error that depends on the view of image 2."""

    name = "net"

    def __init__(self, options: MatchingOptions) -> None:
        self.options = options

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        found = dense_scene.true_map(error_px=0.05 * view_of(image2.name))
        return MatchResult(select_matches(found, self.options), found)


class Some(Matcher):
    """Matches 60 points of the true map, and no map."""

    name = "some"

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        found = dense_scene.true_map()
        inside = found.matchability > 0.5
        rng = np.random.default_rng(view_of(image2.name))
        chosen = rng.choice(int(inside.sum()), 60, replace=False)
        points1, points2 = found.map[inside][chosen], found.grid[inside][chosen]
        return MatchResult(Matches(points1, points2, np.ones(60), 0.5), None)


def view_of(name: str) -> int:
    """The number of a view, from the name of its file."""
    return int(Path(name).stem.partition("_")[2])


def posed_pairs(folder: Path, count: int, size: tuple[int, int] | None = None) -> ListedPairs:
    """`count` pairs of views (1, 2), (1, 3) and so on, of the same two pictures."""
    dense_scene.write_pictures(folder)
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    pairs = []
    for view in range(2, 2 + count):
        name = f"two_{view}.png"
        (folder / name).write_bytes((folder / "two.png").read_bytes())
        t = 120 * dense_scene.T
        pairs.append(Pair("one.png", name, folder, camera, camera, dense_scene.R, t))
    return ListedPairs(pairs, size=size)


def scored(pairs: ListedPairs, methods: list[Method] = METHODS) -> list[list[SimpleNamespace]]:
    """The records of methods named as `METHODS`, pair by pair."""
    matchers = [Some() if m.matcher.weights == "some" else Net(m.matcher.matching) for m in methods]
    return [
        [
            SimpleNamespace(**score((listed.name1, listed.name2), pairs.pair(number), *each))
            for each in zip(methods, matchers, strict=True)
        ]
        for number, listed in enumerate(pairs.pairs)
    ]
