"""Folders of external camera frames with their true positions in ``labels.csv``.

One line per frame, with the columns of :data:`COLUMNS` in any order; other columns are ignored.
Cross-track and heading error have the signs of :mod:`taxinet_ros.core.types`. The heading error is
in degrees; the distance is along the runway from an arbitrary origin of the folder. The labels are
checked when they are read; images are read one at a time, on demand. Files outside the folder are
never opened, and the folder is never written to.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from taxinet_ros.core.perception.network import usual_frame
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import UsageError
from taxinet_ros.files.reading import open_regular

LABELS = 'labels.csv'
COLUMNS = ('image', 'cte_m', 'heading_error_deg', 'distance_m')
FORMATS = ('PNG', 'JPEG', 'BMP', 'TIFF', 'WEBP')

_EIGHT_BIT = ('1', 'L', 'LA', 'P', 'PA', 'RGB', 'RGBA', 'CMYK', 'YCbCr')
_MOST_PIXELS = 64_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class LabelledFrame:
    """One frame with the true position of the aircraft.

    Attributes:
        image: name in the labels, relative to the folder.
        path: the file.
        truth: true tracking error.
        distance_m: distance along the runway [m], from the origin of the folder.
    """

    image: str
    path: Path
    truth: TrackingError
    distance_m: float

    def picture(self) -> NDArray[np.uint8]:
        """Load the frame as (200, 360, 3) uint8 RGB; other sizes are resized.

        Raises:
            UsageError: the file is not an image with 8 bits per channel, is damaged or too large.
        """
        return usual_frame(_decode(self.path))


def read_labelled_frames(folder: Path) -> tuple[LabelledFrame, ...]:
    """Read the frames listed in a folder's ``labels.csv``, in its order.

    Raises:
        UsageError: no such folder or file, a missing column, a value that is not a finite number,
            an image that is missing or outside the folder, or no frames at all.
    """
    if not folder.is_dir():
        raise UsageError(f'{folder}: no such folder; give one that holds frames and {LABELS}')
    path = folder / LABELS
    if not path.exists():
        columns = ','.join(COLUMNS)
        raise UsageError(f'{path}: no such file; write one with the columns {columns}')
    try:
        with io.TextIOWrapper(open_regular(path), encoding='utf-8-sig', newline='') as file:
            return labelled_frames(folder, _lines(file), str(path))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f'{path}: not readable as UTF-8 comma-separated text: {error}') from error


def labelled_frames(
    folder: Path, rows: Iterable[tuple[int, Mapping[str, object]]], where: str
) -> tuple[LabelledFrame, ...]:
    """Check labels from a table and return the frames.

    Args:
        folder: folder of the images.
        rows: line number and values by column name; values are text or numbers.
        where: name of the table for error messages.

    Raises:
        UsageError: as :func:`read_labelled_frames`.
    """
    frames = tuple(_frame(folder, row, f'{where} line {line}') for line, row in rows)
    if not frames:
        raise UsageError(f'{where}: lists no frames; write one line per frame')
    return frames


def _lines(file: Iterable[str]) -> Iterator[tuple[int, Mapping[str, object]]]:
    reader = csv.DictReader(file, skipinitialspace=True)
    reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
    for row in reader:
        yield reader.line_num, row


def _frame(folder: Path, row: Mapping[str, object], where: str) -> LabelledFrame:
    for column in COLUMNS:
        if column not in row:
            given = ', '.join(str(name) for name in row if name is not None)
            raise UsageError(f'{where}: no column {column}; there are {given}; add or rename one')
        if row[column] is None:
            raise UsageError(f'{where}: ends before {column}; complete the line or delete it')
    heading_deg = _number(row, 'heading_error_deg', where)
    if abs(heading_deg) > 180:
        raise UsageError(
            f'{where}: heading_error_deg is {heading_deg:g}, outside -180..180; it is relative to '
            'the runway, nose left positive'
        )
    image = str(row['image']).strip()
    return LabelledFrame(
        image=image,
        path=_inside(folder, image, where),
        truth=TrackingError(cte_m=_number(row, 'cte_m', where), he_rad=math.radians(heading_deg)),
        distance_m=_number(row, 'distance_m', where),
    )


def _number(row: Mapping[str, object], column: str, where: str) -> float:
    try:
        value = float(str(row[column]))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(
            f'{where}: {column} is {str(row[column])!r}, not a finite number; correct the line '
            f'or delete it'
        )
    return value


def _inside(folder: Path, image: str, where: str) -> Path:
    """Path of an image, which must be inside the folder after links are resolved."""
    path = folder / image
    try:
        outside = not path.resolve().is_relative_to(folder.resolve())
        missing = not path.is_file()
    except (OSError, RuntimeError, ValueError):  # invalid name, or circular links
        outside, missing = False, True
    if outside:
        raise UsageError(
            f'{where}: image {image!r} lies outside {folder}; use paths below that folder'
        )
    if missing:
        raise UsageError(
            f'{where}: image {image!r} is not in {folder}; add the file or delete the line'
        )
    return path


def _decode(path: Path) -> NDArray[np.uint8]:
    """Pixels (H, W, 3) uint8 RGB; Pillow, unlike OpenCV, prints no messages."""
    try:
        with Image.open(path, formats=FORMATS) as image:
            fits = image.width * image.height <= _MOST_PIXELS
            if fits and image.mode in _EIGHT_BIT:
                return np.asarray(image.convert('RGB'))
            found = f'{image.width}x{image.height} {image.mode}'
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise UsageError(
            f'{path}: cannot be read as a picture ({"/".join(FORMATS)}); replace it or delete '
            f'its line in the labels'
        ) from error
    raise UsageError(f'{path}: is {found}; save it with 8 bits per channel and fewer pixels')
