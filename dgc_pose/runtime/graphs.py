"""The ONNX graphs: of which presets there are some, and where they lie."""

from pathlib import Path

PRESETS = ("dgcm-lite0",)
GRAPHS = Path(__file__).parent / "graphs"  # one folder a preset
LEVELS, NATIVE = "levels.onnx", "native.onnx"  # the pyramid, all of it and its coarser levels
WARP, UPSAMPLE, RESAMPLE = "warp.onnx", "upsample.onnx", "resample.onnx"  # without weights
# Beside the graphs: "stored", the shape of each stored weight by name, and "graphs", for each graph
# the names of the weights that it is to be given, their batch norms folded.
WEIGHTS = "weights.json"


def decoder_graph(level: int) -> str:
    """The file of a level's decoder."""
    return f"reg_{level}.onnx"
