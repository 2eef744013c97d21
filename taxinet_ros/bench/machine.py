"""What the times depend on besides the program: the machine and the libraries."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2

LOAD = 'load_average'
"""The one fact that is never the same twice."""

_LIBRARIES = ('numpy', 'opencv-python-headless', 'torch', 'jsbsim')


def machine_facts() -> dict[str, Any]:
    """Facts by name, as they are after the measuring: torch counts threads once it is loaded."""
    torch = sys.modules.get('torch')
    return {
        'processor': _processor(),
        'cores': os.cpu_count(),
        'cores_allowed': len(os.sched_getaffinity(0)),
        'system': f'{platform.system()} {platform.release()}',
        'python': platform.python_version(),
        **{library: version(library) for library in _LIBRARIES},
        'opencv_threads': cv2.getNumThreads(),
        'torch_threads': torch.get_num_threads() if torch else None,
        LOAD: [round(load, 2) for load in os.getloadavg()],
    }


def _processor() -> str:
    """Model of the processor, as the kernel names it."""
    lines = Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines()
    models = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return models[0] if models else platform.machine()
