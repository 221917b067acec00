"""How the matcher's defaults were chosen: pose errors on rendered scenes, by matchability.

Run as `python -m dgc_pose.benchmarks.thresholds --photos DIR`. The scenes are textured with the
photographs that training holds back, so that nothing is chosen on data that accuracy is reported
on.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import torch

from dgc_pose.benchmarks.pairs import pose_errors
from dgc_pose.camera import Camera
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.image import Image
from dgc_pose.matching import DEFAULT_WEIGHTS, CorrespondenceMap, load_dense_matcher
from dgc_pose.matching.selection import MatchingOptions, cell_size, select_matches
from dgc_pose.metrics import folded, pose_auc
from dgc_pose.synthesis.photos import load_held_back
from dgc_pose.synthesis.render import RenderedPairs, SceneOptions, render_pairs

_SIZE = 480  # pixels a side of the rendered views: the matcher halves them, as it does photographs
_MATCHABILITIES = (0.2, 0.5, 0.7, 0.8, 0.9, 0.95)
_FACTORS = (0.5, 1.0, 2.0, 3.0)


@click.command()
@click.option("--photos", required=True, type=click.Path(path_type=Path), help="As for training.")
@click.option("--weights", default=DEFAULT_WEIGHTS, show_default=True)
@click.option("--pairs", default=60, show_default=True, help="Rendered pairs.")
@click.option("--seed", default=7, show_default=True)
def main(photos: Path, weights: str, pairs: int, seed: int) -> None:
    """Print pose errors by least matchability, then by the estimator's threshold."""
    held_back = load_held_back(photos)
    matcher = load_dense_matcher(weights)
    generator = torch.Generator().manual_seed(seed)
    scenes = SceneOptions(rotation_deg=(5.0, 40.0), roll_deg=5.0, supersample=2, min_overlap=0.4)
    cases = []
    for _ in range(pairs):
        views = render_pairs(held_back.textures, 1, _SIZE, generator, scenes)
        images = [_image(view) for view in (views.image1, views.image2)]
        cases.append((views, matcher.correspondence_maps([(images[0], images[1])])[0]))
    click.echo("matchability  matches  within 1 cell  median error  pose errors R, t (median), AUC")
    options = EstimationOptions(runs=1)
    for least in _MATCHABILITIES:
        click.echo(f"{least:12.2f}  {_row(cases, MatchingOptions(matchability=least), options)}")
    click.echo("threshold factor")
    for factor in _FACTORS:
        changed = replace(options, threshold_factor=factor)
        click.echo(f"{factor:12.2f}  {_row(cases, MatchingOptions(), changed)}")


def _image(view: torch.Tensor) -> Image:
    return Image((255 * view[0].permute(1, 2, 0)).round().to(torch.uint8).contiguous().numpy())


def _row(
    cases: list[tuple[RenderedPairs, CorrespondenceMap]],
    matching: MatchingOptions,
    estimation: EstimationOptions,
) -> str:
    counts, off, rotations, translations = [], [], [], []
    for views, correspondences in cases:
        matches = select_matches(correspondences, matching)
        cameras = [Camera(K[0].double().numpy(), (_SIZE, _SIZE)) for K in (views.K1, views.K2)]
        pose = estimate_pose(matches, cameras[0], cameras[1], estimation)
        truth = views.cam2_from_cam1[0].double().numpy()
        counts.append(len(matches))
        x, y = np.rint(matches.points2).astype(int).T
        errors = np.linalg.norm(views.map[0].numpy()[y, x] - matches.points1, axis=1)
        errors[~views.visible[0].numpy()[y, x]] = np.inf
        off.append(errors / cell_size(correspondences))
        rotation, translation = pose_errors(pose, truth[:, :3], truth[:, 3])
        rotations.append(rotation)
        translations.append(translation)
    cells = np.concatenate(off)
    auc = pose_auc([max(r, folded(t)) for r, t in zip(rotations, translations, strict=True)])
    return (
        f"{np.mean(counts):7.0f}  {100 * (cells < 1).mean():11.1f} %  "
        f"{np.median(cells):6.2f} cells  "
        f"{np.median(rotations):6.2f} {np.median(translations):6.2f}  "
        + "/".join(f"{value:.1f}" for value in auc)
    )


if __name__ == "__main__":
    main()
