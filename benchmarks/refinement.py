"""Refinement, part by part: every variant on the same pairs, through the same estimator.

`python -m dgc_pose.benchmarks.refinement LIST` measures on photographs with known poses;
`python -m dgc_pose.benchmarks.refinement --photos DIR` on rendered scenes, textured with the
photographs that training holds back, which is where the defaults were chosen.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import click
import numpy as np
import torch

from dgc_pose.benchmarks.pair_list import read_pairs
from dgc_pose.benchmarks.pairs import pose_errors, require_images
from dgc_pose.benchmarks.table import aligned
from dgc_pose.camera import Camera
from dgc_pose.cli.options import split_names
from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.image import Image, load_image
from dgc_pose.matchers import refined
from dgc_pose.matches import Matches
from dgc_pose.matching import DEFAULT_WEIGHTS, DenseMatcher, Matcher, load_dense_matcher
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.metrics import folded, pose_auc
from dgc_pose.refinement import AlignmentOptions, FeatureOptions, RefinementOptions, SourceName
from dgc_pose.synthesis.render import SceneOptions, render_pairs

# "SOURCE" aligns the matches of a source, "SOURCE-only" does not; "none" is the dense map alone.
VARIANTS = (
    "none",
    *(f"{source}{end}" for source in get_args(SourceName) for end in ("-only", "")),
    "sift-unguided",
)
_SIZE = 1024  # pixels a side of a rendered view
_HEADINGS = (
    "variant",
    "threshold px",
    "pairs",
    "failures",
    "matches",
    "R med",
    "t med",
    "AUC@5",
    "AUC@10",
    "AUC@20",
    "s/pair",
)


@dataclass(frozen=True)
class Case:
    """Two images with their cameras and the true pose x2 = R x1 + t."""

    image1: Image
    image2: Image
    camera1: Camera
    camera2: Camera
    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), any length


@dataclass(frozen=True)
class Outcome:
    """What one variant made of one pair at one threshold."""

    matches: int
    rotation_deg: float  # infinite without a pose
    translation_deg: float  # folded, 0 to 90; infinite without a pose
    seconds: float  # to match, from the images on, and to estimate


def make_variant(name: str, dense: DenseMatcher, options: RefinementOptions) -> Matcher:
    """The matcher of a name in VARIANTS. Raises InputError for any other."""
    if name not in VARIANTS:
        raise InputError(f"no variant '{name}'; there are {', '.join(VARIANTS)}")
    if name == "none":
        return dense
    if name == "sift-unguided":
        return SiftMatcher()
    source = name.removesuffix("-only")
    chosen = next(one for one in get_args(SourceName) if one == source)
    alignment = replace(options.alignment, align=not name.endswith("-only"))
    return refined(dense, replace(options, source=chosen, alignment=alignment))


def listed_cases(pair_list: Path, root: Path | None, limit: int | None) -> Iterator[Case]:
    """The pairs of a list in SuperGlue's format. Raises ImageError where an image is missing."""
    pairs = read_pairs(pair_list, root)[:limit]
    require_images(pairs)
    for pair in pairs:
        images = load_image(pair.path1), load_image(pair.path2)
        yield Case(*images, pair.camera1, pair.camera2, pair.R, pair.t)


def rendered_cases(photos: Path, count: int, seed: int) -> Iterator[Case]:
    """Seeded views, 1024 pixels square, of scenes of the photographs that training holds back."""
    from dgc_pose.synthesis.photos import load_held_back

    held_back = load_held_back(photos)
    generator = torch.Generator().manual_seed(seed)
    # Several copies of a photograph side by side would make its blur, not its detail, the scene.
    scenes = SceneOptions(
        rotation_deg=(5.0, 40.0), roll_deg=5.0, min_overlap=0.4, texture_span=(0.3, 0.6)
    )
    for _ in range(count):
        views = render_pairs(held_back.textures, 1, _SIZE, generator, scenes)
        pose = views.cam2_from_cam1[0].double().numpy()
        cameras = [Camera(K[0].double().numpy(), (_SIZE, _SIZE)) for K in (views.K1, views.K2)]
        images = [_image(view[0]) for view in (views.image1, views.image2)]
        yield Case(images[0], images[1], cameras[0], cameras[1], pose[:, :3], pose[:, 3])


def measure(
    case: Case, matcher: Matcher, thresholds: Sequence[float | None], options: EstimationOptions
) -> list[Outcome]:
    """One outcome a threshold, in pixels of the originals; None for the matches' own."""
    start = time.perf_counter()
    matches = matcher.match(case.image1, case.image2).matches
    matching = time.perf_counter() - start
    return [_estimate(case, matches, matching, threshold, options) for threshold in thresholds]


