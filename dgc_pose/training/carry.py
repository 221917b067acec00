"""Files that go from machine to machine: cut into parts, or into encoder and decoders."""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from dgc_pose.errors import WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet

PART_BYTES = 15 * 2**20
_COUNTER = "num_batches_tracked"
_ENCODER = ("pyramid.", "correlation_scale")  # how the encoder's keys begin


def write_parts(
    content: bytes, folder: Path, name: str, part_bytes: int = PART_BYTES
) -> list[Path]:
    """Write `content` as NAME-1-of-2 and so on, each of at most `part_bytes`."""
    count = max(1, -(-len(content) // part_bytes))
    paths = [folder / f"{name}-{index + 1}-of-{count}" for index in range(count)]
    for index, path in enumerate(paths):
        path.write_bytes(content[index * part_bytes : (index + 1) * part_bytes])
    return paths


def read_parts(folder: Path, name: str) -> bytes | None:
    """What `write_parts` wrote, None where it wrote nothing. Raises WeightsError at a gap."""
    found = sorted(folder.glob(f"{name}-*-of-*"))
    if not found:
        return None
    count = int(found[0].name.rsplit("-", 1)[1])
    paths = [folder / f"{name}-{index + 1}-of-{count}" for index in range(count)]
    missing = [path.name for path in paths if not path.is_file()]
    if missing or len(found) != count:
        raise WeightsError(f"{folder}: not the parts of one file ({', '.join(missing) or 'mixed'})")
    return b"".join(path.read_bytes() for path in paths)


def write_halves(net: DGCNet, folder: Path) -> list[Path]:
    """Write a network's encoder and decoders as two safetensors files in half precision."""
    paths = []
    for half in ("encoder", "decoders"):
        state = {
            key: value.detach().cpu().half().contiguous()
            for key, value in net.state_dict().items()
            if not key.endswith(_COUNTER) and key.startswith(_ENCODER) == (half == "encoder")
        }
        paths.append(folder / f"{net.config.name}-{half}.safetensors")
        paths[-1].write_bytes(save(state, metadata={"preset": net.config.name, "half": half}))
    return paths


def join_halves(folder: Path) -> DGCNet:
    """The network of the two files in a folder. Raises WeightsError where they are not there."""
    state: dict[str, Tensor] = {}
    names = set()
    for half in ("encoder", "decoders"):
        found = sorted(folder.glob(f"*-{half}.safetensors"))
        if len(found) != 1:
            raise WeightsError(f"{folder}: {len(found)} files *-{half}.safetensors, not one")
        try:
            with safe_open(found[0], "pt") as file:
                names.add((file.metadata() or {}).get("preset", ""))
                state |= {key: file.get_tensor(key).float() for key in file.keys()}
        except (SafetensorError, OSError) as error:
            raise WeightsError(f"{found[0]}: not a safetensors file") from error
    if len(names) != 1:
        raise WeightsError(f"{folder}: encoder and decoders of two presets, {sorted(names)}")
    net = DGCNet(preset(names.pop()))
    wanted = {key for key in net.state_dict() if not key.endswith(_COUNTER)}
    if wanted != state.keys():
        raise WeightsError(f"{folder}: not the encoder and decoders of one {net.config.name}")
    try:
        net.load_state_dict(state, strict=False)
    except RuntimeError as error:
        raise WeightsError(f"{folder}: not the weights of {net.config.name}") from error
    return net.eval()
