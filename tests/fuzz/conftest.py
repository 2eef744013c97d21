"""The corpus is made of what the other tests make their files with."""

from __future__ import annotations

import sys
from pathlib import Path

for _name in ('analysis', 'bag', 'campaign', 'core'):
    _folder = str(Path(__file__).parents[1] / _name)
    if _folder not in sys.path:
        sys.path.append(_folder)
