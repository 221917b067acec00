"""Dense maps compared with the true ones, on pairs of photographs of planes.

A homography H maps pixels of the first image to the second, x2 ~ H x1. The layouts are HPatches'
sequences of a changing viewpoint (`v_*`), VGG's affine-covariant sets, and annotated pairs.

AEPE and Jaccard are computed for each pair, then averaged; PCK is pooled over pixels. Errors are in
pixels of the 240x240 images, over the pixels whose true correspondence is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import torch
from matplotlib.figure import Figure
from torch import nn

from dgc_pose.benchmarks.other_matchers import FLOW, FlowMatcher
from dgc_pose.benchmarks.report import (
    calibration_error,
    decimals,
    finite_data,
    reliability,
    shares,
)
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image, load_image, resize
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching.matcher import Matcher
from dgc_pose.network.config import INPUT_SIZE, LEVEL_SIZES, NetworkConfig
from dgc_pose.network.net import normalise, to_pixels
from dgc_pose.network.weights import choose_device, load_network
from dgc_pose.system.files import read_as, read_text
from dgc_pose.system.texts import aligned
from dgc_pose.training.views import MapPairs, image_arrays, level_truth
from dgc_pose.viz.figure import new_figure

VIEWPOINTS = ("I", "II", "III", "IV", "V")  # of images 2 to 6 of a sequence, from image 1
SEQUENCES = 59  # of a changing viewpoint in HPatches
_SUFFIXES = (".ppm", ".png", ".jpg", ".jpeg", ".pgm")
_FAR = 1e6  # pixels; coordinate of points beyond the horizon, and bound of all others
_SIZE = (INPUT_SIZE, INPUT_SIZE)
PCK_ALPHAS = np.linspace(0.005, 0.1, 200)  # of 240: the paper's thresholds
PCK_THRESHOLDS = PCK_ALPHAS * INPUT_SIZE  # pixels
WITHIN = (1.0, 3.0, 5.0)  # pixels, Euclidean: PCK@1, PCK@3, PCK@5
RIGHT_PX = 3.0  # largest error of a right match, in the reliability diagram
# The mask of dgcm-lite0 is trained on "visible, with an error below this many pixels".
FOUND_PX = 4.0
HEADING = (
    "errors in pixels of 240x240, over the pixels of known correspondence, no mask applied\n"
    "AEPE: mean of a pair, then over pairs; AEPE@15 to @240: of each level's map of a network\n"
    "PCK@1, 3, 5: percent of all pixels within 1, 3, 5 pixels, Euclidean\n"
    "Jaccard: the mask (matchability above one half) against what is visible, mean over pairs;\n"
    f"J found: against what is visible and found to within {FOUND_PX:g} px, "
    "which dgcm-lite's mask is trained for"
)
_LEVELS = [f"aepe{cells}" for cells in LEVEL_SIZES[::-1]]  # maps of 15 to 240 cells a side
# Heading, figure, factor and decimals.
_COLUMNS = [
    ("pairs", "pairs", 1, 0),
    ("AEPE", "aepe", 1, 2),
    *((name.replace("aepe", "AEPE@"), name, 1, 2) for name in _LEVELS),
    *((f"PCK@{limit:g}", f"pck{limit:g}", 100, 1) for limit in WITHIN),
    ("Jaccard", "jaccard", 1, 3),
    ("J found", "jaccard_found", 1, 3),
]


# Distances (S, S) float64 of a level's map from the truth, pixels of 240x240, infinite where the
# truth is unknown; and mask (S, S) bool of the known cells
Level = tuple[np.ndarray, np.ndarray]
# A pair's levels, coarse to fine: 15 to 240 cells a side for a network, else 240 only; and the
# matchability (240, 240) float32 in [0, 1], None without a mask
Comparison = tuple[Sequence[Level], np.ndarray | None]
MapMethod = Callable[[MapPairs], Comparison]  # for a batch of one pair


@dataclass(frozen=True, eq=False)
class HomographyPair:
    """Two images of a plane. Image 1 is the source, image 2 the target."""

    name: str
    group: str  # its figures are averaged within: a viewpoint of HPatches, or the folder
    path1: Path
    path2: Path
    H: np.ndarray  # (3, 3) float64, x2 ~ H x1, pixels of the images as stored


def find_homography_pairs(root: Path) -> list[HomographyPair]:
    """All complete pairs of the three layouts in a folder and the folders directly below it.

    Raises InputError if there is no pair or, with the path, if a matrix is malformed.
    """
    folders = [root, *sorted(path for path in root.iterdir() if path.is_dir())]
    pairs = [pair for folder in folders for pair in _pairs_in(folder)]
    if not pairs:
        raise InputError(
            f"{root}: no pairs; expected HPatches (v_*/1.ppm, v_*/H_1_2), VGG's sets (img1.ppm, "
            f"H1to2p) or annotated pairs (NAME_A.jpg, NAME_B.jpg, NAME_H.txt)"
        )
    return pairs


def load_pair(pair: HomographyPair) -> MapPairs:
    """Load a pair at 240x240, with its true map, as a batch of one.

    Raises ImageError for an image that cannot be read.
    """
    image1 = load_image(pair.path1)
    image2 = load_image(pair.path2)
    points, valid = true_map(pair.H, image1.size, image2.size)
    truth = points.astype(np.float32)
    squares = (resize(image.pixels, (INPUT_SIZE, INPUT_SIZE)) for image in (image1, image2))
    source, target = (torch.from_numpy(s).permute(2, 0, 1)[None].float() / 255 for s in squares)
    parts = (truth, valid, np.ones_like(valid))
    return MapPairs(source, target, *(torch.from_numpy(part)[None] for part in parts))


def true_map(
    H: np.ndarray, size1: tuple[int, int], size2: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The map of a homography between images that are squared to 240 x 240 pixels.

    H: (3, 3), x2 ~ H x1 in pixels of images of size1 and size2, (width, height). Returns the map
    (240, 240, 2) float64, for each pixel of the squared target a point of the squared source, and
    a mask (240, 240) of valid pixels: both coordinates within 0 and 239, which is [-1, 1] in the
    paper's normalised coordinates. Squaring follows the half-pixel rule.
    """
    squared = _squaring(size2) @ H @ np.linalg.inv(_squaring(size1))
    # The sign of H's scale is chosen so that the depth is positive at the source's centre.
    centre = np.array([(INPUT_SIZE - 1) / 2, (INPUT_SIZE - 1) / 2, 1.0])
    inverse = np.linalg.inv(squared * np.sign((squared @ centre)[2] or 1.0))
    source = np.concatenate([pixel_grid(_SIZE), np.ones((*_SIZE, 1))], -1) @ inverse.T
    ahead = source[..., 2] > 0
    depth = np.where(ahead, source[..., 2], 1.0)
    truth = np.where(ahead[..., None], source[..., :2] / depth[..., None], _FAR)
    valid = ahead & ((truth >= 0) & (truth <= INPUT_SIZE - 1)).all(-1)
    return np.clip(truth, -_FAR, _FAR), valid


