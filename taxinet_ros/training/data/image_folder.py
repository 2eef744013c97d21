"""Folders of images with a label table, made by ``taxinet dataset`` or from other sources.

The table is ``labels.parquet`` or ``labels.csv`` with the columns ``image``, ``cte_m`` (left
positive), ``heading_error_deg`` (nose left positive) and optionally ``distance_m`` along the
runway, from an arbitrary origin; other columns are ignored. An optional column ``sha256`` has the
digests of the image files, which are then checked. For networks that see through a virtual camera,
``camera`` and ``aircraft`` say what took each image: a name, or a YAML file in the folder. The
labels are checked when they are read, images when they are used. Files outside the folder are never
opened.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from taxinet_ros.core.perception.domain import Domain, domain_of_scenes, joined_domains
from taxinet_ros.core.perception.network import INPUT_SHAPE, decode_picture, usual_frame
from taxinet_ros.core.perception.weights import Source
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.scenario_fields import (
    AIRCRAFT_MODEL,
    CAMERA,
    CAMERA_OFFSETS,
    CATALOGUES,
    PLACE,
)
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import UsageError
from taxinet_ros.files.reading import open_regular
from taxinet_ros.files.sealed_json import file_sha256, read_sealed
from taxinet_ros.training.data.dataset import Dataset, Progress, network_picture, no_progress
from taxinet_ros.training.data.dataset_folder import DOCUMENTS, FACTS, LABELS
from taxinet_ros.training.data.unfinished import is_begun

FOREIGN_LABELS = 'labels.csv'
COLUMNS = ('image', 'cte_m', 'heading_error_deg')
_RIG = (CAMERA, AIRCRAFT_MODEL)

_Row = tuple[int, Mapping[str, object]]
"""Number of a line or row, from 1, and its values by column name."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LabelledFrame:
    """One image with the true position of the aircraft.

    Attributes:
        image: name in the labels, relative to the folder.
        path: the file.
        truth: true tracking error.
        distance_m: distance along the runway [m], from the origin of the folder.
        sha256: digest of the file that the table states, or ''.
        rig: camera and aircraft that took it; None if it was not asked for them.
    """

    image: str
    path: Path
    truth: TrackingError
    distance_m: float
    sha256: str = ''
    rig: Rig | None = None

    def picture(self) -> tuple[NDArray[np.uint8], str]:
        """The image as a camera frame, uint8 RGB, and its file's digest.

        The frame is (200, 360, 3), or with a known rig as large as its camera makes it.

        Raises:
            UsageError: it is damaged, too small for the network, not of the camera's size, or has
                changed.
        """
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise UsageError(f'{self.path}: cannot be read ({error.strerror})') from error
        digest = hashlib.sha256(data).hexdigest()
        if self.sha256 and digest != self.sha256:
            raise UsageError(
                f'{self.path}: is not the file that the table describes (its SHA-256 differs); '
                'restore it, or make the dataset again'
            )
        try:
            pixels = decode_picture(data)
        except ValueError as error:
            raise UsageError(f'{self.path}: {error}; replace it or delete its row') from error
        height, width = pixels.shape[:2]
        if width < INPUT_SHAPE[1] or height < INPUT_SHAPE[0]:
            raise UsageError(
                f'{self.path}: has {width}x{height} pixels, fewer than the {INPUT_SHAPE[1]}x'
                f'{INPUT_SHAPE[0]} that the network sees; replace it or delete its row'
            )
        if self.rig is None:
            return usual_frame(pixels), digest
        camera = self.rig.camera
        if pixels.shape != camera.shape:
            raise UsageError(
                f'{self.path}: has {width}x{height} pixels, its camera {camera.name} '
                f'{camera.width_px}x{camera.height_px}; name the camera that took it, with its '
                'size_px (docs/world.md)'
            )
        return pixels, digest


@dataclass(frozen=True, kw_only=True, slots=True)
class ImageFolder:
    """A folder with checked labels and existing images.

    Attributes:
        path: path of the folder.
        table: label table.
        frames: images and labels, in the order of the table.
    """

    path: Path
    table: Path
    frames: tuple[LabelledFrame, ...]

    def __len__(self) -> int:
        return len(self.frames)

    def picture(self, row: int) -> tuple[NDArray[np.uint8], str]:
        """As :meth:`LabelledFrame.picture`; an error names the row, too."""
        try:
            return self.frames[row].picture()
        except UsageError as error:
            raise UsageError(f'{self.table}: row {row + 1}: {error}') from error

    def source(self, digests: Sequence[str]) -> Source:
        """The folder's entry in a model card, from the digests of all images, and of the rigs."""
        whole = hashlib.sha256(self.table.read_bytes())
        for frame, digest in zip(self.frames, digests, strict=True):
            whole.update(f'{digest} {frame.image}\n'.encode())
        for rig in dict.fromkeys(frame.rig for frame in self.frames if frame.rig is not None):
            whole.update(f'{rig.camera.digest} {rig.aircraft.digest}\n'.encode())
        name = self.path.resolve().name or str(self.path)
        return Source(kind='folder', name=name, sha256=whole.hexdigest())


