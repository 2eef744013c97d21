"""Labelled pictures: one per scene of a Scenic program, as the paper's training sets are made.

A picture is kept as the network gets it, 8 KiB instead of 216.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.campaign.scene_source import Rejected, SceneSource
from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera import Camera
from taxinet_ros.core.errors import InfraError, UsageError
from taxinet_ros.core.network import INPUT_SHAPE, shrink
from taxinet_ros.core.scenario import Scenario

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is in all."""

_CHUNK = 16
"""Scenes handed to a worker process at a time."""

_Labelled = tuple[NDArray[np.uint8], float, float]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Dataset:
    """Pictures and what a perfect network would say to them.

    Attributes:
        scenarios: the N scenes.
        pictures: what the network sees at the start of each, (N, 64, 128) uint8.
        cte_m, he_rad: true errors there, (N,) [m] and [rad].
    """

    scenarios: tuple[Scenario, ...]
    pictures: NDArray[np.uint8]
    cte_m: NDArray[np.float64]
    he_rad: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.scenarios)

    def take(self, rows: slice | NDArray[np.bool_]) -> Dataset:
        """Some of the rows, in their order."""
        chosen = np.arange(len(self))[rows]
        return Dataset(
            scenarios=tuple(self.scenarios[row] for row in chosen),
            pictures=self.pictures[chosen],
            cte_m=self.cte_m[chosen],
            he_rad=self.he_rad[chosen],
        )


def silent(stage: str, done: int, total: int) -> None:
    """Progress that no one wants to see."""


def draw_scenes(
    program: str | Path, *, seed: int, images: int, progress: Progress = silent
) -> list[Scenario]:
    """The first scenes of a program, leaving out those that its requirements reject.

    Raises:
        UsageError: the program is wrong, or rejects more scenes than it gives.
    """
    scenes: list[Scenario] = []
    rejected = 0
    with SceneSource(program, seed=seed) as source:
        while len(scenes) < images:
            try:
                scenes.append(source.scene(len(scenes) + rejected))
            except Rejected:
                rejected += 1
                if rejected > images:
                    raise UsageError(
                        f'{program}: its requirements reject most scenes; loosen them'
                    ) from None
            else:
                progress('scenes', len(scenes), images)
    return scenes


def photograph(scene: Scenario) -> _Labelled:
    """What the network sees at the start of a scene, and the true errors there [m], [rad]."""
    state = Aircraft(scene).state
    truth = state.tracking_error
    return shrink(Camera(scene).render(state, 0)), truth.cte_m, truth.he_rad


def make_dataset(
    scenes: Sequence[Scenario], *, workers: int, progress: Progress = silent
) -> Dataset:
    """Photograph scenes. The result does not depend on the number of worker processes.

    Args:
        scenes: what to photograph.
        workers: processes to do it in; 1 is this one.
        progress: told after every picture.

    Raises:
        InfraError: a worker process died, or the simulator failed.
    """
    pictures = np.empty((len(scenes), *INPUT_SHAPE), np.uint8)
    truth = np.empty((len(scenes), 2))
    for row, (picture, cte_m, he_rad) in enumerate(_photographs(scenes, workers)):
        pictures[row] = picture
        truth[row] = cte_m, he_rad
        progress('images', row + 1, len(scenes))
    return Dataset(
        scenarios=tuple(scenes), pictures=pictures, cte_m=truth[:, 0], he_rad=truth[:, 1]
    )


def _photographs(scenes: Iterable[Scenario], workers: int) -> Iterator[_Labelled]:
    if workers == 1:
        yield from map(photograph, scenes)
        return
    context = multiprocessing.get_context('spawn')  # a fork would copy the threads of torch badly
    with ProcessPoolExecutor(workers, context, initializer=_start_worker) as pool:
        try:
            yield from pool.map(photograph, scenes, chunksize=_CHUNK)
        except BrokenProcessPool as error:
            raise InfraError('died', 'training worker', -1, 'see the messages above') from error
        finally:
            pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers
    cv2.setNumThreads(1)
