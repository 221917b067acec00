"""Seeded procedural textures for scenes without photographs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import torch

from dgc_pose.synthesis.render.noise import fractal_noise, grain, ramp, shades

Style = Literal[
    "cloud", "marble", "wood", "brick", "checker", "stripes", "pebbles", "text", "leaves"
]


def procedural_textures(count: int, size: int = 256, seed: int = 0) -> torch.Tensor:
    """`count` textures (N, 3, size, size) float32 in [0, 1], the styles in turn.

    Texture k depends on `seed`, `size` and k alone.
    """
    styles = tuple(_PAINTERS)
    return torch.stack(
        [procedural_texture(styles[k % len(styles)], size, (seed, k)) for k in range(count)]
    )


def procedural_texture(style: Style, size: int, seed: int | tuple[int, ...]) -> torch.Tensor:
    """One texture (3, size, size) float32 in [0, 1]."""
    rng = np.random.default_rng(seed)
    image = _PAINTERS[style](rng, size)
    image = image * (1 + 0.1 * grain(rng, size)[..., None])
    return torch.from_numpy(np.clip(image, 0, 1).astype(np.float32)).permute(2, 0, 1).contiguous()


def _cloud(rng: np.random.Generator, size: int) -> np.ndarray:
    return ramp(0.5 + 0.22 * fractal_noise(rng, size, first=4), shades(rng, 5))


def _marble(rng: np.random.Generator, size: int) -> np.ndarray:
    x, y = _grid(size)
    angle = rng.uniform(0, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    veins = np.sin(
        2 * np.pi * (1.5 * along + 0.3 * fractal_noise(rng, size, first=2, persistence=0.5))
    )
    return ramp(
        np.abs(veins) ** 0.6 + 0.06 * fractal_noise(rng, size, first=8),
        shades(rng, 4, saturation=0.25),
    )


def _wood(rng: np.random.Generator, size: int) -> np.ndarray:
    """Planks with rings, streaks along them, and dark joints."""
    x, y = _grid(size)
    planks = 5
    plank = np.minimum((x * planks).astype(int), planks - 1)
    shift = rng.uniform(0, 1, planks)[plank]
    rings = 1.2 * fractal_noise(rng, size, first=3, octaves=3, stretch=4) + 7 * (x + 3 * shift)
    streaks = fractal_noise(rng, size, first=40, octaves=3, stretch=12)
    value = 0.5 + 0.25 * np.sin(2 * np.pi * rings) + 0.12 * streaks + 0.5 * (shift - 0.5)
    base = np.array(((0.30, 0.17, 0.09), (0.55, 0.35, 0.19), (0.78, 0.58, 0.36)))
    image = ramp(value, base * rng.uniform(0.8, 1.15, 3))
    joint = np.minimum(x * planks - plank, 1 - (x * planks - plank)) < 0.012
    ends = rng.uniform(0, 1, planks)[plank]
    joint |= np.abs(y - ends) < 0.003
    return np.where(joint[..., None], 0.35 * image, image)


def _brick(rng: np.random.Generator, size: int) -> np.ndarray:
    rows, columns = 12, 5
    wobble = 0.02 * fractal_noise(rng, size, first=12, octaves=2)
    x, y = _grid(size)
    row = np.floor(y * rows + wobble).astype(int)
    across = x * columns + 0.5 * (row % 2) + wobble
    column = np.floor(across).astype(int)
    colours = shades(rng, 1, hue=0.03, saturation=0.5)[0] * rng.uniform(0.65, 1.3, (rows + 3, 9, 1))
    image = colours[row + 1, column + 1] * (
        1 + 0.12 * fractal_noise(rng, size, first=16)[..., None]
    )
    in_row, in_column = y * rows + wobble - row, across - column
    edge = np.minimum(
        np.minimum(in_row, 1 - in_row), np.minimum(in_column, 1 - in_column) * rows / columns
    )
    mortar = 0.66 + 0.06 * fractal_noise(rng, size, first=24)[..., None] * np.ones(3)
    return np.where((edge < 0.07)[..., None], mortar, image)


def _checker(rng: np.random.Generator, size: int) -> np.ndarray:
    """Tiles of two shades, each a little different, so that no two points look the same."""
    cells = int(rng.integers(5, 9))
    x, y = _grid(size)
    row = np.minimum((y * cells).astype(int), cells - 1)
    column = np.minimum((x * cells).astype(int), cells - 1)
    pair = shades(rng, 2, saturation=0.35)
    tint = rng.uniform(0.75, 1.2, (cells, cells, 1))[row, column]
    image = pair[(row + column) % 2] * tint
    image = image * (1 + 0.13 * fractal_noise(rng, size, first=6)[..., None])
    edge = np.minimum.reduce((x * cells - column, 1 - x * cells + column, y * cells - row))
    return np.where((edge < 0.03)[..., None], 0.4, image)


def _stripes(rng: np.random.Generator, size: int) -> np.ndarray:
    x, y = _grid(size)
    bounds = np.cumsum(rng.uniform(0.01, 0.09, 40))
    across = x + 0.15 * y + 0.01 * fractal_noise(rng, size, first=6)
    image = shades(rng, 41)[np.searchsorted(bounds, across)]
    weave = 1 + 0.1 * fractal_noise(rng, size, first=32, octaves=2, stretch=4)[..., None]
    return image * weave


def _pebbles(rng: np.random.Generator, size: int) -> np.ndarray:
    """Stones of different sizes: the cells of random points, with dark gaps."""
    count = 140
    x, y = _grid(size)
    warp = 0.006 * fractal_noise(rng, size, first=12)
    points = torch.from_numpy(np.stack((x + warp, y - warp), axis=-1).reshape(-1, 2))
    distances = torch.cdist(points, torch.from_numpy(rng.uniform(0, 1, (count, 2))))
    nearest, cell = distances.topk(2, dim=1, largest=False)
    gap = (nearest[:, 1] - nearest[:, 0]).numpy().reshape(size, size)
    colours = shades(rng, count, saturation=0.3)[cell[:, 0].numpy().reshape(size, size)]
    relief = np.clip(gap / 0.025, 0, 1) ** 0.5
    return colours * (0.25 + 0.75 * relief + 0.1 * fractal_noise(rng, size, first=20))[..., None]


def _text(rng: np.random.Generator, size: int) -> np.ndarray:
    """Lines of made-up letters on paper, in a few sizes."""
    paper = shades(rng, 1, saturation=0.2)[0] * 0.25 + 0.72
    ink = shades(rng, 1, saturation=0.6)[0] * 0.4
    page = np.zeros((size, size))
    alphabet = _letters(rng, 26)
    top = size // 40
    while True:
        scale = max(1, round(size / 256 * rng.choice((1, 1, 2, 2, 4))))
        if top + 7 * scale > size:
            break
        _write_line(rng, page, top, scale, alphabet)
        top += 9 * scale + int(rng.integers(0, 3))
    stained = paper * (1 + 0.06 * fractal_noise(rng, size, first=3)[..., None])
    return stained + page[..., None] * (ink - stained)


def _letters(rng: np.random.Generator, count: int) -> np.ndarray:
    """Bitmaps (count, 7, 4) of upright and level strokes."""
    letters = np.zeros((count, 7, 4))
    for letter in letters:
        letter[:, rng.integers(0, 4)] = 1
        for _ in range(2):
            letter[rng.choice((0, 3, 6)), : rng.integers(2, 5)] = 1
        start = int(rng.integers(0, 4))
        letter[start : start + 4, rng.integers(0, 4)] = 1
    return letters


def _write_line(
    rng: np.random.Generator, page: np.ndarray, top: int, scale: int, alphabet: np.ndarray
) -> None:
    left, size = 3 * scale, len(page)
    right = int(size * rng.uniform(0.6, 1.0)) - 6 * scale
    while left < right:
        if rng.uniform() < 0.18:
            left += 4 * scale
            continue
        letter = np.kron(alphabet[rng.integers(len(alphabet))], np.ones((scale, scale)))
        page[top : top + 7 * scale, left : left + 4 * scale] = letter
        left += 5 * scale


def _leaves(rng: np.random.Generator, size: int) -> np.ndarray:
    """The dead leaves model: shapes of all sizes one upon another, which has the statistics of
    natural images (Lee, Mumford and Huang, IJCV 2001)."""
    image = shades(rng, 1)[0] * np.ones((size, size, 3))
    colours = shades(rng, 400)
    radii = np.sort(size * 0.3 * rng.uniform(0.004, 1, 400) ** 1.5 + 1.5)[::-1]
    for colour, radius in zip(colours, radii, strict=True):
        _paint_leaf(rng, image, colour, radius)
    return image * (1 + 0.12 * fractal_noise(rng, size, first=16)[..., None])


def _paint_leaf(
    rng: np.random.Generator, image: np.ndarray, colour: np.ndarray, radius: float
) -> None:
    size = len(image)
    x, y = rng.uniform(0, size, 2)
    left, right = max(0, int(x - 1.5 * radius)), min(size, int(x + 1.5 * radius) + 1)
    top, bottom = max(0, int(y - 1.5 * radius)), min(size, int(y + 1.5 * radius) + 1)
    across = np.arange(left, right)[None] - x
    down = np.arange(top, bottom)[:, None] - y
    angle = rng.uniform(0, np.pi)
    u = (np.cos(angle) * across + np.sin(angle) * down) / radius
    v = (np.cos(angle) * down - np.sin(angle) * across) / radius * rng.uniform(1, 2.5)
    u_power, v_power = u * u, v * v  # of an ellipse; to the 8th, nearly a rectangle
    if rng.uniform() < 0.33:
        u_power, v_power = u_power * u_power, v_power * v_power
        u_power, v_power = u_power * u_power, v_power * v_power
    inside = u_power + v_power < 1
    light = 1 + rng.uniform(-0.35, 0.35) * u[inside] + rng.uniform(-0.25, 0.25) * v[inside]
    image[top:bottom, left:right][inside] = colour * light[:, None]


def _grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the pixel centres, in (0, 1), both (size, size)."""
    steps = (np.arange(size) + 0.5) / size
    x, y = np.meshgrid(steps, steps)
    return x, y


_PAINTERS: dict[Style, Callable[[np.random.Generator, int], np.ndarray]] = {
    "leaves": _leaves,
    "brick": _brick,
    "text": _text,
    "pebbles": _pebbles,
    "wood": _wood,
    "cloud": _cloud,
    "checker": _checker,
    "marble": _marble,
    "stripes": _stripes,
}
