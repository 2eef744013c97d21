"""Labelled images of recordings, to train on: one folder a recording, as ``taxinet train`` reads.

They are thinned, as frames in a row are alike, and split by recording, never by frame: a frame in
the validation set whose neighbour was trained on says nothing.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np

from taxinet_ros.files.atomic import make_folder, write_atomically
from taxinet_ros.recordings.score import Score, dataset_folders, row_pictures
from taxinet_ros.training.data.dataset_folder import IMAGES
from taxinet_ros.training.data.image_folder import FOREIGN_LABELS

_POSE = ['cte_m', 'heading_error_deg', 'distance_m']
_APART = 1.0, 2.0, 1.0
"""Frames nearer than this [m], [degrees], [m] to the last one that was taken are left out."""


def thinned(found: Score, bag: str) -> list[int]:
    """Rows of a bag's scored frames that are far enough apart."""
    poses = found.table.loc[found.scored & (found.table['bag'] == bag), _POSE]
    rows: list[int] = []
    for row, pose in zip(poses.index.tolist(), poses.to_numpy(), strict=True):
        if not rows or (np.abs(pose - poses.loc[rows[-1]].to_numpy()) >= _APART).any():
            rows.append(row)
    return rows


def write_datasets(found: Score, out: Path) -> dict[str, int]:
    """Write a folder of labelled images for each recording; their number by folder.

    Raises:
        UsageError: a folder exists, or two recordings have one name.
        OSError: a file cannot be written.
    """
    counts, rig = {}, found.setup.rig
    for folder, bag in dataset_folders(out, [one.recording for one in found.bags]).items():
        make_folder(folder / IMAGES)
        rows, names, digests = thinned(found, bag), [], []
        for number, (_, pixels) in enumerate(row_pictures(found, rows)):
            names.append(f'{IMAGES}/{number:06d}.png')
            data = cv2.imencode('.png', cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))[1].tobytes()
            write_atomically(folder / names[-1], data, sync=False)
            digests.append(hashlib.sha256(data).hexdigest())
        labels = found.table.loc[rows, _POSE].assign(sha256=digests)
        labels.insert(0, 'image', names)
        for key, one in () if rig is None else (('camera', rig.camera), ('aircraft', rig.aircraft)):
            labels[key] = one.name if one.shipped else f'{key}.yaml'
            if not one.shipped:
                write_atomically(folder / f'{key}.yaml', one.yaml)
        write_atomically(folder / FOREIGN_LABELS, labels.to_csv(index=False, lineterminator='\n'))
        counts[str(folder)] = len(rows)
    return counts
