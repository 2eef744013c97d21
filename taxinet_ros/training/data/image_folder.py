"""Folders of images with a label table, made by ``taxinet dataset`` or from other sources.

The table is ``labels.parquet`` or ``labels.csv`` with the columns ``image``, ``cte_m`` (left
positive), ``heading_error_deg`` (nose left positive) and optionally ``distance_m``. An optional
column ``sha256`` has the digests of the image files, which are then checked.
"""

from __future__ import annotations

import csv
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from PIL import Image

from taxinet_ros.core.perception.domain import Domain, domain_of_scenes, joined_domains
from taxinet_ros.core.perception.labelled_frames import LabelledFrame, labelled_frames
from taxinet_ros.core.perception.network import INPUT_SHAPE, shrink
from taxinet_ros.core.perception.weights import Source
from taxinet_ros.core.scenario_fields import CAMERA, PLACE
from taxinet_ros.errors import UsageError
from taxinet_ros.files.sealed_json import file_sha256, read_sealed
from taxinet_ros.training.data.dataset import Dataset, Progress, no_progress
from taxinet_ros.training.data.dataset_folder import FACTS, LABELS
from taxinet_ros.training.data.unfinished import is_begun

FOREIGN_LABELS = 'labels.csv'
_DIGEST = 'sha256'

_Row = tuple[int, Mapping[str, object]]
"""Number of a line or row, from 1, and its values by column name."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ImageFolder:
    """A folder with checked labels and existing images.

    Attributes:
        path: path of the folder.
        table: label table.
        frames: images and labels, in the order of the table.
        digests: digests of the image files from the table; empty if it has none.
    """

    path: Path
    table: Path
    frames: tuple[LabelledFrame, ...]
    digests: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.frames)

    def picture(self, row: int) -> tuple[NDArray[np.uint8], str]:
        """One image as a camera frame, (200, 360, 3) uint8 RGB, and its file's digest.

        Raises:
            UsageError: it is damaged, too small for the network, or has changed.
        """
        frame = self.frames[row]
        where = f'{self.table}: row {row + 1}: image {frame.image!r}'
        try:
            found = hashlib.sha256(frame.path.read_bytes()).hexdigest()
        except OSError as error:
            raise UsageError(f'{where} cannot be read ({error.strerror})') from error
        if self.digests and found != self.digests[row]:
            raise UsageError(
                f'{where} is not the file that the table describes (its SHA-256 differs); '
                'restore it, or make the dataset again'
            )
        try:
            picture = frame.picture()
        except UsageError as error:
            raise UsageError(f'{where}: {error}') from error
        with Image.open(frame.path) as image:
            width, height = image.size
        if width < INPUT_SHAPE[1] or height < INPUT_SHAPE[0]:
            raise UsageError(
                f'{where} has {width}x{height} pixels, fewer than the {INPUT_SHAPE[1]}x'
                f'{INPUT_SHAPE[0]} that the network sees; replace it or delete its row'
            )
        return picture, found

    def source(self, digests: Sequence[str]) -> Source:
        """The folder's entry in a model card, from the digests of all images."""
        whole = hashlib.sha256(self.table.read_bytes())
        for frame, digest in zip(self.frames, digests, strict=True):
            whole.update(f'{digest} {frame.image}\n'.encode())
        name = self.path.resolve().name or str(self.path)
        return Source(kind='folder', name=name, sha256=whole.hexdigest())


def open_folder(path: Path) -> ImageFolder:
    """Open a folder and check its labels; the images are read later, one by one.

    Raises:
        UsageError: one line on the first error: file, row and correction.
    """
    table = _table(path)
    rows = list(_parquet_rows(table) if table.suffix == '.parquet' else _csv_rows(table))
    frames = labelled_frames(path, [(number, _complete(row)) for number, row in rows], str(table))
    lines: dict[str, int] = {}
    for (number, _), frame in zip(rows, frames, strict=True):
        name = os.path.normpath(frame.image)
        if name in lines:
            raise UsageError(
                f'{table} line {number}: image {frame.image!r} is already in line {lines[name]}; '
                'delete one of them'
            )
        lines[name] = number
    digests = tuple(str(row[_DIGEST]) for _, row in rows if _DIGEST in row)
    return ImageFolder(path=path, table=table, frames=frames, digests=digests)


def folders_domain(paths: Sequence[Path]) -> Domain | None:
    """What folders of `taxinet dataset` show; None if one is of other pictures.

    Raises:
        UsageError: a table cannot be read.
    """
    domains: list[Domain | None] = []
    for path in paths:
        table = _table(path)
        ours = table.suffix == '.parquet'
        rows: Any = _read(table, partial(pd.read_parquet, table)).to_dict('records') if ours else ()
        whole = all(PLACE.key in row and CAMERA.key in row for row in rows)
        domains.append(domain_of_scenes(rows) if rows and whole else None)
    return joined_domains(domains)


def load_folders(
    paths: Sequence[Path], *, workers: int, stage: str = 'images', progress: Progress = no_progress
) -> tuple[Dataset, tuple[Source, ...]]:
    """Load the pictures of one or more folders as network inputs, one folder after the other.

    Args:
        paths: paths of the folders.
        workers: number of reading threads; the result does not depend on it.
        stage: name of the stage for ``progress``.
        progress: called after every picture.

    Raises:
        UsageError: as :func:`open_folder` and :meth:`ImageFolder.picture`.
    """
    folders = [open_folder(path) for path in paths]
    total = sum(len(folder) for folder in folders)
    pictures = np.empty((total, *INPUT_SHAPE), np.uint8)
    sources = []
    done = 0
    for folder in folders:
        digests = []
        for picture, digest in _shrunk(folder, workers):
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


def _shrunk(folder: ImageFolder, workers: int) -> Iterator[tuple[NDArray[np.uint8], str]]:
    def look(row: int) -> tuple[NDArray[np.uint8], str]:
        picture, digest = folder.picture(row)
        return shrink(picture), digest

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
    found = [folder / name for name in (LABELS, FOREIGN_LABELS) if (folder / name).is_file()]
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
        expected = read_sealed(facts).values['labels_sha256']
    except (OSError, LookupError) as error:
        raise UsageError(f'{facts}: cannot be read; make the dataset again') from error
    if file_sha256(table) != expected:
        raise UsageError(
            f'{table}: is not the table that {FACTS} describes (its SHA-256 differs); restore it, '
            'or make the dataset again'
        )


def _complete(row: Mapping[str, object]) -> Mapping[str, object]:
    """A row with the optional distance filled in, which is not used for training."""
    return row if 'distance_m' in row else {**row, 'distance_m': 0.0}


def _parquet_rows(table: Path) -> Iterator[_Row]:
    frame = _read(table, lambda: pd.read_parquet(table))
    for number, row in enumerate(frame.to_dict('records'), 1):
        yield number, {str(name): 'nothing' if _is_gap(v) else v for name, v in row.items()}


def _is_gap(value: object) -> bool:
    return value is None or value is pd.NA


def _csv_rows(table: Path) -> Iterator[_Row]:
    def lines() -> list[_Row]:
        with table.open(encoding='utf-8-sig', newline='') as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
            return [(reader.line_num, row) for row in reader]

    yield from _read(table, lines)


def _read(table: Path, read: Callable[[], Any]) -> Any:
    try:
        return read()
    except (OSError, ValueError, csv.Error) as error:
        reason = ' '.join(str(error).split())[:120]
        raise UsageError(f'{table}: cannot be read ({reason}); write it again') from error
