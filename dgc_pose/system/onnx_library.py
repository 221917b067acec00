"""ONNX Runtime. Everything else imports it from here.

Its files for Linux hold its maker's telemetry (seen in 1.32), which starts a thread and leaves a
file `.ses` among the temporary ones, unless it is told not to. Nothing here may send anything.
"""

import contextlib
import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # read when the library is loaded

import onnxruntime  # noqa: E402

onnxruntime.disable_telemetry_events()

# What a session frees, another may take: with an arena of its own each would keep the most that it
# ever had.
SHARED_ARENA = "session.use_env_allocators"
_ARENA = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
_MEMORY = onnxruntime.OrtMemoryInfo("Cpu", _ARENA, 0, onnxruntime.OrtMemType.DEFAULT)
with contextlib.suppress(RuntimeError):  # of old versions, if one is registered: it serves as well
    onnxruntime.create_and_register_allocator(_MEMORY, None)

__all__ = ["SHARED_ARENA", "onnxruntime"]
