"""How onnxruntime is used here: on one thread, deterministically, silently, on the processor.

onnxruntime is imported by the function that needs it, so that nobody else waits for it.
"""

from __future__ import annotations

import os
from typing import Any

FATAL = 4
"""onnxruntime's least talkative level; every error comes back as an exception."""


def open_session(data: bytes) -> Any:
    """A session with a model: on one machine equal inputs give equal answers, in any process.

    Args:
        data: the model, ONNX; weights in further files are not looked for.

    Raises:
        Exception: onnxruntime's own, which have no other base.
    """
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    options = onnxruntime.SessionOptions()
    options.log_severity_level = FATAL
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.add_session_config_entry('session.load_model_format', 'ONNX')
    # Further files would be looked for in the working folder. In what is no folder are none.
    options.add_session_config_entry(
        'session.model_external_initializers_file_folder_path', os.devnull)
    return onnxruntime.InferenceSession(
        data, options, providers=['CPUExecutionProvider'], enable_fallback=0)
