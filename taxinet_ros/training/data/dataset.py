"""Labelled pictures in memory: one per scene of a Scenic program, as in the paper's training sets.

A picture is stored as the network's input, 12 KiB instead of 211.
"""

from __future__ import annotations

import base64
import sys
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.airframe import covering_doubts
from taxinet_ros.core.perception.eye import find_eye
from taxinet_ros.core.perception.network import INPUT_SHAPE, shrink
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.sampler import Exhausted
from taxinet_ros.scenes.source import Rejected, SceneSource, accepted_scene
from taxinet_ros.training.data.photographs import photographs
from taxinet_ros.training.data.unfinished import Unfinished

Progress = Callable[[str, int, int], None]
"""Called with the stage, the amount done and the total."""

_Labelled = tuple[NDArray[np.uint8], float, float]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Dataset:
    """Images and their labels.

    Attributes:
        pictures: network inputs, (N, 64, 192) uint8.
        cte_m, he_rad: true errors, (N,) [m] and [rad].
    """

    pictures: NDArray[np.uint8]
    cte_m: NDArray[np.float64]
    he_rad: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.pictures)

    def take(self, rows: slice | NDArray[np.bool_] | NDArray[np.int64]) -> Dataset:
        """Select rows."""
        return Dataset(
            pictures=self.pictures[rows], cte_m=self.cte_m[rows], he_rad=self.he_rad[rows]
        )

    def joined(self, other: Dataset) -> Dataset:
        """These images, and then those of another one."""
        if not len(other):
            return self
        return Dataset(
            pictures=np.concatenate([self.pictures, other.pictures]),
            cte_m=np.concatenate([self.cte_m, other.cte_m]),
            he_rad=np.concatenate([self.he_rad, other.he_rad]),
        )


def no_progress(stage: str, done: int, total: int) -> None:
    """Progress callback that does nothing."""


_LOOKED_AT = 8
"""Cameras of which it is checked that the aircraft does not cover their pictures."""
SAMPLERS = ('random', 'halton', 'sobol', 'grid')
"""Samplers of scenes that need no results of runs."""


def draw_scenes(
    program: str | Path, *, seed: int, images: int, sampler: str = 'random',
    progress: Progress = no_progress, overrides: Mapping[str, str] = {},
) -> list[Scenario]:
    """The first scenes of a program, leaving out those that are rejected.

    Args:
        program: word of a shipped Scenic program or path of one.
        seed: seed of the scenes.
        images: number of scenes.
        sampler: a word of :data:`SAMPLERS`; ``random`` draws as Scenic does.
        progress: called after every scene.
        overrides: values that replace drawn ones, see :class:`SceneSource`.

    Raises:
        UsageError: the program is invalid, rejects most of its scenes, or has too few.
    """
    scenes: list[Scenario] = []
    rejected = 0
    with SceneSource(program, seed=seed, overrides=overrides) as source:
        for note in source.drawn_notes if sampler == 'random' else source.notes:
            print(note, file=sys.stderr)
        scene = _scene_drawer(source, sampler, seed, images)
        while len(scenes) < images:
            try:
                scenes.append(scene(len(scenes) + rejected))
            except Rejected as error:
                rejected += 1
                if rejected > images:
                    raise UsageError(f'{error}; most scenes are rejected') from None
            except Exhausted as error:
                raise UsageError(f'{program}: {error}, which are fewer than {images}') from error
            else:
                progress('scenes', len(scenes), images)
    cameras = dict.fromkeys((scene.aircraft_model, scene.camera_model) for scene in scenes)
    doubts = (line for one in islice(cameras, _LOOKED_AT) for line in covering_doubts(*one))
    for line in islice(doubts, 1):
        print(f'warning: {line}', file=sys.stderr)
    return scenes


def _scene_drawer(
    source: SceneSource, sampler: str, seed: int, images: int
) -> Callable[[int], Scenario]:
    """Function that returns the scene with a given number, from 0."""
    if sampler == 'random':
        return source.scene
    points = make_sampler(sampler, source.space(), seed, images)

    def scene(index: int) -> Scenario:
        ticket, point = points.next()
        try:
            return accepted_scene(source, index, point, points.again)[0]
        finally:
            points.tell(ticket, None)

    return scene


def make_dataset(
    scenes: Sequence[Scenario],
    *,
    workers: int,
    varied: bool = False,
    seed: int = 0,
    view: str | None = None,
    chunk: int = 0,
    progress: Progress = no_progress,
    stage: str = 'images',
    unfinished: Unfinished | None = None,
) -> Dataset:
    """Render scenes. The result does not depend on the number of worker processes.

    Args:
        scenes: scenes to render; their indices are their numbers.
        workers: number of processes; 1 is this one.
        varied: whether the look of the world varies.
        seed: seed of these variations.
        view: virtual camera through which the pictures are seen, a name of
            :data:`~taxinet_ros.core.perception.eye.VIEWS`; None for the frames as they are.
        chunk: as for :func:`.photographs`.
        progress: called after every picture.
        stage: name of the stage for ``progress``.
        unfinished: record to keep the pictures in; those in it are not rendered again.

    Raises:
        InfraError: a worker process died, or the simulator failed.
        OSError: a picture cannot be recorded.
    """
    known = {} if unfinished is None else unfinished.made
    missing = [(number, scene) for number, scene in enumerate(scenes) if number not in known]
    pictures = np.empty((len(scenes), *INPUT_SHAPE), np.uint8)
    truth = np.empty((len(scenes), 2))
    taken = photographs(
        missing, partial(_shrunk, view), varied=varied, seed=seed, workers=workers,
        chunk=chunk,
    )
    for row in range(len(scenes)):
        if row in known:
            picture, cte_m, he_rad = _unpacked(known[row])
        else:
            picture, cte_m, he_rad = next(taken)
            if unfinished is not None:
                packed = base64.b64encode(zlib.compress(picture.tobytes(), 1)).decode()
                unfinished.add(row, {'picture': packed, 'cte_m': cte_m, 'he_rad': he_rad})
        pictures[row] = picture
        truth[row] = cte_m, he_rad
        progress(stage, row + 1, len(scenes))
    return Dataset(pictures=pictures, cte_m=truth[:, 0], he_rad=truth[:, 1])


def _unpacked(values: Mapping[str, Any]) -> _Labelled:
    data = zlib.decompress(base64.b64decode(values['picture']))
    return np.frombuffer(data, np.uint8).reshape(INPUT_SHAPE), values['cte_m'], values['he_rad']


def _shrunk(
    view: str | None, index: int, image: NDArray[np.uint8], truth: TrackingError, rig: Rig
) -> _Labelled:
    return network_picture(image, view, rig), truth.cte_m, truth.he_rad


def network_picture(
    image: NDArray[np.uint8], view: str | None, rig: Rig | None
) -> NDArray[np.uint8]:
    """What a network gets of a frame (height, width, 3) uint8 RGB: (64, 192) uint8, as in a run.

    Args:
        image: the frame.
        view: as for :func:`make_dataset`.
        rig: camera and aircraft; with a view they have to be known.
    """
    if view is None:
        return shrink(image)
    assert rig is not None
    return find_eye(view, rig).see(image)