def _squaring(size: tuple[int, int]) -> np.ndarray:
    """(3, 3), from pixels of an image of `size` to pixels of the square, by the half-pixel rule."""
    sx, sy = np.divide(INPUT_SIZE, size)
    return np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])


def _pairs_in(folder: Path) -> Iterator[HomographyPair]:
    name = folder.resolve().name
    found = []  # names of pair, group, images, matrix
    for k, viewpoint in enumerate(VIEWPOINTS, start=2):
        if folder.name.startswith("v_"):
            found.append((f"{name} 1-{k}", viewpoint, "1", f"{k}", f"H_1_{k}"))
        found.append((f"{name} 1-{k}", name, "img1", f"img{k}", f"H1to{k}p"))
    for path in sorted(folder.glob("*_H.txt")):
        stem = path.name.removesuffix("_H.txt")
        found.append((f"{name}/{stem}", name, f"{stem}_A", f"{stem}_B", path.name))
    for pair, group, stem1, stem2, matrix in found:
        files = [folder / matrix]
        for stem in (stem1, stem2):
            paths = (folder / f"{stem}{suffix}" for suffix in _SUFFIXES)
            files += [path for path in paths if path.is_file()][:1]
        if len(files) < 3 or not files[0].is_file():
            continue
        with read_as("a homography", files[0]):
            words = read_text(files[0], "a homography").split()
            H = np.array(words, np.float64).reshape(3, 3)
            if not np.isfinite(H).all() or np.linalg.matrix_rank(H) < 3:
                raise ValueError("a homography has finite numbers and an inverse")
        yield HomographyPair(pair, group, files[1], files[2], H)


def load_map_methods(names: Sequence[str], *, device: str) -> dict[str, MapMethod]:
    """The functions that compare dense maps, by method: bare networks, or optical flow.

    Raises InputError for no names or a matcher of key points; WeightsError if weights cannot be
    loaded.
    """
    if not names:
        raise InputError("no methods named")
    chosen = choose_device(device)
    methods: dict[str, MapMethod] = {}
    for name in names:
        if name == FLOW:
            methods[name] = partial(compare_matcher, FlowMatcher())
        elif MatcherOptions(name).is_network:
            methods[name] = partial(compare, load_network(name, chosen))
        else:
            words = f"{name}: matches key points and has no dense map"
            raise InputError(ArgumentName("methods"), words)
    return methods


