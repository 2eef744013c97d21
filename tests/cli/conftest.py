"""Small networks, and labelled folders, lie beside other tests."""

import sys
from pathlib import Path

for _room in ('core', 'training'):
    _folder = str(Path(__file__).resolve().parents[1] / _room)
    if _folder not in sys.path:
        sys.path.append(_folder)
