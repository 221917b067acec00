"""Plots of matches, maps, warps and errors, as matplotlib figures without pyplot."""

from dgc_pose.viz.figure import save_figure
from dgc_pose.viz.histograms import plot_errors
from dgc_pose.viz.pose_figure import plot_pose

__all__ = ["plot_errors", "plot_pose", "save_figure"]