@torch.no_grad()
def compare(net: nn.Module, pair: MapPairs) -> Comparison:
    """Compare the maps of a net's forward pass on a 240x240 pair.

    net: a `DGCNet` in evaluation mode, or another module with a `config` that returns a
    `Prediction`.
    """
    align_corners = cast(NetworkConfig, net.config).align_corners
    device = next(net.parameters()).device
    images = [
        normalise(image.to(device)).contiguous(memory_format=torch.channels_last)
        for image in (pair.image1, pair.image2)
    ]
    prediction = net(*images)
    levels = []
    for level in prediction.maps:
        truth, valid = level_truth(pair.map, pair.valid, level.shape[-1])
        points = to_pixels(level.float().movedim(1, -1), _SIZE, align_corners)
        levels.append(level_errors(*(values[0].cpu().numpy() for values in (points, truth, valid))))
    if not prediction.logits:
        return levels, None
    return levels, prediction.logits[-1][0, 0].float().sigmoid().cpu().numpy()


def compare_matcher(matcher: Matcher, pair: MapPairs) -> Comparison:
    """Compare the dense map of a matcher on a 240x240 pair; the matcher must make one.

    A coarser map is resized to the pixels: displacements bilinearly (constant beyond the outermost
    cell centres), matchability from the nearest cell.
    """
    images = (Image(image_arrays(image)[0]) for image in (pair.image1, pair.image2))
    dense = matcher.match(*images).correspondence_map
    assert dense is not None
    shift = cv2.resize(dense.map - dense.grid, _SIZE, interpolation=cv2.INTER_LINEAR)
    mask = cv2.resize(dense.matchability, _SIZE, interpolation=cv2.INTER_NEAREST)
    points = (pixel_grid(_SIZE) + shift).astype(np.float32)
    return [level_errors(points, pair.map[0].numpy(), pair.valid[0].numpy())], mask


def level_errors(points: np.ndarray, truth: np.ndarray, valid: np.ndarray) -> Level:
    """The errors of a map (S, S, 2) float32 against the truth, where this is valid (S, S)."""
    distances = np.full(valid.shape, np.inf)
    distances[valid] = np.linalg.norm(points[valid].astype(np.float64) - truth[valid], axis=1)
    return distances, valid


@dataclass(frozen=True, eq=False)
class MapScore:
    """One method's figures for a pair, or for several pairs together.

    means: means over the pairs, NaN if unknown. `aepe`: pixels; `aepe15` to `aepe240`: the same for
    each level of a network. `jaccard`: the mask against the visible pixels; `jaccard_found`:
    against the visible pixels found to within FOUND_PX.
    """

    method: str
    group: str
    name: str  # of the pair; "" for several
    valid: int  # pixels of known correspondence
    means: Mapping[str, float]
    near: np.ndarray  # (203,) int, valid pixels within each of PCK_THRESHOLDS and WITHIN
    reliability: np.ndarray | None  # a match within RIGHT_PX is correct; None without a mask
    pairs: int = 1

    @property
    def pck(self) -> np.ndarray:
        """Share (203,) of the valid pixels within each threshold; NaN without valid pixels."""
        return self.near / self.valid if self.valid else np.full(self.near.shape, np.nan)

    @property
    def data(self) -> dict[str, Any]:
        """The figures by name: a row of the tables and of pairs.csv."""
        within = zip(WITHIN, self.pck[len(PCK_THRESHOLDS) :].tolist(), strict=True)
        return {
            "group": self.group,
            "pair": self.name,
            "method": self.method,
            "pairs": self.pairs,
            "valid_pixels": self.valid,
            **self.means,
            **{f"pck{px:g}": share for px, share in within},
        }


def score_map(method: str, group: str, name: str, comparison: Comparison) -> MapScore:
    """One method's figures for one pair."""
    levels, matchability = comparison
    distances, valid = levels[-1]
    means = dict.fromkeys(("aepe", *_LEVELS, "jaccard", "jaccard_found"), float("nan"))
    for level, (errors, known) in zip(_LEVELS[::-1], levels[::-1], strict=False):
        means[level] = _mean(errors[known])
    means["aepe"] = means[_LEVELS[-1]]
    counts = None
    if matchability is not None:
        means["jaccard"] = jaccard(matchability > 0.5, valid)
        means["jaccard_found"] = jaccard(matchability > 0.5, distances < FOUND_PX)
        counts = reliability(matchability, distances <= RIGHT_PX)
    # The "percentage of correct keypoints" (PCK) of each threshold.
    thresholds = [*PCK_THRESHOLDS, *WITHIN]
    near = np.searchsorted(np.sort(distances[valid]), thresholds, side="right")
    return MapScore(method, group, name, int(valid.sum()), means, near, counts)