def open_folder(path: Path, *, rigs: bool = False) -> ImageFolder:
    """Open a folder and check its labels; the images are read later, one by one.

    Args:
        path: path of the folder.
        rigs: whether camera and aircraft of each image have to be known.

    Raises:
        UsageError: one line on the first error: file, row and correction.
    """
    table = _table(path)
    frames, lines, known = [], dict[str, int](), dict[tuple[object, ...], Rig]()
    for number, row in _rows(table):
        where = f'{table} line {number}'
        frame = _frame(path, row, where)
        before = lines.setdefault(os.path.normpath(frame.image), number)
        if before != number:
            raise UsageError(
                f'{where}: image {frame.image!r} is already in line {before}; delete one of them'
            )
        frames.append(replace(frame, rig=_rig(path, row, where, known)) if rigs else frame)
    if not frames:
        raise UsageError(f'{table}: lists no frames; write one line per frame')
    return ImageFolder(path=path, table=table, frames=tuple(frames))


def _frame(folder: Path, row: Mapping[str, object], where: str) -> LabelledFrame:
    for column in COLUMNS:
        if column not in row:
            given = ', '.join(str(name) for name in row if name is not None)
            raise UsageError(f'{where}: no column {column}; there are {given}; add or rename one')
    row = {'distance_m': 0.0, 'sha256': '', **row}
    heading_deg = _number(row, 'heading_error_deg', where)
    if abs(heading_deg) > 180:
        raise UsageError(
            f'{where}: heading_error_deg is {heading_deg:g}, outside -180..180; it is relative to '
            'the runway, nose left positive'
        )
    image = str(row['image']).strip()
    return LabelledFrame(
        image=image, path=_inside(folder, image, where), sha256=str(row['sha256']),
        truth=TrackingError(cte_m=_number(row, 'cte_m', where), he_rad=math.radians(heading_deg)),
        distance_m=_number(row, 'distance_m', where),
    )


def _rig(
    folder: Path, row: Mapping[str, object], where: str, known: dict[tuple[object, ...], Rig]
) -> Rig:
    """Camera and aircraft of a row; each is made once."""
    told = tuple(row.get(field.key) for field in (*_RIG, *CAMERA_OFFSETS))
    if told not in known:
        words: dict[str, Any] = {field.key: str(row.get(field.key) or '').strip() for field in _RIG}
        if missing := [key for key, word in words.items() if not word]:
            raise UsageError(
                f'{where}: names no {" and no ".join(missing)}, which networks with a view have to '
                f'know; add columns {" and ".join(words)}, with names or YAML files in {folder} '
                '(docs/networks.md)'
            )
        for key, word in words.items():
            if Path(word).suffix and not word.startswith('{'):
                words[key] = _inside(folder, word, where, key)
        offsets = {
            field.key: _number(row, field.key, where) for field in CAMERA_OFFSETS
            if row.get(field.key)
        }
        try:
            known[told] = scenario_from_human({**words, **offsets}).rig
        except UsageError as error:
            raise UsageError(f'{where}: {error}') from None
    return known[told]


def _number(row: Mapping[str, object], column: str, where: str) -> float:
    try:
        value = float(str(row[column]))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(
            f'{where}: {column} is {str(row[column])!r}, not a finite number; correct it, complete '
            'the line or delete it'
        )
    return value


def _inside(folder: Path, image: str, where: str, what: str = 'image') -> Path:
    """Path of a file, which must be inside the folder after links are resolved."""
    path = folder / image
    try:
        outside = not path.resolve().is_relative_to(folder.resolve())
        missing = not path.is_file()
    except (OSError, RuntimeError, ValueError):  # invalid name, or circular links
        outside, missing = False, True
    if outside:
        raise UsageError(
            f'{where}: {what} {image!r} lies outside {folder}; use paths below that folder'
        )
    if missing:
        raise UsageError(
            f'{where}: {what} {image!r} is not in {folder}; add the file or delete the line'
        )
    return path


