"""A layer of LightGlue (Lindenberger et al., ICCV 2023) as a torch module that exports to a graph.

The parameters are those of the released weights, matrices as (inputs, outputs). Attention is ONNX
Runtime's own operator, which is several times as fast as the exporter's; without ONNX Runtime the
module computes nothing.
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.matching.lightglue import LAYERS

WIDTH = 256  # of a descriptor within the layers
_HEADS = 4
_PART = WIDTH // _HEADS  # of a head


class Affine(nn.Module):
    """x @ weight + bias."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(inputs, outputs))
        self.bias = nn.Parameter(torch.empty(outputs))

    def forward(self, inputs: Tensor) -> Tensor:
        return inputs @ self.weight + self.bias


class Layer(nn.Module):
    """Descriptors (N, 256) and (M, 256) after self-attention in each image, then cross-attention.

    cosines1, sines1, cosines2, sines2: (N, 32) and (M, 32), of the angles of the key points.
    """

    def __init__(self) -> None:
        super().__init__()
        self.self_attn = _SelfAttention()
        self.cross_attn = _CrossAttention()

    def forward(
        self,
        descriptors1: Tensor,
        descriptors2: Tensor,
        cosines1: Tensor,
        sines1: Tensor,
        cosines2: Tensor,
        sines2: Tensor,
    ) -> tuple[Tensor, Tensor]:
        descriptors1 = self.self_attn(descriptors1, cosines1, sines1)
        descriptors2 = self.self_attn(descriptors2, cosines2, sines2)
        return self.cross_attn(descriptors1, descriptors2)


class _Update(nn.Module):
    """Descriptors with the message of an attention added."""

    def __init__(self) -> None:
        super().__init__()
        self.message = Affine(WIDTH, WIDTH)
        self.widen = Affine(2 * WIDTH, 2 * WIDTH)
        self.norm = nn.LayerNorm(2 * WIDTH)
        self.narrow = Affine(2 * WIDTH, WIDTH)

    def forward(self, descriptors: Tensor, attended: Tensor) -> Tensor:
        both = torch.cat([descriptors, self.message(attended)], -1)
        return descriptors + self.narrow(F.gelu(self.norm(self.widen(both))))


class _SelfAttention(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.query = Affine(WIDTH, WIDTH)
        self.key = Affine(WIDTH, WIDTH)
        self.value = Affine(WIDTH, WIDTH)
        self.update = _Update()

    def forward(self, descriptors: Tensor, cosines: Tensor, sines: Tensor) -> Tensor:
        query, key = (
            _turned(part(descriptors), cosines[:, None], sines[:, None])
            for part in (self.query, self.key)
        )
        return self.update(descriptors, _attention(query, key, self.value(descriptors)))


class _CrossAttention(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.query = Affine(WIDTH, WIDTH)  # serves as the key for the other image
        self.value = Affine(WIDTH, WIDTH)
        self.update = _Update()

    def forward(self, descriptors1: Tensor, descriptors2: Tensor) -> tuple[Tensor, Tensor]:
        query1 = self.query(descriptors1)
        query2 = self.query(descriptors2)
        value1 = self.value(descriptors1)
        value2 = self.value(descriptors2)
        return (
            self.update(descriptors1, _attention(query1, query2, value2)),
            self.update(descriptors2, _attention(query2, query1, value1)),
        )


def _turned(features: Tensor, cosines: Tensor, sines: Tensor) -> Tensor:
    """Features (N, 256) with the two halves of each head turned by the angles (N, 1, 32)."""
    first, second = features.unflatten(1, (_HEADS, 2, -1)).unbind(2)
    turned = first * cosines - second * sines, second * cosines + first * sines
    return torch.stack(turned, 2).flatten(1)


def _attention(query: Tensor, key: Tensor, value: Tensor) -> Tensor:
    """(N, 256) of queries (N, 256), keys (M, 256) and values (M, 256)."""
    batch = [part[None] for part in (query, key, value)]
    attended = torch.onnx.ops.symbolic(
        "com.microsoft::MultiHeadAttention",
        batch,
        {"num_heads": _HEADS},
        dtype=torch.float32,
        shape=batch[0].shape,
        version=1,
    )
    return attended[0]


def layer_state(released: Mapping[str, Tensor], index: int) -> dict[str, Tensor]:
    """The parameters of `Layer` number `index` from the released weights."""
    given = {
        key.removeprefix(f"transformers.{index}."): value.t().contiguous()
        for key, value in released.items()
        if key.startswith(f"transformers.{index}.")
    }
    state = {}
    for part in ("weight", "bias"):
        # The released columns are (head, pair, one of two, query or key or value).
        joint = given[f"self_attn.Wqkv.{part}"].unflatten(-1, (_HEADS, _PART // 2, 2, 3))
        query, key, value = joint.unbind(-1)
        state[f"self_attn.query.{part}"] = query.transpose(-1, -2).flatten(-3)
        state[f"self_attn.key.{part}"] = key.transpose(-1, -2).flatten(-3)
        state[f"self_attn.value.{part}"] = value.flatten(-3)
        state[f"cross_attn.query.{part}"] = given[f"cross_attn.to_qk.{part}"]
        state[f"cross_attn.value.{part}"] = given[f"cross_attn.to_v.{part}"]
        for block, message in (("self_attn", "out_proj"), ("cross_attn", "to_out")):
            state[f"{block}.update.message.{part}"] = given[f"{block}.{message}.{part}"]
            for name, number in (("widen", 0), ("norm", 1), ("narrow", 3)):
                state[f"{block}.update.{name}.{part}"] = given[f"{block}.ffn.{number}.{part}"]
    return state


def head_state(released: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """What is computed without a graph: the entry, and the decisions after each layer."""
    state = {
        "input.weight": released["input_proj.weight"].T,
        "input.bias": released["input_proj.bias"],
        "angles": released["posenc.Wr.weight"].T,
    }
    for index in range(LAYERS):
        names = {
            "matchable": f"log_assignment.{index}.matchability",
            "project": f"log_assignment.{index}.final_proj",
            "confident": f"token_confidence.{index}.token.0",
        }
        for name, released_name in names.items():
            if f"{released_name}.weight" in released:  # no decision follows the last layer
                state[f"decisions.{index}.{name}.weight"] = released[f"{released_name}.weight"].T
                state[f"decisions.{index}.{name}.bias"] = released[f"{released_name}.bias"]
    return state