def pooled(scores: Sequence[MapScore], group: str = "all") -> MapScore:
    """One method's figures over its pairs of a group."""
    scores = [pair for pair in scores if group in ("all", pair.group)]
    parts = [pair.reliability for pair in scores if pair.reliability is not None]
    # A pair may have valid cells at a fine level and none at a coarse one.
    known = {
        name: [pair.means[name] for pair in scores if not np.isnan(pair.means[name])]
        for name in scores[0].means
    }
    return MapScore(
        method=scores[0].method,
        group=group,
        name="",
        valid=sum(pair.valid for pair in scores),
        means={name: _mean(values) for name, values in known.items()},
        near=np.sum([pair.near for pair in scores], axis=0),
        reliability=np.sum(parts, axis=0) if parts else None,
        pairs=len(scores),
    )


def jaccard(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two bool masks of one shape, in [0, 1]; 1 if both are empty."""
    union = int((prediction | truth).sum())
    return int((prediction & truth).sum()) / union if union else 1.0


def _mean(values: Sequence[float] | np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


Scores = Mapping[str, Sequence[MapScore]]  # by method, all over the same pairs


def groups_of(scores: Scores) -> list[str]:
    """The groups of the pairs, in order of first appearance."""
    return list(dict.fromkeys(pair.group for pair in next(iter(scores.values()))))


def report_text(scores: Scores) -> str:
    """A table with a line for each group and method, and for all pairs; then, for each method with
    a mask, the share of right matches by matchability."""
    table = [["group", "method", *(column[0] for column in _COLUMNS)]]
    for group in [*groups_of(scores), "all"]:
        for method, pairs in scores.items():
            data = pooled(pairs, group).data
            cells = (decimals(factor * data[name], n) for _, name, factor, n in _COLUMNS)
            table.append([group, method, *cells])
    parts = [HEADING, aligned(table)]
    for method, pairs in scores.items():
        if (counts := pooled(pairs).reliability) is not None:
            words = " ".join(decimals(100 * share, 0) for share in shares(counts)[0])
            parts.append(
                f"{method}: percent within {RIGHT_PX:g} px by tenths of matchability: {words}; "
                f"expected calibration error {decimals(100 * calibration_error(counts), 1)} %"
            )
    return "\n\n".join(parts)


def plot_pck(scores: Scores) -> Figure:
    """PCK: the share of pixels whose error is at most a share alpha of the image's side.

    Each group has a panel, with a curve for each method.
    """
    groups = groups_of(scores)
    figure = new_figure(4.0 * len(groups), 4.4)
    panels = np.ravel(figure.subplots(1, len(groups), sharey=True, squeeze=False))
    for axes, group in zip(panels, groups, strict=True):
        for method, pairs in scores.items():
            within = pooled(pairs, group).pck[: len(PCK_ALPHAS)]
            axes.plot(PCK_ALPHAS, 100 * within, label=method)
        axes.set(xlim=(PCK_ALPHAS[0], PCK_ALPHAS[-1]), ylim=(0, 100), xlabel="alpha")
        axes.set_title(group, fontsize=10)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("pixels within alpha x side (%)")
    panels[-1].legend(loc="lower right", fontsize=9)
    return figure


def report_data(scores: Scores) -> dict[str, Any]:
    """The figures of each method, for each group and for all pairs; None in place of NaN."""
    methods = []
    for method, pairs in scores.items():
        total = pooled(pairs)
        calibration = None
        if (counts := total.reliability) is not None:
            calibration = {
                "right_within_px": RIGHT_PX,
                "counts": counts[0].tolist(),
                "share_correct": shares(counts)[0].tolist(),
                "mean_confidence": shares(counts)[1].tolist(),
                "expected_calibration_error": calibration_error(counts),
            }
        methods.append(
            {
                "method": method,
                "all": {**total.data, "pck": total.pck[: len(PCK_THRESHOLDS)].tolist()},
                "groups": [pooled(pairs, group).data for group in groups_of(scores)],
                "reliability": calibration,
            }
        )
    return {"pck_thresholds_px": PCK_THRESHOLDS.tolist(), "methods": finite_data(methods)}
