"""ONNX Runtime. Everything else imports it from here.

Its files for Linux hold its maker's telemetry (seen in 1.32), which starts a thread and leaves a
file `.ses` among the temporary ones, unless it is told not to. Nothing here may send anything.
"""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # read when the library is loaded

import onnxruntime  # noqa: E402

onnxruntime.disable_telemetry_events()

# What a session frees, another may take: with an arena of its own each would keep the most that it
# ever had.
SHARED_ARENA = "session.use_env_allocators"
_ARENA = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
onnxruntime.create_and_register_allocator(
    onnxruntime.OrtMemoryInfo("Cpu", _ARENA, 0, onnxruntime.OrtMemType.DEFAULT), None
)

__all__ = ["SHARED_ARENA", "onnxruntime"]
