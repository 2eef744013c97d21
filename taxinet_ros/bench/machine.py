"""What the times depend on besides the program: the machine and the libraries."""

from __future__ import annotations

import os
import platform
import sys
from typing import Any

import cv2

from taxinet_ros.core.provenance import provenance

LOAD = 'load_average'
"""The one fact that is never the same twice."""


def machine_facts() -> dict[str, Any]:
    """Facts by name, as they are after the measuring: torch counts threads once it is loaded."""
    torch = sys.modules.get('torch')
    return {
        **provenance(),
        'cores': os.cpu_count(),
        'cores_allowed': len(os.sched_getaffinity(0)),
        'system': f'{platform.system()} {platform.release()}',
        'opencv_threads': cv2.getNumThreads(),
        'torch_threads': torch.get_num_threads() if torch else None,
        LOAD: [round(load, 2) for load in os.getloadavg()],
    }

