"""ALIKED (Zhao et al., IEEE TIM 2023) as a torch module that exports to a graph of any image size.

The parameters are those of the released weights, each batch norm folded into the convolution before
it, and matrices as (inputs, outputs). It differs from the paper in how it computes, not in what:

- The features of full resolution, 128 channels, are never made. The first convolution of the score
  head has a kernel of 1x1, so it is applied to each level before the level is enlarged. Descriptors
  take the rows of the levels around their sample points only.
- Deformable convolutions and samples gather rows. ONNX Runtime's GridSample takes twice the time.
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.training.lightglue import Affine

POINTS = 2048  # key points of an image
_RADIUS = 2  # pixels around a key point that contain no higher score
_TEMPERATURE = 0.1  # of the softmax that finds the point within a pixel
_CHANNELS = (16, 32, 64, 128)  # of the levels
_POOLS = (1, 2, 4, 4)  # pixels of the level before that a level's pixel averages
_EPSILON = 1e-5  # of batch norms
Grid = tuple[Tensor, Tensor]  # y and x of pixels


class Aliked(nn.Module):
    """From pixels (H, W, 3) of 0 to 255, multiples of 32, to at most `POINTS` key points: (N, 2),
    descriptors (N, 128) of unit length, and scores (N,), 0 for a row that is no key point."""

    def __init__(self) -> None:
        super().__init__()
        before = 3
        for level, channels in enumerate(_CHANNELS, 1):
            self.add_module(f"block{level}", _Block(before, channels, level))
            self.add_module(f"conv{level}", nn.Conv2d(channels, 32, 1, bias=False))
            self.add_module(f"score{level}", nn.Conv2d(32, 8, 1, bias=False))
            before = channels
        sides = (8, 4, 4, 1)
        self.score_head = nn.ModuleList(
            nn.Conv2d(few, fewer, 3, padding=1, bias=False)
            for few, fewer in zip(sides, sides[1:], strict=False)
        )
        self.desc_head = _Descriptors()

    def forward(self, pixels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        levels = self._levels(pixels.permute(2, 0, 1)[None] / 255)
        scores = self._scores(levels)
        points, values = _key_points(scores)
        return points, self.desc_head(points, levels), values

    def _levels(self, image: Tensor) -> list[Tensor]:
        """The levels (1, 32, h, w), fine to coarse."""
        levels = []
        features = image
        for level, pool in enumerate(_POOLS, 1):
            if pool > 1:
                features = F.avg_pool2d(features, pool, pool)
            features = self.get_submodule(f"block{level}")(features)
            levels.append(F.selu(self.get_submodule(f"conv{level}")(features)))
        return levels

    def _scores(self, levels: list[Tensor]) -> Tensor:
        """The score of each pixel (H, W)."""
        first, *others = (self.get_submodule(f"score{i}")(x) for i, x in enumerate(levels, 1))
        for other in others:
            enlarged = F.interpolate(other, first.shape[2:], mode="bilinear", align_corners=True)
            first = first + enlarged
        for convolution in self.score_head:
            first = convolution(F.selu(first))
        return torch.sigmoid(first)[0, 0]


class _Block(nn.Module):
    """Two convolutions; from level 2 on with a way around them, from level 3 on deformable."""

    def __init__(self, inputs: int, outputs: int, level: int) -> None:
        super().__init__()
        kind = _Deformable if level > 2 else _plain
        self.conv1 = kind(inputs, outputs)
        self.conv2 = kind(outputs, outputs)
        self.downsample = nn.Conv2d(inputs, outputs, 1) if level > 1 else None

    def forward(self, features: Tensor) -> Tensor:
        result = self.conv2(F.selu(self.conv1(features)))
        if self.downsample is not None:
            result = result + self.downsample(features)
        return F.selu(result)


def _plain(inputs: int, outputs: int) -> nn.Module:
    return nn.Conv2d(inputs, outputs, 3, padding=1)


class _Deformable(nn.Module):
    """A convolution of 3x3 whose samples are moved by offsets that the features predict."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.offset_conv = nn.Conv2d(inputs, 2 * 9, 3, padding=1)
        self.weight = nn.Parameter(torch.empty(9 * inputs, outputs))
        self.bias = nn.Parameter(torch.empty(outputs))

    def forward(self, features: Tensor) -> Tensor:
        rows, columns = (torch.arange(side, dtype=torch.float32) for side in features.shape[2:])
        most = (torch.maximum(rows[-1], columns[-1]) + 1) / 4
        offsets = self.offset_conv(features)[0].permute(1, 2, 0).unflatten(2, (9, 2))
        offsets = torch.minimum(torch.maximum(offsets, -most), most)
        tap = torch.arange(-1.0, 2)
        y = rows[:, None, None] + tap.repeat_interleave(3) + offsets[..., 0]
        x = columns[:, None] + tap.repeat(3) + offsets[..., 1]
        samples = _bilinear(features, (y, x)).flatten(2)  # (h, w, 9 C)
        return (samples @ self.weight + self.bias).permute(2, 0, 1)[None]


