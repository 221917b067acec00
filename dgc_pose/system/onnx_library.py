"""ONNX Runtime. All other modules import it from here.

Its Linux builds contain Microsoft's telemetry (seen in 1.32), which starts a thread and leaves a
temporary file `.ses`. This module turns it off: dgc-pose must not send any data.
"""

import contextlib
import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # read when the library is loaded

import onnxruntime  # noqa: E402

onnxruntime.disable_telemetry_events()

# All sessions share one arena: memory that one frees serves another. With separate arenas, each
# session would keep its peak.
SHARED_ARENA = "session.use_env_allocators"
_ARENA = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
_MEMORY = onnxruntime.OrtMemoryInfo("Cpu", _ARENA, 0, onnxruntime.OrtMemType.DEFAULT)
with contextlib.suppress(RuntimeError):  # old versions, if one is registered: it serves as well
    onnxruntime.create_and_register_allocator(_MEMORY, None)

__all__ = ["SHARED_ARENA", "onnxruntime"]
