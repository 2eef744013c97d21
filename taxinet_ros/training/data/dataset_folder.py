"""Datasets on disk: a folder of images of a Scenic program's scenes, with a table of labels.

It contains ``images/000000.png`` and so on, ``labels.parquet`` with a row for each, and
``dataset.json``, which is written last: a folder without it is unfinished. While it is being made,
``request.json`` has the options and ``finished.jsonl`` the finished images.

An image is a pure function of program, seed and number, so an interrupted dataset is continued by
rendering the missing images, with a byte-identical result. Files are written atomically and never
replaced.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from taxinet_ros.campaign.scenes.programs import check_same_files, find_program
from taxinet_ros.campaign.scenes.source import program_text
from taxinet_ros.core.renderer import OURS, find_renderer
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import FULL_DISK, draft_path, make_folder, write_atomically
from taxinet_ros.files.journal import Journal, JournalOwner, damaged_line
from taxinet_ros.files.plain_values import check_kind
from taxinet_ros.files.sealed_json import read_sealed, sealed_text
from taxinet_ros.training.data.dataset import SAMPLERS, Progress, draw_scenes, no_progress
from taxinet_ros.training.data.photographs import photographs
from taxinet_ros.version import __version__

IMAGES = 'images'
LABELS = 'labels.parquet'
FACTS = 'dataset.json'
REQUEST = 'request.json'
FINISHED = 'finished.jsonl'


def image_name(index: int) -> str:
    """Path of an image within the folder."""
    return f'{IMAGES}/{index:06d}.png'


@dataclass(frozen=True, kw_only=True, slots=True)
class FinishedImage:
    """An image in the folder.

    Attributes:
        index: number of the image.
        cte_m, he_rad: true errors [m], [rad].
        sha256: digest of the file.
    """

    index: int
    cte_m: float
    he_rad: float
    sha256: str


class FinishedImages(JournalOwner):
    """The open record of finished images, for one writer at a time; a context manager."""

    def __init__(self, path: Path) -> None:
        """Open ``path`` to append, creating it if needed; a torn last line is removed.

        Raises:
            UsageError: it cannot be opened, is not such a record, or another command writes to it.
        """
        self._path = path
        try:
            self._journal = Journal(path)
        except BlockingIOError as error:
            raise UsageError(f'dataset: {path.parent}: another command is writing to it') from error
        except OSError as error:
            raise UsageError(f'dataset: {path}: {error.strerror}') from error
        try:
            self.rows = self._read()
        except BaseException:
            self._journal.close()
            raise

    def add(self, row: FinishedImage) -> None:
        """Record that an image is finished.

        Raises:
            OSError: the line could not be written completely, for example on a full disk.
        """
        self._journal.append(asdict(row))
        self.rows[row.index] = row

    def _read(self) -> dict[int, FinishedImage]:
        rows = {}
        for number, event in enumerate(self._journal.events, start=1):
            try:
                row = FinishedImage(**event)
                for name, kind in FinishedImage.__annotations__.items():
                    check_kind(name, kind, getattr(row, name))
            except (TypeError, ValueError) as error:
                raise damaged_line(self._path, number, str(error)) from error
            rows[row.index] = row
        return rows


_LIMITS = {'count': (1, 1_000_000), 'seed': (0, 2**63 - 1), 'workers': (1, 256)}


_DRAFT = draft_path(Path(REQUEST)).name
"""File that a kill or a full disk may leave of a dataset that was not yet started."""
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
"""All levels are lossless; higher ones take several times as long to save a tenth of the size."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DatasetOptions:
    """Options of a dataset; checked on construction.

    Attributes:
        program: word of a shipped Scenic program or path of one.
        out: folder to create; missing or empty, unless ``resume``.
        count: number of images, one per scene.
        sampler: a word of :data:`~taxinet_ros.training.data.dataset.SAMPLERS`.
        seed: seed of everything random.
        varied: whether the look of the world varies.
        camera: who takes the pictures (:mod:`taxinet_ros.core.renderer`).
        workers: number of rendering processes; the result does not depend on it.
        resume: whether to continue an interrupted dataset.

    Raises:
        UsageError: a number is out of range, the sampler or camera is unknown, or the camera does
            not vary.
    """

    program: str
    out: Path
    count: int
    sampler: str = 'random'
    seed: int = 0
    varied: bool = False
    camera: str = OURS
    workers: int = 2
    resume: bool = False

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            if not low <= getattr(self, name) <= high:
                value = getattr(self, name)
                raise UsageError(f'dataset: {name} is {value}, outside {low}..{high}')
        if self.sampler not in SAMPLERS:
            known = ', '.join(SAMPLERS)
            raise UsageError(f'dataset: sampler {self.sampler!r} is unknown; known: {known}')
        if find_renderer(self.camera) is not None and self.varied:
            raise UsageError(f'--varied: no effect with --camera {self.camera}; leave one out')

    def request(self) -> dict[str, Any]:
        """Everything that the images depend on, to record and to compare when resuming.

        Raises:
            UsageError: the program is unknown or cannot be read.
        """
        path, renderer = find_program(self.program), find_renderer(self.camera)
        text = program_text(path)
        return {
            'program': path.stem,
            'program_sha256': hashlib.sha256(text.encode()).hexdigest(),
            'program_text': text,
            'sampler': self.sampler,
            'seed': self.seed,
            'count': self.count,
            'varied': self.varied,
            **({} if renderer is None else {
                'camera': self.camera, 'camera_sha256': renderer.fingerprint,
            }),
            'package_version': __version__,
        }