def folders_domain(paths: Sequence[Path]) -> Domain | None:
    """What folders of `taxinet dataset` show; None if one is of other pictures.

    Raises:
        UsageError: a table cannot be read.
    """
    domains: list[Domain | None] = []
    for path in paths:
        table = _table(path)
        ours = table.suffix == '.parquet'
        rows: Any = [row for _, row in _rows(table)] if ours else []
        whole = all(PLACE.key in row and CAMERA.key in row for row in rows)
        domains.append(domain_of_scenes(rows) if rows and whole else None)
    return joined_domains(domains)


def load_folders(
    paths: Sequence[Path], *, workers: int, view: str | None = None, stage: str = 'images',
    progress: Progress = no_progress,
) -> tuple[Dataset, tuple[Source, ...]]:
    """Load the pictures of one or more folders as network inputs, one folder after the other.

    Args:
        paths: paths of the folders.
        workers: number of reading threads; the result does not depend on it.
        view: virtual camera through which the pictures are seen; None for the images as they are.
        stage: name of the stage for ``progress``.
        progress: called after every picture.

    Raises:
        UsageError: as :func:`open_folder` and :meth:`ImageFolder.picture`.
    """
    folders = [open_folder(path, rigs=view is not None) for path in paths]
    total = sum(len(folder) for folder in folders)
    pictures = np.empty((total, *INPUT_SHAPE), np.uint8)
    sources = []
    done = 0
    for folder in folders:
        digests = []
        for picture, digest in _shrunk(folder, view, workers):
            pictures[done] = picture
            digests.append(digest)
            done += 1
            progress(stage, done, total)
        sources.append(folder.source(digests))
    truth = [frame.truth for folder in folders for frame in folder.frames]
    return Dataset(
        pictures=pictures,
        cte_m=np.array([error.cte_m for error in truth]),
        he_rad=np.array([error.he_rad for error in truth]),
    ), tuple(sources)


def _shrunk(
    folder: ImageFolder, view: str | None, workers: int
) -> Iterator[tuple[NDArray[np.uint8], str]]:
    def look(row: int) -> tuple[NDArray[np.uint8], str]:
        picture, digest = folder.picture(row)
        return network_picture(picture, view, folder.frames[row].rig), digest

    with ThreadPoolExecutor(workers) as pool:
        try:
            yield from pool.map(look, range(len(folder)))
        finally:
            pool.shutdown(cancel_futures=True)


def _table(folder: Path) -> Path:
    if not folder.is_dir():
        raise UsageError(f'{folder}: no such folder; name one with images and their labels')
    if is_begun(folder) and not (folder / FACTS).exists():
        raise UsageError(
            f'{folder}: this dataset is unfinished; continue it with taxinet dataset --resume'
        )
    found = [folder / name for name in (LABELS, FOREIGN_LABELS) if (folder / name).exists()]
    if not found:
        raise UsageError(
            f'{folder}: contains neither {LABELS} nor {FOREIGN_LABELS}; write one with the columns '
            'image,cte_m,heading_error_deg'
        )
    if len(found) > 1:
        raise UsageError(
            f'{folder}: contains both {LABELS} and {FOREIGN_LABELS}; keep only one of them'
        )
    if (folder / FACTS).exists():
        _check_digest(folder, found[0])
    return found[0]


def _check_digest(folder: Path, table: Path) -> None:
    facts = folder / FACTS
    try:
        values = read_sealed(facts).values
        expected = values['labels_sha256']
        for key, document in values.get(DOCUMENTS, ()):
            CATALOGUES[key].find(document)  # from now on its reference is known
    except (OSError, LookupError) as error:
        raise UsageError(f'{facts}: cannot be read; make the dataset again') from error
    if file_sha256(table) != expected:
        raise UsageError(
            f'{table}: is not the table that {FACTS} describes (its SHA-256 differs); restore it, '
            'or make the dataset again'
        )


def _rows(table: Path) -> list[_Row]:
    """Numbers of rows or lines, and their values by column."""
    try:
        with open_regular(table) as file:
            if table.suffix == '.parquet':
                rows: list[Any] = pd.read_parquet(file).to_dict('records')
                return list(enumerate(rows, 1))
            text = io.TextIOWrapper(file, encoding='utf-8-sig', newline='')
            reader = csv.DictReader(text, skipinitialspace=True)
            reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
            return [(reader.line_num, row) for row in reader]
    except (OSError, ValueError, csv.Error) as error:
        reason = ' '.join(str(error).split())[:120]
        raise UsageError(f'{table}: cannot be read ({reason}); write it again') from error
