"""ONNX models of known behaviour, written as bytes: the package `onnx` need not be there.

Field numbers are those of onnx.proto3.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

Side = int | str


def write_model(
    path: Path,
    nodes: Sequence[tuple[str, Sequence[str], str, Mapping[str, Sequence[int]]]],
    weights: Mapping[str, np.ndarray],
    inputs: Mapping[str, Sequence[Side]],
    outputs: Mapping[str, Sequence[Side]],
) -> Path:
    """A model of nodes (operator, inputs, output, attributes), of float tensors of these shapes."""
    graph = b"".join(_field(1, _node(*node)) for node in nodes)
    graph += _field(2, b"graph")
    graph += b"".join(_field(5, _tensor(name, value)) for name, value in weights.items())
    graph += b"".join(_field(11, _shape(name, shape)) for name, shape in inputs.items())
    graph += b"".join(_field(12, _shape(name, shape)) for name, shape in outputs.items())
    opset = _field(8, _field(1, b"") + _number(2, 17))
    path.write_bytes(_number(1, 8) + _field(7, graph) + opset)
    return path


def _node(
    operator: str, inputs: Sequence[str], output: str, attributes: Mapping[str, Sequence[int]]
) -> bytes:
    data = b"".join(_field(1, name.encode()) for name in inputs) + _field(2, output.encode())
    for name, values in attributes.items():
        numbers = b"".join(_number(8, value) for value in values)
        data += _field(5, _field(1, name.encode()) + numbers + _number(20, 7))  # 7: INTS
    return data + _field(4, operator.encode())


def _tensor(name: str, value: np.ndarray) -> bytes:
    kind = {np.dtype(np.float32): 1, np.dtype(np.int64): 7}[value.dtype]
    dims = b"".join(_number(1, side) for side in value.shape)
    return dims + _number(2, kind) + _field(8, name.encode()) + _field(9, value.tobytes())


def _shape(name: str, shape: Sequence[Side]) -> bytes:
    sides = b"".join(
        _field(1, _number(1, side) if isinstance(side, int) else _field(2, side.encode()))
        for side in shape
    )
    tensor = _number(1, 1) + _field(2, sides)
    return _field(1, name.encode()) + _field(2, _field(1, tensor))


def _varint(value: int) -> bytes:
    data = b""
    while value >= 128:
        data, value = data + bytes([value % 128 + 128]), value // 128
    return data + bytes([value])


def _number(field: int, value: int) -> bytes:
    return _varint(8 * field) + _varint(value)


def _field(field: int, data: bytes) -> bytes:
    return _varint(8 * field + 2) + _varint(len(data)) + data
