"""Datasets on disk: a folder of images of a Scenic program's scenes, with a table of labels.

It contains ``images/000000.png`` and so on, ``labels.parquet`` with a row for each, and
``dataset.json``, which is written last: a folder without it is unfinished. It also has the cameras
and aircraft that the table names by their digests. While the folder is being made, ``progress.db``
has the options and the finished images.

An image is a pure function of program, seed and number, so an interrupted dataset is continued by
rendering the missing images, with a byte-identical result. Files are written atomically and never
replaced.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import math
import os
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from taxinet_ros.core.renderer import OURS, find_renderer
from taxinet_ros.core.rig.catalogue import find_aircraft, find_camera
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import AIRCRAFT_MODEL, CAMERA
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.sealed_json import read_sealed, sealed_text
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.source import program_text
from taxinet_ros.training.data.dataset import SAMPLERS, Progress, draw_scenes, no_progress
from taxinet_ros.training.data.photographs import photographs
from taxinet_ros.training.data.unfinished import NAME, Unfinished, check_request, is_begun
from taxinet_ros.version import __version__

IMAGES = 'images'
LABELS = 'labels.parquet'
FACTS = 'dataset.json'
DOCUMENTS = 'documents'
"""Entry there of pairs: a scenario key, and the document that a value in the table refers to."""


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


_LIMITS = {'count': (1, 1_000_000), 'seed': (0, 2**63 - 1), 'workers': (1, 256)}


_EMPTY = {NAME, f'{NAME}-journal'}
"""What a kill or a full disk may leave of a dataset that was not yet started."""
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
            raise UsageError(f'varied: no effect with camera {self.camera}; leave one out')

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
    elif (options.out / FACTS).exists():
        check_request('dataset', options.out, read_sealed(options.out / FACTS).values, request)
        return 0
    try:
        rendered = _make(options, request, progress)
    except OSError as error:
        raise RecordError(
            f'dataset: {options.out}: cannot be written ({error.strerror}); fix that and '
            'resume it'
        ) from error
    (options.out / NAME).unlink()
    return rendered


def _make(options: DatasetOptions, request: Mapping[str, Any], progress: Progress) -> int:
    with contextlib.ExitStack() as opened:
        def begin() -> Unfinished:
            unfinished = Unfinished('dataset', options.out, request, resume=options.resume)
            return opened.enter_context(unfinished)

        unfinished = begin() if options.resume else None
        scenes = draw_scenes(
            options.program, seed=options.seed, images=options.count, sampler=options.sampler,
            progress=progress,
        )
        # Only now: an invalid program leaves no folder behind.
        unfinished = unfinished or begin()
        (options.out / IMAGES).mkdir(exist_ok=True)
        finished, rendered = _render(options, scenes, unfinished, progress)
        unfinished.check_in_place()
        _complete(options.out, request, scenes, finished)
    return rendered


def _check_new(out: Path) -> None:
    try:
        begun = is_begun(out)
        if out.exists() and (not out.is_dir() or (
            {path.name for path in out.iterdir()} - (set() if begun else _EMPTY)
        )):
            fix = 'resume it, or choose another' if begun else 'choose another'
            raise UsageError(f'dataset: out {out}: exists and is not empty; {fix}')
    except OSError as error:
        raise UsageError(
            f'dataset: {out}: cannot be written ({error.strerror}); name another folder'
        ) from error


def _render(
    options: DatasetOptions, scenes: list[Scenario], unfinished: Unfinished, progress: Progress
) -> tuple[dict[int, FinishedImage], int]:
    """Render the missing images; return all, and how many these were."""
    finished = {
        number: FinishedImage(index=number, **values)
        for number, values in unfinished.made.items()
    }
    _check_finished(options.out, finished, progress)
    missing = [
        (index, scene) for index, scene in enumerate(scenes)
        if index not in finished or not (options.out / image_name(index)).exists()
    ]
    done = len(scenes) - len(missing)
    taken = photographs(
        missing, partial(_store, options.out),
        varied=options.varied, seed=options.seed, workers=options.workers, camera=options.camera,
    )
    with closing(taken) as images:
        for row in images:
            if finished.setdefault(row.index, row) != row:  # equal if its lost file is made again
                raise _differs_error(options.out / image_name(row.index))
            unfinished.add(
                row.index, {'cte_m': row.cte_m, 'he_rad': row.he_rad, 'sha256': row.sha256}
            )
            done += 1
            progress('images', done, len(scenes))
    unfinished.flush()
    return finished, len(missing)


def _check_finished(
    out: Path, finished: Mapping[int, FinishedImage], progress: Progress
) -> None:
    """Check that recorded images are unchanged; missing ones may be made again."""
    for done, row in enumerate(finished.values(), 1):
        path = out / image_name(row.index)
        if path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() != row.sha256:
            raise _differs_error(path)
        progress('checked', done, len(finished))


def _store(
    out: Path, index: int, image: NDArray[np.uint8], truth: TrackingError, rig: Rig
) -> FinishedImage:
    """Write one image, in the worker that rendered it since compression takes time."""
    _, encoded = cv2.imencode('.png', cv2.cvtColor(image, cv2.COLOR_RGB2BGR), _PNG)
    data = encoded.tobytes()
    _write_once(out / image_name(index), data)
    sha256 = hashlib.sha256(data).hexdigest()
    return FinishedImage(index=index, cte_m=truth.cte_m, he_rad=truth.he_rad, sha256=sha256)


def _complete(
    out: Path, request: Mapping[str, Any], scenes: list[Scenario],
    finished: Mapping[int, FinishedImage],
) -> None:
    """Write the table, then the file that marks the dataset as complete."""
    table = io.BytesIO()
    rows = [_row(scene, finished[index]) for index, scene in enumerate(scenes)]
    pd.DataFrame(rows).to_parquet(table, index=False)
    labels_sha256 = hashlib.sha256(table.getvalue()).hexdigest()
    _write_once(out / LABELS, table.getvalue())
    os.sync()  # once for all images: the next file must not survive a power loss without them
    values = {**request, **_own_documents(scenes), 'labels_sha256': labels_sha256}
    _write_once(out / FACTS, sealed_text(values, {LABELS: labels_sha256}).encode())


def _own_documents(scenes: list[Scenario]) -> dict[str, Any]:
    """Cameras and aircraft that are not shipped, whole, with their keys."""
    found = {
        (field.key, one.document) for scene in scenes
        for field, one in ((CAMERA, find_camera(scene.camera)),
                           (AIRCRAFT_MODEL, find_aircraft(scene.aircraft)))
        if not one.shipped
    }
    return {DOCUMENTS: sorted(found)} if found else {}


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
        'and resume it'
    )
