"""Draw docs/conventions.png: pixels, K and the pose in one picture.

python docs/conventions.py docs/conventions.png
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

INK, OURS, THEIRS, PALE = "#222222", "#0b63b0", "#b3501a", "#e9eef4"
ARROW = {"arrowstyle": "-|>", "color": INK, "shrinkA": 0, "shrinkB": 0}


def draw_pixels(axes: Axes) -> None:
    """The top-left corner of an image, and what its points are called."""
    for x in range(3):
        for y in range(2):
            axes.add_patch(plt.Rectangle((x - 0.5, y - 0.5), 1, 1, fc=PALE, ec="white", lw=2))
    axes.plot([-0.5, 2.5], [-0.5, -0.5], color=INK, lw=1.2)
    axes.plot([-0.5, -0.5], [-0.5, 1.5], color=INK, lw=1.2)
    for point in ((0, 0), (1, 0), (-0.5, -0.5)):
        axes.plot(*point, "o", color=INK, ms=4, zorder=3)
        for colour, offset, below in ((OURS, 0, 0.12), (THEIRS, 0.5, 0.36)):
            text = f"({point[0] + offset:g}, {point[1] + offset:g})"
            at, way = (point, "center") if point[0] >= 0 else ((-0.5, -1.13), "center")
            axes.text(at[0], at[1] + below, text, color=colour, ha=way, va="top", fontsize=9)
    note = "dgc-pose, OpenCV, ROS, Kalibr, KITTI"
    axes.text(-0.5, 1.75, note, color=OURS, fontsize=8.5, va="top")
    axes.text(-0.5, 2.05, "COLMAP, NeRF's transforms.json", color=THEIRS, fontsize=8.5, va="top")
    axes.set(xlim=(-1.1, 2.6), ylim=(2.5, -1.3), title="pixels")


def draw_camera(axes: Axes) -> None:
    """A pinhole from the side and its image: focal length and principal point."""
    axes.add_patch(plt.Rectangle((0, 0), 4, 3, fc=PALE, ec=INK, lw=1.2))
    axes.plot(2.2, 1.4, "o", color=INK, ms=4)
    axes.text(2.3, 1.35, "(cx, cy)", fontsize=9, va="bottom")
    axes.annotate("", (4.7, 0), (0, 0), arrowprops=ARROW)
    axes.annotate("", (0, 3.6), (0, 0), arrowprops=ARROW)
    axes.text(4.75, 0, "x", va="center", fontsize=10)
    axes.text(0, 3.65, "y", va="top", ha="center", fontsize=10)
    axes.text(2, -0.15, "width", ha="center", va="bottom", fontsize=8.5)
    axes.text(-0.15, 1.5, "height", ha="right", va="center", rotation=90, fontsize=8.5)
    lines = ["    ⎡ fx  0  cx ⎤", "K = ⎢ 0  fy  cy ⎥", "    ⎣ 0   0   1 ⎦"]
    for number, line in enumerate(lines):
        axes.text(0.5, 3.75 + 0.42 * number, line, family="DejaVu Sans Mono", fontsize=9, va="top")
    axes.set(xlim=(-0.7, 5.1), ylim=(5.1, -0.7), title="K of this image size")


def draw_pose(axes: Axes) -> None:
    """Two cameras from above, their axes and one point."""
    point = np.array([1.9, 3.6])
    for number, (centre, angle) in enumerate((((0, 0), 8), ((3.2, 0.35), -26)), start=1):
        turn = np.radians(angle)
        forward = np.array([np.sin(turn), np.cos(turn)])
        right = np.array([np.cos(turn), -np.sin(turn)])
        origin = np.array(centre)
        corners = [
            origin,
            origin + 0.75 * forward + 0.5 * right,
            origin + 0.75 * forward - 0.5 * right,
        ]
        axes.add_patch(plt.Polygon(corners, fc=PALE, ec=INK, lw=1.2))
        for way, name, length in ((forward, "z", 1.5), (right, "x", 1.1)):
            axes.annotate("", origin + length * way, origin, arrowprops=ARROW)
            axes.text(
                *(origin + (length + 0.16) * way), f"${name}_{number}$", ha="center", va="center"
            )
        axes.plot(*zip(origin, point, strict=True), color=OURS, lw=0.9, ls=":")
        axes.text(*(origin - (0, 0.22)), f"camera {number}", ha="center", va="top", fontsize=8.5)
    axes.plot(*point, "o", color=OURS, ms=5)
    axes.text(
        point[0] + 0.15, point[1], "$x_2 = R\\,x_1 + t$", color=OURS, va="center", fontsize=10
    )
    axes.text(1.6, -1.1, "y points down, into the page; |t| = 1", ha="center", fontsize=8.5)
    axes.set(xlim=(-0.9, 4.6), ylim=(-1.3, 4.1), title="pose: cam2_from_cam1, from above")


def main() -> None:
    plt.rcParams.update({"text.color": INK})
    figure, panels = plt.subplots(1, 3, figsize=(11, 3.7), layout="constrained")
    for axes, draw in zip(panels, (draw_pixels, draw_camera, draw_pose), strict=True):
        draw(axes)
        axes.set_aspect("equal")
        axes.axis("off")
    figure.savefig(sys.argv[1], dpi=130)


if __name__ == "__main__":
    main()
