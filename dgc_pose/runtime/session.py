"""Sessions of ONNX Runtime."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import WeightsError
from dgc_pose.system.files import open_file
from dgc_pose.system.onnx_library import SHARED_ARENA, onnxruntime

_QUIET = 4  # log level: errors are raised, and need not be printed
_MOST_THREADS = 8  # the graphs are small: more threads would only wait for each other
_MAKING = threading.Lock()  # held while a session is made: two threads may need the same one


class Session:
    """A graph, called with arrays in the order of its inputs, from any thread.

    weights: exactly the graph's initializers, by name. Raises WeightsError if weights are missing
    or do not fit, OSError, with the path, if the graph cannot be read.
    """

    def __init__(self, path: Path, weights: Mapping[str, np.ndarray]) -> None:
        open_file(path, WeightsError).close()  # ONNX Runtime hides the system's message
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = session_threads()
        options.inter_op_num_threads = 1
        options.log_severity_level = _QUIET
        options.add_session_config_entry(SHARED_ARENA, "1")
        # Threads without work must not take the processor from other processes.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")

        # The values must outlive the session.
        self._values = [
            onnxruntime.OrtValue.ortvalue_from_numpy(value) for value in weights.values()
        ]
        options.add_external_initializers(list(weights), self._values)

        try:
            self._session = onnxruntime.InferenceSession(
                str(path),
                options,
                providers=["CPUExecutionProvider"],
                enable_fallback=0,  # would try the same again, and print
            )
        except Exception as error:  # onnxruntime's errors have no common base
            raise WeightsError(f"{path.name}: {str(error).splitlines()[0]}") from error

        self.inputs, self.outputs = (
            [(tensor.name, tensor.shape) for tensor in tensors]
            for tensors in (self._session.get_inputs(), self._session.get_outputs())
        )

    def __call__(self, *arrays: np.ndarray) -> list[np.ndarray]:
        inputs = {name: array for (name, _), array in zip(self.inputs, arrays, strict=True)}
        return self._session.run(None, inputs)


class Sessions:
    """Sessions by key. They are made on first use, from any thread, and again in a forked process,
    which loses their threads."""

    def __init__(self) -> None:
        self._made: dict[tuple[int, Hashable], Session] = {}

    def get(self, key: Hashable, make: Callable[[], Session]) -> Session:
        """The session of a key; `make` makes it if this process has none."""
        own = os.getpid(), key
        with _MAKING:
            if own not in self._made:
                self._made[own] = make()
            return self._made[own]


def session_threads() -> int:
    """As many threads as OpenCV uses, but at most `_MOST_THREADS` and OMP_NUM_THREADS."""
    most = min(_MOST_THREADS, max(1, cv2.getNumThreads()))
    allowed = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    return min(most, int(allowed)) if allowed.isdigit() and int(allowed) > 0 else most
