"""The two protocols: what the methods are shown of a pair, and how the pose is estimated.

`paper`: both images squared to 256x256 first, K changed with them, every match goes into five
RANSAC runs of 1000 iterations, and the best of them is the answer (Melekhov et al., section 4.4).
`native`: the images as they are, a network's matches refined on them, an even subsample of the
matches, and the pose refined on its inliers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from dgc_pose.benchmarks.dtu.records import Protocol
from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.camera import Camera, check_size
from dgc_pose.estimation import EstimationOptions
from dgc_pose.image import Image, load_image, resize
from dgc_pose.matching import MatchingOptions
from dgc_pose.matching.cache import BoundedCache

PAPER_SIZE = (256, 256)  # width, height
EVERY_MATCH = 2**31  # more than any map has cells
DESCRIPTIONS: Mapping[Protocol, str] = {
    "paper": "images squared to 256x256, every match of a pair, no refinement beyond RANSAC",
    "native": "images as stored, an even subsample of the matches, matches and poses refined",
}
_IMAGE_BYTES = 2**29


@dataclass(frozen=True)
class ShownPair:
    """A pair as the methods see it."""

    scene: int
    view1: int
    view2: int
    image1: Image
    image2: Image
    size1: tuple[int, int]  # (width, height) of the images as stored
    size2: tuple[int, int]
    truth: Pair  # its cameras are those of image1 and image2


@dataclass(frozen=True)
class _Prepared:
    image: Image
    stored_size: tuple[int, int]


class PairReader:
    """Reads pairs as a protocol shows them; an image that was read lately is not read again."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._images: BoundedCache[str, _Prepared] = BoundedCache(
            lambda _, prepared: prepared.image.pixels.nbytes, _IMAGE_BYTES
        )

    def read(self, scene: int, view1: int, view2: int, pair: Pair) -> ShownPair:
        """Raises ImageError for an image that cannot be read, InputError where a K cannot belong
        to it."""
        one, two = self._image(str(pair.path1)), self._image(str(pair.path2))
        for camera, prepared in ((pair.camera1, one), (pair.camera2, two)):
            check_size(camera, prepared.stored_size, f"K of {prepared.image.name}")
        camera1, camera2 = self._camera(pair.camera1, one), self._camera(pair.camera2, two)
        return ShownPair(
            scene,
            view1,
            view2,
            one.image,
            two.image,
            one.stored_size,
            two.stored_size,
            replace(pair, camera1=camera1, camera2=camera2),
        )

    def _image(self, path: str) -> _Prepared:
        return self._images.get(path, lambda: self._prepare(path))

    def _prepare(self, path: str) -> _Prepared:
        image = load_image(path)
        size = image.size
        if self.protocol == "paper":
            image = replace(image, pixels=resize(image.pixels, PAPER_SIZE), stored_size=size)
        return _Prepared(image, size)

    def _camera(self, camera: Camera, prepared: _Prepared) -> Camera:
        sized = replace(camera, size=prepared.stored_size)
        return sized.resized(prepared.image.size)


def estimation_options(protocol: Protocol, options: EstimationOptions) -> EstimationOptions:
    """The user's options with what the protocol says about refinement."""
    return replace(options, refine=protocol == "native")


def matching_options(protocol: Protocol, options: MatchingOptions) -> MatchingOptions:
    """The user's options with what the protocol says about the number of matches."""
    if protocol == "native":
        return options
    return replace(options, max_matches=EVERY_MATCH)