def row(name: str, threshold: float | None, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    """A line of the table: medians in degrees and AUC in percent over all pairs."""
    rotations = np.array([outcome.rotation_deg for outcome in outcomes])
    translations = np.array([outcome.translation_deg for outcome in outcomes])
    auc = pose_auc(np.maximum(rotations, translations), (5, 10, 20))
    return (
        name,
        "own" if threshold is None else f"{threshold:g}",
        str(len(outcomes)),
        str(int(np.isinf(rotations).sum())),
        f"{np.mean([outcome.matches for outcome in outcomes]):.0f}",
        f"{np.median(rotations):.2f}",
        f"{np.median(translations):.2f}",
        *(f"{value:.1f}" for value in auc),
        f"{np.mean([outcome.seconds for outcome in outcomes]):.2f}",
    )


@click.command()
@click.argument("pair_list", metavar="[LIST]", required=False, type=click.Path(path_type=Path))
@click.option("--root", type=click.Path(path_type=Path), help="Folder of the list's image paths.")
@click.option("--limit", type=click.IntRange(min=1), help="Only the first pairs of the list.")
@click.option("--photos", type=click.Path(path_type=Path), help="As for training: render pairs.")
@click.option("--pairs", default=16, show_default=True, help="Rendered pairs.")
@click.option("--scene-seed", default=7, show_default=True)
@click.option(
    "--variants", default=",".join(VARIANTS), show_default=True, help="With commas between."
)
@click.option(
    "--thresholds", default="own", show_default=True, help="Pixels, or own, with commas between."
)
@click.option("--long-side", default=FeatureOptions.long_side, show_default=True)
@click.option("--min-zncc", default=AlignmentOptions.min_zncc, show_default=True)
@click.option("--weights", default=DEFAULT_WEIGHTS, show_default=True)
@click.option("--threads", type=click.IntRange(min=1), help="Of torch; by default its own choice.")
def main(
    pair_list: Path | None,
    root: Path | None,
    limit: int | None,
    photos: Path | None,
    pairs: int,
    scene_seed: int,
    variants: str,
    thresholds: str,
    long_side: int,
    min_zncc: float,
    weights: str,
    threads: int | None,
) -> None:
    """Print one table: variant, medians, AUC@5/10/20 and seconds a pair."""
    if threads is not None:
        torch.set_num_threads(threads)
    try:
        if (pair_list is None) == (photos is None):
            raise InputError("give a LIST of pairs or --photos, one of them")
        names = split_names(variants)
        limits = [_threshold(text) for text in split_names(thresholds)]
        options = RefinementOptions(
            features=FeatureOptions(long_side=long_side),
            alignment=AlignmentOptions(min_zncc=min_zncc),
        )
        dense = load_dense_matcher(weights)
        matchers = {name: make_variant(name, dense, options) for name in names}
        if pair_list is not None:
            cases = listed_cases(pair_list, root, limit)
        else:
            assert photos is not None
            cases = rendered_cases(photos, pairs, scene_seed)
        outcomes: dict[tuple[str, float | None], list[Outcome]] = {
            (name, threshold): [] for name in names for threshold in limits
        }
        for case in cases:
            for name, matcher in matchers.items():
                found = measure(case, matcher, limits, EstimationOptions())
                for threshold, outcome in zip(limits, found, strict=True):
                    outcomes[name, threshold].append(outcome)
    except (DgcPoseError, OSError) as error:
        raise click.ClickException(str(error)) from error
    click.echo(aligned([_HEADINGS, *(row(*key, own) for key, own in outcomes.items())]))


def _threshold(text: str) -> float | None:
    if text == "own":
        return None
    try:
        return float(text)
    except ValueError:
        raise InputError(f"thresholds must be numbers or own, not '{text}'") from None


def _estimate(
    case: Case,
    matches: Matches,
    matching: float,
    threshold: float | None,
    options: EstimationOptions,
) -> Outcome:
    start = time.perf_counter()
    chosen = replace(options, threshold_px=threshold)
    pose: RelativePose = estimate_pose(matches, case.camera1, case.camera2, chosen)
    seconds = matching + time.perf_counter() - start
    rotation, translation = pose_errors(pose, case.R, case.t)
    return Outcome(len(matches), rotation, folded(translation), seconds)


def _image(view: torch.Tensor) -> Image:
    return Image((255 * view.permute(1, 2, 0)).round().to(torch.uint8).contiguous().numpy())


if __name__ == "__main__":
    main()