def write_dataset(options: DatasetOptions, progress: Progress = no_progress) -> int:
    """Create a dataset, or the missing part of it.

    Args:
        options: options of the dataset.
        progress: called in the stages ``scenes``, ``checked`` (images of an earlier attempt) and
            ``images``.

    Returns:
        Number of images rendered.

    Raises:
        UsageError: options, program or folder cannot be used.
        RecordError: the disk is full, or the folder was moved or deleted meanwhile.
        InfraError: a worker process died, or the simulator failed.
    """
    request = options.request()
    if not options.resume:
        _check_new(options.out)
    else:
        check_request('dataset', options.out, request)
        (options.out / IMAGES).mkdir(exist_ok=True)
        if (options.out / FACTS).exists():
            return 0
    scenes = draw_scenes(
        options.program, seed=options.seed, images=options.count, sampler=options.sampler,
        progress=progress,
    )
    if not options.resume:  # only now: an invalid program leaves no folder behind
        begin_request('dataset', options.out, request)
        (options.out / IMAGES).mkdir()
    with FinishedImages(options.out / FINISHED) as finished:
        rendered = _render(options, scenes, finished, progress)
        _complete(options.out, request, scenes, finished)
    (options.out / FINISHED).unlink()
    return rendered


def _check_new(out: Path) -> None:
    try:
        if out.exists() and (not out.is_dir() or {path.name for path in out.iterdir()} - {_DRAFT}):
            begun = (out / REQUEST).is_file()
            mend = 'use --resume, or choose another' if begun else 'choose another'
            raise UsageError(f'dataset: --out {out}: exists and is not empty; {mend}')
    except OSError as error:
        raise _unwritable_error(out, error) from error


def begin_request(command: str, out: Path, request: Mapping[str, Any]) -> None:
    """Create the folder of a command that can be resumed, and write its request into it.

    Raises:
        UsageError: the folder cannot be made or written to.
        RecordError: the disk is full.
    """
    try:
        make_folder(out)
        _write_once(out / REQUEST, sealed_text(request).encode())
    except OSError as error:
        raise (_record_error if error.errno in FULL_DISK else _unwritable_error)(
            out, error, command
        ) from error


def check_request(command: str, out: Path, request: Mapping[str, Any]) -> None:
    """Check that a folder was begun with the same request.

    Raises:
        UsageError: it was not, by the name of the option; or there is none.
    """
    path = out / REQUEST
    try:
        begun = read_sealed(path).values
    except FileNotFoundError as error:
        raise UsageError(
            f'{command}: --resume: {path}: no such file, so there is nothing to resume; leave '
            '--resume out'
        ) from error
    except OSError as error:
        raise UsageError(
            f'{command}: --resume: {path}: cannot be read; name another --out'
        ) from error
    check_same_files(f'{command}: --resume: {out}', begun, request)
    for name, value in request.items():
        before = begun.get(name)
        if before != value:
            raise UsageError(
                f'{command}: --resume: {out} was begun with {name} {before}, not {value}; repeat '
                'its options, or choose another --out'
            )


