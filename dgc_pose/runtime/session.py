"""One ONNX graph with its weights, run by ONNX Runtime on the CPU."""

import os
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import WeightsError
from dgc_pose.system.files import open_file
from dgc_pose.system.onnx_library import SHARED_ARENA, onnxruntime

_QUIET = 4  # errors are raised, and need not be printed
_MOST_THREADS = 8  # the graphs are small: more threads would only wait for each other


class Session:
    """A graph, called with arrays in the order of its inputs.

    weights: by the names of the graph's initializers, no others. The number of threads is that of
    `session_threads` when the session is made. Safe to call from several threads at once. Raises
    WeightsError if weights are missing or do not fit, OSError, with the path, if the graph cannot
    be read.
    """

    def __init__(self, path: Path, weights: Mapping[str, np.ndarray]) -> None:
        open_file(path, WeightsError).close()  # ONNX Runtime hides the system's message
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = session_threads()
        options.inter_op_num_threads = 1
        options.log_severity_level = _QUIET
        options.add_session_config_entry(SHARED_ARENA, "1")
        # Threads that wait for work must not take the processor from other processes.
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
                enable_fallback=0,  # it would try the same again, and print
            )
        except Exception as error:  # onnxruntime's errors have no common base
            raise WeightsError(f"{path.name}: {str(error).splitlines()[0]}") from error
        self.inputs, self.outputs = (
            [(tensor.name, tensor.shape) for tensor in tensors]
            for tensors in (self._session.get_inputs(), self._session.get_outputs())
        )

    def __call__(self, *arrays: np.ndarray) -> list[np.ndarray]:
        """The outputs."""
        inputs = {name: array for (name, _), array in zip(self.inputs, arrays, strict=True)}
        return self._session.run(None, inputs)


def session_threads() -> int:
    """As many threads as OpenCV uses (`system.parallel`), and as OMP_NUM_THREADS allows."""
    most = min(_MOST_THREADS, max(1, cv2.getNumThreads()))
    allowed = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    return min(most, int(allowed)) if allowed.isdigit() and int(allowed) > 0 else most
