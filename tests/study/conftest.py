"""Tests of the study use helpers that lie beside other tests."""

import sys
from pathlib import Path

for _name in ('analysis', 'cli', 'core'):
    _folder = str(Path(__file__).resolve().parents[1] / _name)
    if _folder not in sys.path:
        sys.path.append(_folder)
