"""Seeded procedural textures for scenes without photographs."""

import colorsys

import numpy as np
import torch
from torch.nn.functional import interpolate

_HUES = (0.02, 0.06, 0.09, 0.12, 0.15, 0.28, 0.35, 0.55, 0.6, 0.65)  # earth, plants, sky
_WOOD = ((0.30, 0.17, 0.09), (0.55, 0.35, 0.19), (0.78, 0.58, 0.36))  # dark to bright


def procedural_textures(count: int, size: int = 256, seed: int = 0) -> torch.Tensor:
    """`count` textures (N, 3, size, size) float32 in [0, 1], the styles in turn.

    Texture k depends on `seed`, `size` and k alone.
    """
    textures = np.empty((count, 3, size, size), np.float32)
    for k, texture in enumerate(textures):
        rng = np.random.default_rng((seed, k))
        image = _PAINTERS[k % len(_PAINTERS)](rng, size)
        # Fine noise, so that no surface is without detail.
        grain = _noise(rng, size, max(2, size // 8), octaves=2, persistence=0.8)
        texture[:] = np.clip(image * (1 + 0.1 * grain[..., None]), 0, 1).transpose(2, 0, 1)
    return torch.from_numpy(textures)


def _noise(
    rng: np.random.Generator,
    size: int,
    first: int,
    *,
    octaves: int = 5,
    persistence: float = 0.6,
    stretch: int = 1,
) -> np.ndarray:
    """Smooth fractal noise (size, size) of mean 0 and deviation 1.

    first: cells of the coarsest octave across the image; each further octave has twice as many.
    persistence: amplitude of an octave over the one before. stretch: how much longer cells are
    down the image than across.
    """
    total = np.zeros((size, size))
    cells, amplitude = first, 1.0
    for _ in range(octaves):
        if cells > size:
            break
        knots = rng.standard_normal((max(1, cells // stretch) + 1, cells + 1))
        smooth = interpolate(
            torch.from_numpy(knots)[None, None], (size, size), mode="bicubic", align_corners=True
        )
        total += amplitude * smooth[0, 0].numpy()
        cells, amplitude = 2 * cells, amplitude * persistence
    return (total - total.mean()) / total.std()


def _ramp(values: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Colours (..., 3) along a row of colours (k, 3); values 0 and 1 are its ends."""
    stops = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(values, stops, colours[:, k]) for k in range(3)], axis=-1)


def _shades(
    rng: np.random.Generator, count: int, saturation: float = 0.45, hue: float | None = None
) -> np.ndarray:
    """`count` colours (count, 3) around one hue, from dark to bright; some are of another hue."""
    base = float(rng.choice(_HUES)) if hue is None else hue
    colours = []
    for _ in range(count):
        shifted = base + 0.06 * rng.standard_normal() + (0.5 if rng.uniform() < 0.15 else 0.0)
        strength = float(np.clip(saturation * rng.uniform(0.4, 1.5), 0, 1))
        colours.append(colorsys.hsv_to_rgb(shifted % 1, strength, rng.uniform(0.25, 0.95)))
    return np.array(colours)


def _grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the pixel centres, in (0, 1), both (size, size)."""
    y, x = (np.indices((size, size)) + 0.5) / size
    return x, y


def _cloud(rng: np.random.Generator, size: int) -> np.ndarray:
    return _ramp(0.5 + 0.22 * _noise(rng, size, 4), _shades(rng, 5))


def _marble(rng: np.random.Generator, size: int) -> np.ndarray:
    x, y = _grid(size)
    angle = rng.uniform(0, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    veins = np.sin(2 * np.pi * (1.5 * along + 0.3 * _noise(rng, size, 2, persistence=0.5)))
    return _ramp(np.abs(veins) ** 0.6 + 0.06 * _noise(rng, size, 8), _shades(rng, 4, 0.25))


def _wood(rng: np.random.Generator, size: int) -> np.ndarray:
    """Planks with rings, streaks along them, and dark joints."""
    x, y = _grid(size)
    planks = 5
    plank = (x * planks).astype(int)
    shift = rng.uniform(0, 1, planks)[plank]
    rings = 1.2 * _noise(rng, size, 3, octaves=3, stretch=4) + 7 * (x + 3 * shift)
    streaks = _noise(rng, size, 40, octaves=3, stretch=12)
    value = 0.5 + 0.25 * np.sin(2 * np.pi * rings) + 0.12 * streaks + 0.5 * (shift - 0.5)
    image = _ramp(value, np.array(_WOOD) * rng.uniform(0.8, 1.15, 3))
    joint = np.minimum(x * planks - plank, 1 - (x * planks - plank)) < 0.012
    joint |= np.abs(y - rng.uniform(0, 1, planks)[plank]) < 0.003
    return np.where(joint[..., None], 0.35 * image, image)


def _brick(rng: np.random.Generator, size: int) -> np.ndarray:
    rows, columns = 12, 5
    wobble = 0.02 * _noise(rng, size, 12, octaves=2)
    x, y = _grid(size)
    row = np.floor(y * rows + wobble).astype(int)
    across = x * columns + 0.5 * (row % 2) + wobble
    column = np.floor(across).astype(int)
    colours = _shades(rng, 1, 0.5, hue=0.03)[0] * rng.uniform(0.65, 1.3, (rows + 3, 9, 1))
    image = colours[row + 1, column + 1] * (1 + 0.12 * _noise(rng, size, 16)[..., None])
    in_row, in_column = y * rows + wobble - row, across - column
    edge_down, edge_across = (np.minimum(inside, 1 - inside) for inside in (in_row, in_column))
    edge = np.minimum(edge_down, edge_across * rows / columns)
    mortar = 0.66 + 0.06 * _noise(rng, size, 24)[..., None] * np.ones(3)
    return np.where((edge < 0.07)[..., None], mortar, image)


def _checker(rng: np.random.Generator, size: int) -> np.ndarray:
    """Tiles of two shades, each a little different, so that no two points look the same."""
    cells = int(rng.integers(5, 9))
    x, y = _grid(size)
    row, column = (y * cells).astype(int), (x * cells).astype(int)
    pair = _shades(rng, 2, 0.35)
    image = pair[(row + column) % 2] * rng.uniform(0.75, 1.2, (cells, cells, 1))[row, column]
    image = image * (1 + 0.13 * _noise(rng, size, 6)[..., None])
    edge = np.minimum.reduce((x * cells - column, 1 - x * cells + column, y * cells - row))
    return np.where((edge < 0.03)[..., None], 0.4, image)


def _stripes(rng: np.random.Generator, size: int) -> np.ndarray:
    x, y = _grid(size)
    bounds = np.cumsum(rng.uniform(0.01, 0.09, 40))
    across = x + 0.15 * y + 0.01 * _noise(rng, size, 6)
    image = _shades(rng, 41)[np.searchsorted(bounds, across)]
    return image * (1 + 0.1 * _noise(rng, size, 32, octaves=2, stretch=4)[..., None])


def _pebbles(rng: np.random.Generator, size: int) -> np.ndarray:
    """Stones of different sizes: the cells of random points, with dark gaps."""
    count = 140
    x, y = _grid(size)
    warp = 0.006 * _noise(rng, size, 12)
    points = torch.from_numpy(np.stack((x + warp, y - warp), axis=-1).reshape(-1, 2))
    distances = torch.cdist(points, torch.from_numpy(rng.uniform(0, 1, (count, 2))))
    nearest, cell = distances.topk(2, dim=1, largest=False)
    gap = (nearest[:, 1] - nearest[:, 0]).numpy().reshape(size, size)
    colours = _shades(rng, count, 0.3)[cell[:, 0].numpy().reshape(size, size)]
    relief = np.clip(gap / 0.025, 0, 1) ** 0.5
    return colours * (0.25 + 0.75 * relief + 0.1 * _noise(rng, size, 20))[..., None]


def _text(rng: np.random.Generator, size: int) -> np.ndarray:
    """Lines of made-up letters on paper, in a few sizes."""
    paper = _shades(rng, 1, 0.2)[0] * 0.25 + 0.72
    ink = _shades(rng, 1, 0.6)[0] * 0.4
    page = np.zeros((size, size))
    alphabet = np.zeros((26, 7, 4))  # bitmaps of upright and level strokes
    for letter in alphabet:
        letter[:, rng.integers(0, 4)] = 1
        for _ in range(2):
            letter[rng.choice((0, 3, 6)), : rng.integers(2, 5)] = 1
        start = int(rng.integers(0, 4))
        letter[start : start + 4, rng.integers(0, 4)] = 1
    top = size // 40
    while True:
        scale = max(1, round(size / 256 * rng.choice((1, 1, 2, 2, 4))))
        if top + 7 * scale > size:
            break
        left, right = 3 * scale, int(size * rng.uniform(0.6, 1.0)) - 6 * scale
        while left < right:
            if rng.uniform() < 0.18:
                left += 4 * scale
                continue
            letter = np.kron(alphabet[rng.integers(len(alphabet))], np.ones((scale, scale)))
            page[top : top + 7 * scale, left : left + 4 * scale] = letter
            left += 5 * scale
        top += 9 * scale + int(rng.integers(0, 3))
    stained = paper * (1 + 0.06 * _noise(rng, size, 3)[..., None])
    return stained + page[..., None] * (ink - stained)


def _leaves(rng: np.random.Generator, size: int) -> np.ndarray:
    """The dead leaves model: shapes of all sizes one upon another, which has the statistics of
    natural images (Lee, Mumford and Huang, IJCV 2001)."""
    image = _shades(rng, 1)[0] * np.ones((size, size, 3))
    colours = _shades(rng, 400)
    radii = np.sort(size * 0.3 * rng.uniform(0.004, 1, 400) ** 1.5 + 1.5)[::-1]
    for colour, radius in zip(colours, radii, strict=True):
        _paint_leaf(rng, image, colour, radius)
    return image * (1 + 0.12 * _noise(rng, size, 16)[..., None])


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
    squares = [u * u, v * v]  # of an ellipse; to the 8th, nearly a rectangle
    if rng.uniform() < 0.33:
        squares = [np.square(np.square(square)) for square in squares]
    inside = squares[0] + squares[1] < 1
    light = 1 + rng.uniform(-0.35, 0.35) * u[inside] + rng.uniform(-0.25, 0.25) * v[inside]
    image[top:bottom, left:right][inside] = colour * light[:, None]


_PAINTERS = (_leaves, _brick, _text, _pebbles, _wood, _cloud, _checker, _marble, _stripes)
