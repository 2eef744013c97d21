"""What lies in a dataset's folder.

``images/000000.png`` and so on, ``labels.parquet`` with a row for each, and ``dataset.json``, which
is written last: a folder without it is not finished. ``request.json`` says what was asked for and
``finished.jsonl`` which images are done, as long as it is being made.
"""

from __future__ import annotations

IMAGES = 'images'
LABELS = 'labels.parquet'
FACTS = 'dataset.json'
REQUEST = 'request.json'
FINISHED = 'finished.jsonl'


def image_name(index: int) -> str:
    """Path of an image within the folder."""
    return f'{IMAGES}/{index:06d}.png'
