"""What a locator keeps of images."""

from pathlib import Path

import numpy as np
from multi_view import SIZE, K, render_views, write_views

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions
from dgc_pose.localization import locate
from dgc_pose.matchers import load_matcher
from dgc_pose.matching.cache import image_cache
from dgc_pose.model import Model


def test_features_go_with_their_images(tmp_path: Path) -> None:
    """Neither the query's nor those of images that left the memory are kept."""
    photo, *views = render_views(4, step=0.5)
    poses = {
        name: np.column_stack([view.R, view.t])
        for name, view in zip(write_views(tmp_path, views), views, strict=True)
    }
    model = Model(tmp_path, dict.fromkeys(poses, Camera(K, SIZE)), poses)
    cache = image_cache()
    options = EstimationOptions(effort="fast", runs=2, iterations=200)
    locator = locate.Locator(model, load_matcher(cache=cache), options)
    locator._images.limit_bytes = 1
    location = locator.locate(photo.pixels, K)
    assert location.success and cache.made > 8
    kept = {key[0].name for key in cache._kept}
    assert len(kept) <= 1 and "query" not in kept
