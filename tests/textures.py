"""Seeded procedural textures for scenes without photographs, and small photographs of them.

Golden pairs show these textures: what is drawn of a generator, and in which order, stays.
"""

import colorsys
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.nn.functional import interpolate

from dgc_pose.training.photos import Photos
from dgc_pose.training.views import image_arrays

_HUES = (0.02, 0.06, 0.09, 0.12, 0.15, 0.28, 0.35, 0.55, 0.6, 0.65)  # earth, plants, sky
_WOOD = ((0.30, 0.17, 0.09), (0.55, 0.35, 0.19), (0.78, 0.58, 0.36))  # dark to bright


def procedural_textures(count, size=256, seed=0):
    """`count` textures (N, 3, size, size) float32 in [0, 1], the styles in turn.

    Texture k depends on `seed`, `size` and k alone.
    """
    textures = np.empty((count, 3, size, size), np.float32)
    for k, texture in enumerate(textures):
        rng = np.random.default_rng((seed, k))
        image = _PAINTERS[k % len(_PAINTERS)](rng, size)
        # Fine noise, so that no surface is without detail.
        grain = _noise(rng, size, max(2, size // 8), octaves=2, persistence=0.8)
        texture[:] = np.clip(image * (1 + 0.1 * grain), 0, 1).transpose(2, 0, 1)
    return torch.from_numpy(textures)


def drawn_photos(count: int, side: int, places: int = 0) -> Photos:
    """So many procedural textures, squares of `side` pixels, as the trainer holds photographs, and
    places of two of them, one darker."""
    textures = image_arrays(procedural_textures(count, side, seed=1))
    return Photos.of(textures, [[texture, texture // 2] for texture in textures[:places]])


def coordinates(width: int, height: int, level: int) -> np.ndarray:
    """An image whose red and green are the pixel's x and y, and whose blue tells it apart."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([x, y, np.full_like(x, level)], -1).astype(np.uint8)


def write_photos(folder: Path, count: int, seed: int = 0) -> list[Path]:
    """So many pictures of 96x80 pixels, coloured blots with nothing in common."""
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    paths = [folder / f"photo{seed}_{number:03d}.png" for number in range(count)]
    for path in paths:
        blots = rng.integers(0, 255, (10, 12, 3)).astype(np.uint8)
        cv2.imwrite(str(path), cv2.resize(blots, (96, 80), interpolation=cv2.INTER_CUBIC))
    return paths


def _noise(rng, size, first, octaves=5, persistence=0.6, stretch=1):
    """Smooth fractal noise (size, size, 1) of mean 0 and deviation 1.

    first: cells of the coarsest octave across the image; each further octave has twice as many.
    persistence: amplitude of an octave over the one before. stretch: how much longer cells are
    down the image than across.
    """
    total = np.zeros((size, size))
    for octave in range(octaves):
        cells = first * 2**octave
        if cells > size:
            break
        knots = torch.from_numpy(rng.standard_normal((max(1, cells // stretch) + 1, cells + 1)))
        options = {"mode": "bicubic", "align_corners": True}
        smooth = interpolate(knots[None, None], (size, size), **options)[0, 0].numpy()
        total += persistence**octave * smooth
    return ((total - total.mean()) / max(total.std(), 1e-9))[..., None]


def _ramp(values, colours):
    """Colours (size, size, 3) along a row of colours (k, 3); values 0 and 1 are its ends."""
    stops = np.linspace(0, 1, len(colours))
    return np.concatenate([np.interp(values, stops, colours[:, k]) for k in range(3)], axis=-1)


def _shades(rng, count, saturation=0.45, hue=None):
    """`count` colours (count, 3) around one hue, from dark to bright; some are of another hue."""
    base = float(rng.choice(_HUES)) if hue is None else hue
    colours = []
    for _ in range(count):
        shifted = base + 0.06 * rng.standard_normal() + (0.5 if rng.uniform() < 0.15 else 0.0)
        strength = float(np.clip(saturation * rng.uniform(0.4, 1.5), 0, 1))
        colours.append(colorsys.hsv_to_rgb(shifted % 1, strength, rng.uniform(0.25, 0.95)))
    return np.array(colours)


def _grid(size):
    """x and y of the pixel centres, in (0, 1), both (size, size, 1)."""
    y, x = (np.indices((size, size, 1))[:2] + 0.5) / size
    return x, y


def _cloud(rng, size):
    return _ramp(0.5 + 0.22 * _noise(rng, size, 4), _shades(rng, 5))


def _marble(rng, size):
    x, y = _grid(size)
    angle = rng.uniform(0, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    veins = np.sin(2 * np.pi * (1.5 * along + 0.3 * _noise(rng, size, 2, persistence=0.5)))
    return _ramp(np.abs(veins) ** 0.6 + 0.06 * _noise(rng, size, 8), _shades(rng, 4, 0.25))


def _wood(rng, size):
    """Planks with rings, streaks along them, and dark joints."""
    x, y = _grid(size)
    plank = (x * 5).astype(int)
    shift = rng.uniform(0, 1, 5)[plank]
    rings = 1.2 * _noise(rng, size, 3, octaves=3, stretch=4) + 7 * (x + 3 * shift)
    streaks = _noise(rng, size, 40, octaves=3, stretch=12)
    value = 0.5 + 0.25 * np.sin(2 * np.pi * rings) + 0.12 * streaks + 0.5 * (shift - 0.5)
    image = _ramp(value, np.array(_WOOD) * rng.uniform(0.8, 1.15, 3))
    joint = np.minimum(x * 5 - plank, 1 - (x * 5 - plank)) < 0.012
    joint |= np.abs(y - rng.uniform(0, 1, 5)[plank]) < 0.003
    return np.where(joint, 0.35 * image, image)


def _brick(rng, size):
    rows, columns = 12, 5
    wobble = 0.02 * _noise(rng, size, 12, octaves=2)
    x, y = _grid(size)
    row = np.floor(y * rows + wobble).astype(int)
    across = x * columns + 0.5 * (row % 2) + wobble
    column = np.floor(across).astype(int)
    colours = _shades(rng, 1, 0.5, hue=0.03)[0] * rng.uniform(0.65, 1.3, (rows + 3, 9, 1))
    image = colours[row + 1, column + 1][:, :, 0] * (1 + 0.12 * _noise(rng, size, 16))
    in_row, in_column = y * rows + wobble - row, across - column
    edge_down, edge_across = (np.minimum(inside, 1 - inside) for inside in (in_row, in_column))
    edge = np.minimum(edge_down, edge_across * rows / columns)
    return np.where(edge < 0.07, 0.66 + 0.06 * _noise(rng, size, 24), image)


def _checker(rng, size):
    """Tiles of two shades, each a little different, so that no two points look the same."""
    cells = int(rng.integers(5, 9))
    x, y = _grid(size)
    row, column = (y * cells).astype(int), (x * cells).astype(int)
    image = _shades(rng, 2, 0.35)[(row + column)[..., 0] % 2]
    image = image * rng.uniform(0.75, 1.2, (cells, cells))[row, column]
    edge = np.minimum.reduce((x * cells - column, 1 - x * cells + column, y * cells - row))
    return np.where(edge < 0.03, 0.4, image * (1 + 0.13 * _noise(rng, size, 6)))


def _stripes(rng, size):
    x, y = _grid(size)
    bounds = np.cumsum(rng.uniform(0.01, 0.09, 40))
    across = x + 0.15 * y + 0.01 * _noise(rng, size, 6)
    image = _shades(rng, 41)[np.searchsorted(bounds, across[..., 0])]
    return image * (1 + 0.1 * _noise(rng, size, 32, octaves=2, stretch=4))


def _pebbles(rng, size):
    """Stones of different sizes: the cells of random points, with dark gaps."""
    x, y = _grid(size)
    warp = 0.006 * _noise(rng, size, 12)
    points = torch.from_numpy(np.concatenate((x + warp, y - warp), axis=-1).reshape(-1, 2))
    distances = torch.cdist(points, torch.from_numpy(rng.uniform(0, 1, (140, 2))))
    nearest, cell = distances.topk(2, dim=1, largest=False)
    gap = (nearest[:, 1] - nearest[:, 0]).numpy().reshape(size, size, 1)
    colours = _shades(rng, 140, 0.3)[cell[:, 0].numpy().reshape(size, size)]
    relief = np.clip(gap / 0.025, 0, 1) ** 0.5
    return colours * (0.25 + 0.75 * relief + 0.1 * _noise(rng, size, 20))


def _text(rng, size):
    """Lines of made-up letters on paper, in a few sizes."""
    paper = _shades(rng, 1, 0.2)[0] * 0.25 + 0.72
    ink = _shades(rng, 1, 0.6)[0] * 0.4
    page = np.zeros((size, size, 1))
    alphabet = np.zeros((26, 7, 4, 1))  # bitmaps of upright and level strokes
    for letter in alphabet:
        letter[:, rng.integers(0, 4)] = 1
        for _ in range(2):
            letter[rng.choice((0, 3, 6)), : rng.integers(2, 5)] = 1
        start = int(rng.integers(0, 4))
        letter[start : start + 4, rng.integers(0, 4)] = 1
    top = size // 40
    while top + 7 * (scale := max(1, round(size / 256 * rng.choice((1, 1, 2, 2, 4))))) <= size:
        left, right = 3 * scale, int(size * rng.uniform(0.6, 1.0)) - 6 * scale
        while left < right:
            if rng.uniform() < 0.18:
                left += 4 * scale
                continue
            letter = np.kron(alphabet[rng.integers(len(alphabet))], np.ones((scale, scale, 1)))
            page[top : top + 7 * scale, left : left + 4 * scale] = letter
            left += 5 * scale
        top += 9 * scale + int(rng.integers(0, 3))
    stained = paper * (1 + 0.06 * _noise(rng, size, 3))
    return stained + page * (ink - stained)


def _leaves(rng, size):
    """The dead leaves model: shapes of all sizes one upon another, which has the statistics of
    natural images (Lee, Mumford and Huang, IJCV 2001)."""
    image = _shades(rng, 1)[0] * np.ones((size, size, 3))
    colours = _shades(rng, 400)
    radii = np.sort(size * 0.3 * rng.uniform(0.004, 1, 400) ** 1.5 + 1.5)[::-1]
    for colour, radius in zip(colours, radii, strict=True):
        x, y = rng.uniform(0, size, 2)
        left, right = max(0, int(x - 1.5 * radius)), min(size, int(x + 1.5 * radius) + 1)
        top, bottom = max(0, int(y - 1.5 * radius)), min(size, int(y + 1.5 * radius) + 1)
        across, down = np.arange(left, right)[None] - x, np.arange(top, bottom)[:, None] - y
        angle = rng.uniform(0, np.pi)
        u = (np.cos(angle) * across + np.sin(angle) * down) / radius
        v = (np.cos(angle) * down - np.sin(angle) * across) / radius * rng.uniform(1, 2.5)
        squares = [u * u, v * v]  # of an ellipse; to the 8th, nearly a rectangle
        if rng.uniform() < 0.33:
            squares = [np.square(np.square(square)) for square in squares]
        inside = squares[0] + squares[1] < 1
        light = 1 + rng.uniform(-0.35, 0.35) * u[inside] + rng.uniform(-0.25, 0.25) * v[inside]
        image[top:bottom, left:right][inside] = colour * light[:, None]
    return image * (1 + 0.12 * _noise(rng, size, 16))


_PAINTERS = (_leaves, _brick, _text, _pebbles, _wood, _cloud, _checker, _marble, _stripes)
