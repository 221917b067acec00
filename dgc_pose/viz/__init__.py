"""Figures by matplotlib without pyplot, and HTML pages with a 3D view.

A function `draw_...` draws one thing on given axes and returns the mappable for a colour bar, if it
has one; a function `plot_...` makes a whole figure. Points are in pixels of the original images;
(0, 0) is the centre of the top-left pixel.
"""

from dgc_pose.viz.figure import (
    draw_curves,
    draw_image,
    draw_matchability,
    draw_matches,
    draw_points,
    draw_warp,
    new_figure,
    residual_colours,
    save_figure,
)
from dgc_pose.viz.model_page import model_page, pose_page
from dgc_pose.viz.pose_figure import plot_pose

__all__ = [
    "draw_curves",
    "draw_image",
    "draw_matchability",
    "draw_matches",
    "draw_points",
    "draw_warp",
    "model_page",
    "new_figure",
    "plot_pose",
    "pose_page",
    "residual_colours",
    "save_figure",
]
