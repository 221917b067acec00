"""A rendered scene seen by several cameras: boxes of planes in a corner of a room, ray-cast."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

SIZE = (240, 180)
K = np.array([[225.0, 0, 121.0], [0, 226.5, 87.5], [0, 0, 1]])
_TEXELS = 100.0  # for one unit of length
# Planes n.x = d, each within half of a length of its middle along both of its axes.
_PLANES = (
    # middle, axis u, axis v, half sides
    ((0.0, 0.0, 6.0), (1, 0, 0), (0, 1, 0), (4.0, 3.0)),
    ((0.0, 1.6, 4.0), (1, 0, 0), (0, 0, 1), (4.0, 3.0)),
    ((-2.4, 0.0, 4.0), (0, 1, 0), (0, 0, 1), (3.0, 3.0)),
    ((0.5, 0.6, 4.2), (1, 0, 0.3), (0, 1, 0), (0.7, 0.9)),
    ((-0.9, 0.4, 4.8), (1, 0, -0.4), (0, 1, 0.1), (0.6, 0.7)),
)


@dataclass(frozen=True)
class View:
    """An image and its pose, x_camera = R x + t."""

    pixels: np.ndarray  # (H, W, 3) uint8
    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,)

    @property
    def centre(self) -> np.ndarray:
        return -self.R.T @ self.t


def render_views(count: int, *, seed: int = 0, step: float = 0.35) -> list[View]:
    """Views of cameras on an arc of `step` units between neighbours, which look at the middle."""
    textures = draw_textures(seed)
    views = []
    for i in range(count):
        x = (i - (count - 1) / 2) * step
        centre = np.array([x, 0.15 * np.sin(2.0 * i), 0.05 * x * x + 0.1 * np.cos(1.5 * i)])
        R = look_at(centre, np.array([0.0, 0.2, 4.6]))
        views.append(View(render(R, centre, textures)[0], R, -R @ centre))
    return views


def write_views(folder: Path, views: list[View]) -> list[str]:
    """Write the images as view0.png and so on; returns their names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for i, view in enumerate(views):
        names.append(f"view{i}.png")
        cv2.imwrite(str(folder / names[-1]), view.pixels[:, :, ::-1])
    return names


def K_text() -> str:
    """K as on the command line."""
    return f"{K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}"


def draw_textures(seed: int = 0) -> list[np.ndarray]:
    """Of the planes."""
    rng = np.random.default_rng(seed)
    return [_texture(rng) for _ in _PLANES]


def _texture(rng: np.random.Generator) -> np.ndarray:
    side = int(8 * _TEXELS)
    layers = []
    for cell, weight in ((10, 0.7), (25, 0.8), (60, 0.6)):
        noise = rng.standard_normal((side // cell + 2, side // cell + 2, 3)).astype(np.float32)
        layers.append(weight * cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC))
    return np.clip(127 + 50 * np.sum(layers, axis=0), 0, 255).astype(np.float32)


def look_at(centre: np.ndarray, target: np.ndarray) -> np.ndarray:
    z = (target - centre) / np.linalg.norm(target - centre)
    x = np.cross((0.0, 1.0, 0.0), z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def render(
    R: np.ndarray,
    centre: np.ndarray,
    textures: list[np.ndarray],
    K: np.ndarray = K,
    size: tuple[int, int] = SIZE,
    fine: int = 2,
) -> tuple[np.ndarray, np.ndarray]:
    """The image (H, W, 3) of a camera, uint8, and its depths, infinite where there is no plane.

    The depths are those of the `fine` samples that a pixel has along each axis.
    """
    width, height = size
    u, v = np.meshgrid(
        (np.arange(width * fine) + 0.5) / fine - 0.5, (np.arange(height * fine) + 0.5) / fine - 0.5
    )
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(K).T @ R
    nearest = np.full(u.shape, np.inf)
    colours = np.zeros((*u.shape, 3), np.float32)
    for (middle, axis_u, axis_v, half), texture in zip(_PLANES, textures, strict=True):
        along_u = np.divide(axis_u, np.linalg.norm(axis_u))
        along_v = np.divide(axis_v, np.linalg.norm(axis_v))
        normal = np.cross(along_u, along_v)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = normal @ (np.array(middle) - centre) / (rays @ normal)
            offset = centre + depth[..., None] * rays - middle
            a, b = offset @ along_u, offset @ along_v
        hit = (depth > 0.1) & (depth < nearest) & (abs(a) < half[0]) & (abs(b) < half[1])
        x = (np.where(hit, a, 0) * _TEXELS + texture.shape[1] / 2).astype(np.float32)
        y = (np.where(hit, b, 0) * _TEXELS + texture.shape[0] / 2).astype(np.float32)
        sampled = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        colours[hit] = sampled[hit]
        nearest[hit] = depth[hit]
    pixels = np.rint(cv2.resize(colours, size, interpolation=cv2.INTER_AREA)).astype(np.uint8)
    return pixels, nearest
