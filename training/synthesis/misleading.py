"""Views that mislead: rotated, enlarged, at night, behind a moving object, of equal windows."""

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera

_FLOORS, _COLUMNS = 7, 10  # windows of the facade


def rolled(
    pixels: np.ndarray, camera: Camera, quarter_turns: int
) -> tuple[np.ndarray, Camera, np.ndarray]:
    """An image (H, W, 3) rotated counterclockwise, its camera, and the rotation (3, 3) from the
    camera as given."""
    R = np.eye(3)
    for _ in range(quarter_turns):  # (x, y) goes to (y, width - 1 - x)
        width, K = pixels.shape[1], camera.K
        rotated = [[K[1, 1], 0, K[1, 2]], [0, K[0, 0], width - 1 - K[0, 2]], [0, 0, 1.0]]
        pixels = np.rot90(pixels)
        camera = Camera(np.array(rotated), (pixels.shape[1], pixels.shape[0]))
        R = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]) @ R
    return pixels, camera, R


def middle_quarter(pixels: np.ndarray, camera: Camera) -> tuple[np.ndarray, Camera]:
    """A crop of a quarter of each side, and its camera."""
    height, width = pixels.shape[:2]
    x, y = 3 * width // 8, 3 * height // 8
    cropped = pixels[y : y + height // 4, x : x + width // 4]
    K = camera.K.copy()
    K[:2, 2] -= (x, y)
    return cropped, Camera(K, (cropped.shape[1], cropped.shape[0]))


def night(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A tenth of the light, blue, with the noise of a sensor, and four lamps."""
    light = (pixels / 255.0) ** 2.2
    height, width = light.shape[:2]
    y, x = np.mgrid[:height, :width]
    lamps = np.zeros((height, width))
    for _ in range(4):
        centre = rng.random(2) * (width, height)
        squared = (x - centre[0]) ** 2 + (y - centre[1]) ** 2
        lamps += np.exp(-squared / (2 * (0.12 * width) ** 2))
    dark = light * (0.06 * np.array([0.7, 0.8, 1.2]) + 0.25 * lamps[..., None] * (1.2, 1, 0.6))
    dark = dark + 0.004 * rng.standard_normal(dark.shape)
    return (255 * dark.clip(0, 1) ** (1 / 2.2)).round().astype(np.uint8)


def with_moving_object(
    views: tuple[np.ndarray, np.ndarray],
    cameras: tuple[Camera, Camera],
    rng: np.random.Generator,
    share: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Two images (H, W, 3), and in front of both a flat picture that moved in between, which is
    image 1 upside down.

    share: of an image that it covers, about, 0 to 1.
    """
    picture = views[0][::-1]
    height, width = picture.shape[:2]
    # From pixels of the picture (x, y, 1) to points of a rectangle of area 1 around the origin.
    unit = 1 / np.sqrt(width * height)
    plane = np.array([[unit, 0, -unit * width / 2], [0, unit, -unit * height / 2], [0, 0, 1.0]])
    shown = []
    for pixels, camera in zip(views, cameras, strict=True):
        size = pixels.shape[1::-1]
        depth = camera.focal / np.sqrt(share * size[0] * size[1])
        rotation = cv2.Rodrigues(rng.uniform(-0.4, 0.4, 3))[0]
        place = depth * np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.85, 1.15)])
        H = camera.K @ np.column_stack([rotation[:, :2], place]) @ plane
        drawn = cv2.warpPerspective(picture, H, size, flags=cv2.INTER_AREA)
        covered = cv2.warpPerspective(np.ones((height, width), np.uint8), H, size)
        shown.append(np.where(covered[..., None] > 0, drawn, pixels))
    return shown[0], shown[1]


def render_facade(
    seed: int, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, Camera, np.ndarray, np.ndarray]:
    """Two views, 20 degrees apart, of a wall whose windows are alike but for their curtains.

    size: (width, height). Returns both images (H, W, 3) uint8, their camera, and the pose R (3, 3),
    t (3,), x2 = R x1 + t.
    """
    rng = np.random.default_rng(seed)
    wall = _wall(rng)
    width, height = size
    K = np.array([[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1.0]])
    across = 1.6 / wall.shape[1]  # the wall is 1.6 wide and stands before the cameras at 1.2
    # From pixels of the wall (x, y, 1) to points in the frame between the cameras.
    plane = np.array([[across, 0, -0.8], [0, across, -across * wall.shape[0] / 2], [0, 0, 1.2]])
    angle = np.radians(rng.uniform(8, 12))
    middle = np.array([0, 0, 1.2])
    rotations = [cv2.Rodrigues(np.array([0.0, side, 0.0]))[0] for side in (-angle, angle)]
    shifts = [middle - rotation @ middle for rotation in rotations]
    left, right = (
        cv2.warpPerspective(
            wall,
            K @ (rotation @ plane + np.outer(shift, (0, 0, 1))),
            size,
            flags=cv2.INTER_AREA,
            borderValue=(150, 180, 210),
        )
        for rotation, shift in zip(rotations, shifts, strict=True)
    )
    R = rotations[1] @ rotations[0].T
    return left, right, Camera(K, size), R, shifts[1] - R @ shifts[0]


def _wall(rng: np.random.Generator) -> np.ndarray:
    """A facade (H, W, 3) uint8: bricks, and a grid of windows that differ in their curtains."""
    cell = 120
    bricks = np.full((cell, cell, 3), (160, 110, 90), np.uint8)
    bricks[::12] = (190, 180, 170)
    for row in range(0, cell, 12):
        bricks[row : row + 12, (row // 12 % 2) * 12 :: 24] = (190, 180, 170)
    bricks[30:95, 35:85] = (235, 235, 230)
    bricks[34:91, 39:81] = (60, 70, 85)
    bricks[61:64, 39:81] = bricks[34:91, 59:61] = (235, 235, 230)
    wall = np.tile(bricks, (_FLOORS, _COLUMNS, 1))
    for floor, column in np.ndindex(_FLOORS, _COLUMNS):
        y, x = floor * cell + 34, column * cell
        drawn = int(rng.integers(0, 27))
        wall[y : y + drawn, x + 39 : x + 59] = rng.integers(120, 255, 3)
        wall[y : y + drawn, x + 61 : x + 81] = rng.integers(120, 255, 3)
    grain = rng.normal(0, 6, wall.shape[:2])[..., None]
    return (wall + grain).clip(0, 255).round().astype(np.uint8)
