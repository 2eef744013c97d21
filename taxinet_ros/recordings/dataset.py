"""Labelled images of recordings, to train on: one folder a recording, as ``taxinet train`` reads.

They are thinned, as frames in a row are alike, and split by recording, never by frame: a frame in
the validation set whose neighbour was trained on says nothing.
"""

from __future__ import annotations

import csv
import hashlib
import io
from pathlib import Path

import cv2
import numpy as np

from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import make_folder, write_atomically
from taxinet_ros.recordings.score import Score, cell, row_pictures
from taxinet_ros.training.data.dataset_folder import IMAGES
from taxinet_ros.training.data.image_folder import FOREIGN_LABELS

APART_M, APART_DEG = 1.0, 2.0
"""Frames nearer than this to the last one that was taken, and turned by less, are left out."""
_COLUMNS = 'image', 'cte_m', 'heading_error_deg', 'distance_m', 'sha256'


def thinned(found: Score, bag: str) -> list[int]:
    """Rows of a bag's scored frames that are far enough apart."""
    rows: list[int] = []
    table = found.table
    for row in np.flatnonzero(found.scored & (table['bag'] == bag).to_numpy(np.bool_)).tolist():
        if not rows or any(
            abs(cell(table, row, name) - cell(table, rows[-1], name)) >= least
            for name, least in (
                ('distance_m', APART_M), ('cte_m', APART_M), ('heading_error_deg', APART_DEG))
        ):
            rows.append(row)
    return rows


def write_datasets(found: Score, out: Path) -> dict[str, int]:
    """Write a folder of labelled images for each recording; their number by folder.

    Raises:
        UsageError: a folder exists, or two recordings have one name.
        OSError: a file cannot be written.
    """
    bags = {out / one.recording.path.stem: str(one.recording.path) for one in found.bags}
    if len(bags) < len(found.bags):
        raise UsageError(f'--dataset {out}: two recordings have the same name; rename one')
    for folder in bags:
        if folder.exists():
            raise UsageError(f'--dataset {out}: {folder} exists; choose a new folder')
    counts = {}
    for folder, bag in bags.items():
        make_folder(folder / IMAGES)
        text = io.StringIO()
        labels = csv.writer(text, lineterminator='\n')
        labels.writerow(_COLUMNS)
        rows = thinned(found, bag)
        for number, (row, pixels) in enumerate(row_pictures(found, rows)):
            name = f'{IMAGES}/{number:06d}.png'
            data = cv2.imencode('.png', cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))[1].tobytes()
            write_atomically(folder / name, data, sync=False)
            labels.writerow((
                name, *(repr(float(cell(found.table, row, one))) for one in _COLUMNS[1:4]),
                hashlib.sha256(data).hexdigest()))
        write_atomically(folder / FOREIGN_LABELS, text.getvalue())
        counts[str(folder)] = len(rows)
    return counts