def _render(
    options: DatasetOptions, scenes: list[Scenario], finished: FinishedImages, progress: Progress
) -> int:
    _check_finished(options.out, finished, progress)
    missing = [
        (index, scene) for index, scene in enumerate(scenes)
        if index not in finished.rows or not (options.out / image_name(index)).exists()
    ]
    done = len(scenes) - len(missing)
    taken = photographs(
        missing, partial(_store, options.out),
        varied=options.varied, seed=options.seed, workers=options.workers, camera=options.camera,
    )
    with closing(taken) as images:
        for row in images:
            _record(options.out, finished, row)
            done += 1
            progress('images', done, len(scenes))
    return len(missing)


def _check_finished(out: Path, finished: FinishedImages, progress: Progress) -> None:
    """Check that recorded images are unchanged; missing ones may be made again."""
    for done, row in enumerate(finished.rows.values(), 1):
        path = out / image_name(row.index)
        if path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() != row.sha256:
            raise _differs_error(path)
        progress('checked', done, len(finished.rows))


def _store(
    out: Path, index: int, image: NDArray[np.uint8], truth: TrackingError
) -> FinishedImage:
    """Write one image, in the worker that rendered it since compression takes time."""
    _, encoded = cv2.imencode('.png', cv2.cvtColor(image, cv2.COLOR_RGB2BGR), _PNG)
    data = encoded.tobytes()
    try:
        _write_once(out / image_name(index), data)
    except OSError as error:
        raise _record_error(out, error) from None  # an OSError pickles badly
    sha256 = hashlib.sha256(data).hexdigest()
    return FinishedImage(index=index, cte_m=truth.cte_m, he_rad=truth.he_rad, sha256=sha256)


def _record(out: Path, finished: FinishedImages, row: FinishedImage) -> None:
    before = finished.rows.get(row.index)
    if before == row:
        return  # its lost file has been made again
    if before is not None:
        raise _differs_error(out / image_name(row.index))
    try:
        finished.add(row)
    except OSError as error:
        raise _record_error(out, error) from error


def _complete(
    out: Path, request: Mapping[str, Any], scenes: list[Scenario], finished: FinishedImages
) -> None:
    """Write the table, then the file that marks the dataset as complete."""
    finished.check_in_place()
    table = io.BytesIO()
    rows = [_row(scene, finished.rows[index]) for index, scene in enumerate(scenes)]
    pd.DataFrame(rows).to_parquet(table, index=False)
    labels_sha256 = hashlib.sha256(table.getvalue()).hexdigest()
    try:
        _write_once(out / LABELS, table.getvalue())
        os.sync()  # once for all images: the next file must not survive a power loss without them
        facts = sealed_text({**request, 'labels_sha256': labels_sha256}, {LABELS: labels_sha256})
        _write_once(out / FACTS, facts.encode())
    except OSError as error:
        raise _record_error(out, error) from error


def _row(scene: Scenario, image: FinishedImage) -> dict[str, Any]:
    return {
        'image': image_name(image.index),
        'cte_m': image.cte_m,
        'heading_error_deg': math.degrees(image.he_rad),
        **scene.to_human(),
        'sha256': image.sha256,
    }


def _write_once(path: Path, data: bytes) -> None:
    """Write a file atomically; an existing one must be identical."""
    if path.exists():
        if path.read_bytes() != data:
            raise _differs_error(path)
        return
    write_atomically(path, data, sync=False)  # synchronised once at the end


def _differs_error(path: Path) -> UsageError:
    return UsageError(
        f'dataset: {path}: differs from what these options make and is not replaced; move it away '
        'and use --resume'
    )


def _unwritable_error(out: Path, error: OSError, command: str = 'dataset') -> UsageError:
    return UsageError(f'{command}: {out}: cannot be written ({error.strerror}); name another --out')


def _record_error(out: Path, error: OSError, command: str = 'dataset') -> RecordError:
    return RecordError(
        f'{command}: {out}: cannot be written ({error.strerror}); fix that and use --resume'
    )
