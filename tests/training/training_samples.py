"""Scenes, pictures and folders for the tests of the training."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.perception.network import HE_SCALE_RAD, IMAGE_SHAPE, INPUT_SHAPE
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.training.data.dataset import Dataset

SCENES = [
    Scenario(cross_track_m=2.5, heading_rad=-0.3, distance_m=600.0),
    Scenario(cross_track_m=-4.0, heading_rad=0.1, distance_m=900.0),
    Scenario(cross_track_m=0.0, heading_rad=0.0, distance_m=1700.0, clouds='overcast'),
]


def bright_columns(images: int, seed: int) -> Dataset:
    """Pictures with a bright column whose place says where the aircraft is."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-0.8, 0.8, images)
    pictures = rng.integers(0, 60, (images, *INPUT_SHAPE), np.uint8)
    for picture, middle in zip(pictures, place, strict=True):
        column = int(64 + 60 * middle)
        picture[:, column - 3 : column + 3] = 255
    return Dataset(pictures=pictures, cte_m=10 * place, he_rad=-HE_SCALE_RAD * place)


def coloured_frame(seed: int, shape: tuple[int, ...] = IMAGE_SHAPE) -> NDArray[np.uint8]:
    """A soft picture in RGB, that a JPEG does not change much."""
    small = np.random.default_rng(seed).integers(0, 256, (5, 9, 3), np.uint8)
    large = cv2.resize(small, shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(large, np.uint8)


def foreign_folder(
    folder: Path, images: int = 6, shape: tuple[int, ...] = IMAGE_SHAPE, suffix: str = 'png',
    **same: str,
) -> Path:
    """Images and ``labels.csv``, as a user brings them; image ``i`` stands ``i`` m to the left.

    Further columns have the ``same`` value in each line.
    """
    folder.mkdir(parents=True)
    lines = [','.join(['image,cte_m,heading_error_deg', *same])]
    for index in range(images):
        name = f'photo_{index}.{suffix}'
        cv2.imwrite(str(folder / name), coloured_frame(index, shape)[..., ::-1])
        lines.append(','.join([f'{name},{index},{-2.5 * index}', *same.values()]))
    (folder / 'labels.csv').write_text('\n'.join(lines) + '\n')
    return folder
