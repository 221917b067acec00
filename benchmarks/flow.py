"""Dense optical flow as a matcher, for comparison with a correspondence network."""

import cv2
import numpy as np

from dgc_pose.geometry.pixels import pixel_grid, rescale
from dgc_pose.geometry.sampling import bilinear
from dgc_pose.images.image import Image, resize
from dgc_pose.matching.correspondence_map import CorrespondenceMap, MatchingOptions, select_matches
from dgc_pose.matching.matcher import Matcher, MatchResult

NAME = "dis"  # in lists of methods
LONGEST_SIDE = 640  # pixels; larger images are shrunk to it before the flow is computed
_LEAST_SIDE = 16  # pixels


class FlowMatcher(Matcher):
    """Dense inverse search (Kroeger et al., ECCV 2016; OpenCV's DIS) from image 2 to image 1."""

    name = NAME

    def __init__(self, options: MatchingOptions | None = None) -> None:
        self.options = options or MatchingOptions()

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """The map over the pixels of image 2, or of its shrunk copy, and the matches selected.

        Both images are brought to one size. Matchability is 1 if the forward and the backward flow
        agree (see `agreement`), and 0 otherwise.
        """
        share = min(1.0, LONGEST_SIDE / max(image2.size))
        width, height = (max(round(share * side), _LEAST_SIDE) for side in image2.size)
        grey1, grey2 = (
            cv2.cvtColor(resize(image.pixels, (width, height)), cv2.COLOR_RGB2GRAY)
            for image in (image1, image2)
        )
        dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        forward, backward = (
            dis.calc(*greys, np.zeros((height, width, 2), np.float32))
            for greys in ((grey2, grey1), (grey1, grey2))
        )
        correspondence_map = scaled_map(
            pixel_grid((width, height)) + forward,
            agreement(forward, backward),
            image1.size,
            image2.size,
        ).masked(image1, image2)
        return MatchResult(select_matches(correspondence_map, self.options), correspondence_map)


def agreement(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """Whether a flow (H, W, 2) and the backward flow at its end points cancel: (H, W) float32.

    1 if |f + b|^2 < 0.01 (|f|^2 + |b|^2) + 0.5, in pixels (Sundaram et al. 2010, equation 5); 0
    otherwise, and 0 if the flow leaves the image.
    """
    height, width = forward.shape[:2]
    ends = (pixel_grid((width, height)) + forward).astype(np.float32)
    returned = bilinear(backward.astype(np.float32), ends)
    error = ((forward + returned) ** 2).sum(-1)
    agrees = error < 0.01 * ((forward**2).sum(-1) + (returned**2).sum(-1)) + 0.5
    inside = ((ends >= -0.5) & (ends <= np.array([width, height]) - 0.5)).all(-1)
    return (agrees & inside).astype(np.float32)


def scaled_map(
    points1: np.ndarray, matchability: np.ndarray, size1: tuple[int, int], size2: tuple[int, int]
) -> CorrespondenceMap:
    """A map over both images resized to W x H, as a map over images of sizes 1 and 2.

    points1: (H, W, 2) pixels of image 1 at W x H, one for each pixel of image 2 at W x H.
    """
    size = (points1.shape[1], points1.shape[0])
    return CorrespondenceMap(
        map=rescale(points1, size, size1).astype(np.float32),
        grid=rescale(pixel_grid(size), size, size2).astype(np.float32),
        matchability=np.asarray(matchability, dtype=np.float32),
        size1=size1,
        size2=size2,
    )
