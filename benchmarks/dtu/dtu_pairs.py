"""DTU's pairs as the methods see them, by one of two protocols.

`paper`: both images squared to 256x256 first, K changed with them, every match goes into five
RANSAC runs of 1000 iterations, and the best of them is the answer (Melekhov et al., section 4.4).
`native`: the images as they are, a network's matches refined on them, an even subsample of the
matches, and the pose refined on its inliers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

from dgc_pose.benchmarks.dtu.view_pairs import ViewPair
from dgc_pose.benchmarks.posed_pairs import FilePairs
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions

Protocol = Literal["paper", "native"]

PAPER_SIZE = (256, 256)  # width, height
EVERY_MATCH = 2**31  # more than any map has cells
DESCRIPTIONS: Mapping[Protocol, str] = {
    "paper": "images squared to 256x256, every match, the best of --runs RANSAC runs (the "
    "paper's: 5 of 1000 iterations), not refined",
    "native": "images as stored, an even subsample of the matches, matches and poses refined",
}


class DtuPairs(FilePairs[DtuScore]):
    """Pairs of views. The seed of each comes of its scene and views."""

    def __init__(
        self, views: Sequence[ViewPair], pairs: Sequence[Pair], protocol: Protocol
    ) -> None:
        keys = [(view.scene, view.view1, view.view2) for view in views]
        # The names of files of stored matches, by the paths of a pair's images
        self.stems = {
            (str(pair.path1), str(pair.path2)): f"scan{scene}_{view1}_{view2}"
            for pair, (scene, view1, view2) in zip(pairs, keys, strict=True)
        }
        ids = [
            {
                "scene": view.scene,
                "view1": view.view1,
                "view2": view.view2,
                "image1": pair.name1,
                "image2": pair.name2,
                "protocol": protocol,
                "overlap": view.overlap,
            }
            for view, pair in zip(views, pairs, strict=True)
        ]
        size = PAPER_SIZE if protocol == "paper" else None
        super().__init__(DtuScore, pairs, ids, seeds=keys, size=size)


def protocol_options(
    protocol: Protocol, matcher: MatcherOptions, estimation: EstimationOptions
) -> tuple[MatcherOptions, EstimationOptions]:
    """The user's options with the protocol's settings for matches and refinement."""
    if protocol == "native":
        return matcher, estimation
    matching = replace(matcher.matching, max_matches=EVERY_MATCH, aligned="none")
    return replace(matcher, matching=matching), replace(estimation, refine=False)
