"""The figure of a location."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from matplotlib.patches import Ellipse
from worlds import CAMERA, IMAGE, PHOTO_CAMERA, world_scene

from dgc_pose.localization.location import DatabaseImage, Location
from dgc_pose.viz.location import plot_location


def test_a_location_is_drawn_with_its_error(tmp_path: Path) -> None:
    """The ellipse lies at the centre, in the mean camera's axes, and has nine tenths of it."""
    scene = world_scene()
    for name in (*scene.names, "new.png"):
        picture = np.random.default_rng(0).integers(0, 256, (*IMAGE[::-1], 3), np.uint8)
        cv2.imwrite(str(tmp_path / name), picture)
    model = replace(scene.model(), root=tmp_path, points=scene.points)
    references = tuple(
        DatabaseImage(name, scene.matches(i), np.arange(300) % 2 == 0, 0.9, agrees=i != 1)
        for i, name in enumerate(scene.names)
    )
    covariance = np.diag([1e-4] * 3 + [0.04] * 3)
    location = Location(
        *("located", "", references, scene.R, scene.centre),
        covariance=covariance,
        camera=PHOTO_CAMERA,
    )
    figure = plot_location(model, str(tmp_path / "new.png"), location)
    above, first, second = figure.axes
    (ellipse,) = (patch for patch in above.patches if isinstance(patch, Ellipse))
    assert np.allclose((ellipse.width, ellipse.height), 2 * 2.146 * 0.2, rtol=1e-3)
    filled = next(line for line in above.lines if line.get_label() == "database images")
    assert len(filled.get_xdata()) == 4
    assert "150 of 300 matches agree" in first.get_title() and second.get_title()
    nowhere = Location("nowhere", "none of 5 database images", references[:1], camera=CAMERA)
    figure = plot_location(model, str(tmp_path / "new.png"), nowhere)
    assert not any(isinstance(patch, Ellipse) for patch in figure.axes[0].patches)
    assert figure.get_suptitle() == "new.png: none of 5 database images"
