"""Networks whose maps are known without any weights, and a small one."""

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import INPUT_SIZE, PRESETS, DecoderConfig, NetworkConfig
from dgc_pose.network.net import DGCNet, Prediction, to_normalised

# For squared images, with a mask, and fast.
SMALL = NetworkConfig(
    "small",
    pyramid=((8,),) * 5,
    decoders=(DecoderConfig((8,), (1,)),) * 5,
    matchability="decoder",
    align_corners=False,
)


class ShiftNet(DGCNet):
    """A small net that maps every cell to itself, shifted in x by a normalised amount."""

    def __init__(self, shift: float = 0.0, align_corners: bool = True) -> None:
        super().__init__(replace(SMALL, align_corners=align_corners))
        self.shift = shift

    def decode(
        self, source: list[Tensor], target: list[Tensor], finest: int = INPUT_SIZE
    ) -> Prediction:
        cells = torch.arange(float(finest))
        grid = torch.stack(torch.meshgrid(cells, cells, indexing="xy"), -1)
        points = to_normalised(grid, (finest, finest), self.config.align_corners)
        points[..., 0] += self.shift
        return Prediction((points.movedim(-1, 0)[None],), (torch.zeros(1, 1, finest, finest),))


class MapNet(nn.Module):
    """Gives the same map and mask for every pair, at all levels.

    map: (240, 240, 2) pixels of the source; matchability: (240, 240) in (0, 1), or None.
    """

    def __init__(self, map: Tensor, matchability: Tensor | None = None) -> None:
        super().__init__()
        self.config = PRESETS["dgcm-lite0"]
        self.anchor = nn.Parameter(torch.zeros(()))  # tells the device
        self.map = map
        self.matchability = matchability

    def forward(self, source: Tensor, target: Tensor) -> Prediction:
        batch = len(source)
        normalised = ((2 * self.map + 1) / 240 - 1).movedim(-1, 0)[None].float()
        maps = [
            # The mean of a cell's pixels is the place of its centre for an affine map.
            F.avg_pool2d(normalised, 240 // cells).expand(batch, -1, -1, -1)
            for cells in (15, 30, 60, 120, 240)
        ]
        if self.matchability is None:
            return Prediction(tuple(maps), ())
        logits = self.matchability.logit().float()[None, None].expand(batch, -1, -1, -1)
        return Prediction(tuple(maps), (logits,))