class _Descriptors(nn.Module):
    """The descriptor of a point, from samples at offsets that the features around it predict."""

    def __init__(self, channels: int = 128, samples: int = 16) -> None:
        super().__init__()
        self.samples = samples
        self.offset1 = Affine(9 * channels, 2 * samples)
        self.offset2 = Affine(2 * samples, 2 * samples)
        self.sample = nn.Parameter(torch.empty(channels, channels))
        self.join = nn.Parameter(torch.empty(samples * channels, channels))

    def forward(self, points: Tensor, levels: list[Tensor]) -> Tensor:
        last_row, last_column = (torch.arange(side)[-1] for side in levels[0].shape[2:])
        # The patch of 3x3 around the point's pixel ends two pixels before the last ones.
        x = torch.minimum((points[:, 0].long() - 1).clamp(min=0), last_column - 3)
        y = torch.minimum((points[:, 1].long() - 1).clamp(min=0), last_row - 3)
        steps = torch.arange(3)
        patch = y[:, None] + steps.repeat_interleave(3), x[:, None] + steps.repeat(3)
        features = _unit_features(levels, patch).flatten(1)
        most = (torch.maximum(last_row, last_column) + 1) / 4
        offsets = self.offset2(F.selu(self.offset1(features)))
        offsets = torch.minimum(torch.maximum(offsets, -most), most).unflatten(1, (2, -1))
        samples = _unit_samples(levels, points[:, :, None] + offsets)
        joined = F.selu(samples @ self.sample).flatten(1) @ self.join
        return F.normalize(joined, dim=-1)


def _rows(features: Tensor, y: Tensor, x: Tensor) -> Tensor:
    """The features (..., C) of the pixels y, x (...) of a map (1, C, h, w)."""
    table = features[0].permute(1, 2, 0).flatten(0, 1)
    return F.embedding(y * features.shape[3] + x, table)  # a Gather


def _bilinear(features: Tensor, at: Grid) -> Tensor:
    """The features (..., C) at points of a map, which is zero beyond its edges."""
    padded = F.pad(features, (1, 1, 1, 1))
    edges = [torch.arange(side)[-1] for side in padded.shape[2:]]
    floors = [torch.floor(axis) for axis in at]
    low, high = (
        [
            torch.minimum((floor.long() + step).clamp(min=0), edge)
            for floor, edge in zip(floors, edges, strict=True)
        ]
        for step in (1, 2)  # one pixel of the frame
    )
    dy, dx = ((axis - floor)[..., None] for axis, floor in zip(at, floors, strict=True))
    upper = _rows(padded, low[0], low[1]) * (1 - dx) + _rows(padded, low[0], high[1]) * dx
    lower = _rows(padded, high[0], low[1]) * (1 - dx) + _rows(padded, high[0], high[1]) * dx
    return upper * (1 - dy) + lower * dy


def _unit_features(levels: list[Tensor], at: Grid) -> Tensor:
    """The features (..., 128) of pixels of the image, of unit length: those of all levels, as if
    each were enlarged so that its outer pixels lie on those of the image."""
    parts = [_rows(levels[0], *at)]
    sides = [torch.arange(side)[-1] for side in levels[0].shape[2:]]
    for level in levels[1:]:
        y, x = (
            axis * (torch.arange(side)[-1] / whole)
            for axis, side, whole in zip(at, level.shape[2:], sides, strict=True)
        )
        parts.append(_bilinear(level, (y, x)))
    return F.normalize(torch.cat(parts, -1), dim=-1)


