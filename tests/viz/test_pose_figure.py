from __future__ import annotations

from dataclasses import replace

import cv2
import dense_scene
import numpy as np
import pytest

from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.image import Image
from dgc_pose.pose import trace_relative_pose
from dgc_pose.viz.figure import picture_format, save_figure
from dgc_pose.viz.pose_figure import DRAWN_LINES, DRAWN_MATCHES, plot_pose


def trace_of(correspondence_map):
    return trace_relative_pose(
        *dense_scene.pictures(),
        dense_scene.K,
        matcher=dense_scene.MapMatcher(correspondence_map),
        options=EstimationOptions(runs=1, iterations=200),
    )


def figure_of(correspondence_map):
    trace = trace_of(correspondence_map)
    return plot_pose(trace), trace.pose


def test_all_panels_are_there():
    figure, pose = figure_of(dense_scene.true_map())
    assert pose.success
    matches, points, lines, matchability, warp = figure.axes
    segments = matches.collections[0].get_segments()
    assert 0 < len(segments) <= DRAWN_MATCHES
    assert f"{len(segments)} of {pose.num_inliers} inlier matches" == matches.get_title()
    assert len(lines.lines) == len(points.collections[0].get_offsets()) == DRAWN_LINES
    assert "matchability" in matchability.get_title()
    assert "warped" in warp.get_title()
    assert figure.get_suptitle().startswith("rotation ")


def test_each_match_in_image_2_lies_on_its_epipolar_line():
    figure, _ = figure_of(dense_scene.true_map())
    axes = figure.axes[2]
    points = axes.collections[0].get_offsets()
    for point, line in zip(points, axes.lines, strict=True):
        (x1, y1), (x2, y2) = line.get_xy1(), line.get_xy2()
        along = np.array([x2 - x1, y2 - y1])
        across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        assert abs(across @ (point - (x1, y1))) < 0.5


def test_without_a_map_its_panels_are_left_out():
    trace = trace_of(dense_scene.true_map())
    assert len(plot_pose(replace(trace, correspondence_map=None)).axes) == 3


def test_without_a_pose_the_reason_is_the_headline():
    figure, pose = figure_of(dense_scene.noise_map())
    assert not pose.success
    assert figure.get_suptitle() == f"no pose: {pose.reason}"


def test_no_matches_can_be_drawn(tmp_path):
    nothing = dense_scene.make_map(
        np.full((4, 4, 2), -9.0, np.float32), np.zeros((4, 4, 2), np.float32)
    )
    figure, pose = figure_of(nothing)
    assert pose.num_matches == 0
    save_figure(figure, tmp_path / "p.png")
    assert cv2.imread(str(tmp_path / "p.png")) is not None


@pytest.mark.parametrize("size", [(320, 1500), (3000, 100)])
def test_odd_shapes_give_a_figure_that_fits_a_screen(size):
    blank = Image(np.zeros((size[1], size[0], 3), np.uint8))
    trace = replace(trace_of(dense_scene.true_map()), image1=blank, image2=blank)
    figure = plot_pose(trace)
    width, height = figure.get_size_inches()
    assert width == 12 and 1 < height < 21


def test_the_ending_of_a_name_chooses_the_format():
    assert picture_format("a/b.PNG") == "png"
    assert picture_format("b.svg") == "svg"
    for name in ("plot", "plot.docx", ".png"):
        with pytest.raises(InputError):
            picture_format(name)
