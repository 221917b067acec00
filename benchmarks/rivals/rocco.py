"""CNNGeometric with its weights, as a matcher."""

import numpy as np
import torch

from dgc_pose.benchmarks.rivals.geometric_net import GeometricNet, load_rocco
from dgc_pose.geometry.pixels import cell_centres, rescale
from dgc_pose.images.image import Image
from dgc_pose.matching import (
    CorrespondenceMap,
    Matcher,
    MatchingOptions,
    MatchResult,
    select_matches,
)
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.weights import choose_device, network_fingerprint
from dgc_pose.runtime.torch_engine import for_inference, network_input

_SQUARE = (INPUT_SIZE, INPUT_SIZE)


class RoccoMatcher(Matcher):
    """Matches by the affine transformation and the spline between both images, squared."""

    name = "rocco"

    def __init__(self, options: MatchingOptions, device: str = "auto") -> None:
        self.options = options
        self.device = choose_device(device)
        net = load_rocco(self.device)
        self._fingerprint = network_fingerprint(net)
        self.net: GeometricNet = for_inference(net)

    @property
    def fingerprint(self) -> str:
        return self._fingerprint

    @torch.inference_mode()
    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """The map at `finest` x `finest` cells, matchable everywhere, and the matches selected."""
        cells = (self.options.finest, self.options.finest)
        squares = (network_input(image.pixels, _SQUARE, self.device) for image in (image1, image2))
        normalised = self.net.dense_map(*self.net.transformations(*squares), cells[0])
        points = to_pixels(normalised[0].movedim(0, -1), _SQUARE, self.net.config.align_corners)
        correspondence_map = CorrespondenceMap(
            map=rescale(points.cpu().numpy(), _SQUARE, image1.size).astype(np.float32),
            grid=cell_centres(cells, image2.size).astype(np.float32),
            matchability=np.ones(cells, np.float32),
            size1=image1.size,
            size2=image2.size,
        )
        return MatchResult(select_matches(correspondence_map, self.options), correspondence_map)