def _unit_samples(levels: list[Tensor], points: Tensor) -> Tensor:
    """The features (N, M, 128) at points (N, 2, M) of the image, interpolated between those of
    pixels; zero beyond the edges."""
    x, y = points.unbind(1)
    last_row, last_column = (torch.arange(side)[-1] for side in levels[0].shape[2:])
    x0, y0 = x.floor(), y.floor()
    columns, rows = (torch.stack([axis, axis + 1]).long() for axis in (x0, y0))
    across = torch.stack([x0 + 1 - x, x - x0]) * ((columns >= 0) & (columns <= last_column))
    down = torch.stack([y0 + 1 - y, y - y0]) * ((rows >= 0) & (rows <= last_row))
    columns = torch.minimum(columns.clamp(min=0), last_column)
    rows = torch.minimum(rows.clamp(min=0), last_row)
    total = torch.zeros(())
    for i in range(4):
        corner = rows[i // 2], columns[i % 2]
        weight = (down[i // 2] * across[i % 2])[..., None]
        total = total + _unit_features(levels, corner) * weight
    return total


def _key_points(scores: Tensor) -> tuple[Tensor, Tensor]:
    """The points (N, 2) of the highest local maxima of scores (H, W), and their scores (N,)."""
    flat = scores.flatten()
    maxima = _local_maxima(scores)[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS]
    values, best = torch.cat([maxima.flatten(), scores.new_zeros(POINTS)]).topk(POINTS)
    width = torch.arange(maxima.shape[1])[-1] + 1
    best = torch.where(values > 0, best, 0)
    row = torch.div(best, width, rounding_mode="floor")
    y, x = row + _RADIUS, best - row * width + _RADIUS
    steps = torch.arange(-_RADIUS, _RADIUS + 1)
    count = len(steps)
    down, across = steps.repeat_interleave(count), steps.repeat(count)
    windows = flat.take((y[:, None] + down) * scores.shape[1] + x[:, None] + across)
    share = torch.softmax(windows / _TEMPERATURE, -1)
    offset = share @ torch.stack([across, down], -1).float()
    return torch.stack([x, y], -1) + offset, values


def _local_maxima(scores: Tensor) -> Tensor:
    """The scores (H, W) where they are highest in their window, else 0; then, twice, also where
    they are highest outside the windows of those found."""
    found = scores == _highest(scores)
    for _ in range(2):
        near = _highest(found.float()) > 0
        left = torch.where(near, 0, scores)
        found = found | ((left == _highest(left)) & ~near)
    return torch.where(found, scores, 0)


def _highest(values: Tensor) -> Tensor:
    """The highest value in the window around each pixel."""
    return F.max_pool2d(values[None], 2 * _RADIUS + 1, stride=1, padding=_RADIUS)[0]


def aliked_state(released: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The parameters of `Aliked` from the released weights."""
    given = {key: value.double() for key, value in released.items()}
    kept = (".downsample.", ".offset_conv.")
    state = {k: v for k, v in given.items() if k.startswith("block") and any(p in k for p in kept)}
    for level in range(1, len(_CHANNELS) + 1):
        state[f"conv{level}.weight"] = given[f"conv{level}.weight"]
        state[f"score{level}.weight"] = given["score_head.0.weight"].split(32, 1)[level - 1]
        for i in (1, 2):
            name, norm = f"block{level}.conv{i}", f"block{level}.bn{i}"
            scale = given[f"{norm}.weight"] / (given[f"{norm}.running_var"] + _EPSILON).sqrt()
            plain = given.get(f"{name}.weight", given.get(f"{name}.regular_conv.weight"))
            assert plain is not None
            weight = plain * scale[:, None, None, None]
            state[f"{name}.weight"] = weight if f"{name}.weight" in given else _matrix(weight)
            state[f"{name}.bias"] = given[f"{norm}.bias"] - given[f"{norm}.running_mean"] * scale
    for i in range(3):
        state[f"score_head.{i}.weight"] = given[f"score_head.{2 * i + 2}.weight"]
    head = "desc_head"
    for i in (1, 2):
        released_name = f"{head}.offset_conv.{2 * i - 2}"
        state[f"{head}.offset{i}.weight"] = _matrix(given[f"{released_name}.weight"])
        state[f"{head}.offset{i}.bias"] = given[f"{released_name}.bias"]
    state[f"{head}.sample"] = _matrix(given[f"{head}.sf_conv.weight"])
    state[f"{head}.join"] = given[f"{head}.agg_weights"].flatten(0, 1)
    return {key: value.float() for key, value in state.items()}


def _matrix(kernel: Tensor) -> Tensor:
    """A kernel (outputs, inputs, h, w) as a matrix (h w inputs, outputs)."""
    return kernel.permute(2, 3, 1, 0).reshape(-1, len(kernel))
