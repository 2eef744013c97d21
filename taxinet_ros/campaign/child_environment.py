"""The environment of every process that a campaign starts."""

from __future__ import annotations

import os
from pathlib import Path

import taxinet_ros


def child_environment() -> dict[str, str]:
    """This very package, the same hash order every time, and no idle threads for matrices."""
    here = str(Path(taxinet_ros.__file__).resolve().parents[1])
    path = os.pathsep.join(part for part in (here, os.environ.get('PYTHONPATH', '')) if part)
    fixed = {'PYTHONPATH': path, 'PYTHONHASHSEED': '0'}
    return {**os.environ, **fixed, 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}
