"""Labelled images: camera frames of scenes at the start of a run.

Many are rendered by several processes; how many does not show in the result.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future
from functools import lru_cache, partial
from multiprocessing.synchronize import Event
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.ground.atlas import make_ground_atlas
from taxinet_ros.core.camera.ground.pavement import varied_style
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TrackingError
from taxinet_ros.processes.pool import SPAWN, ProcessPool, process_pool
from taxinet_ros.training.data.augmentation import draw_variation

GROUND_BLOCK = 64
"""Consecutive pictures that share one varied ground, which takes half a second to make."""
_VARIED_EVERY = 4
"""One block in so many is varied: enough for a real picture, little lost for our own."""


def photograph(
    scene: Scenario, *, varied: bool = False, seed: int = 0, index: int = 0
) -> tuple[NDArray[np.uint8], TrackingError]:
    """A frame, (200, 360, 3) uint8 RGB, of the start of a scene, and the true error there.

    Args:
        scene: what to photograph.
        varied: whether to vary the look of the world (domain randomisation): every fourth block
            of :data:`GROUND_BLOCK` pictures has a ground, and each of its pictures a mount, a lens
            and an exposure of its own; the others show the world as it is.
        seed: of what is drawn.
        index: number of the picture in its dataset; with ``seed`` it fixes everything drawn.
    """
    state = Aircraft(scene).state
    _, cte_m, he_rad = scene.line.measure(state.x_m, state.y_m, state.yaw_rad)
    truth = TrackingError(cte_m=cte_m, he_rad=he_rad)
    block = index // GROUND_BLOCK
    if not varied or block % _VARIED_EVERY != 1:
        return Camera(scene).render(state, 0), truth
    variation = draw_variation(np.random.default_rng((seed, index, 1)))
    ground = _varied_ground(seed, block, scene.runway, scene.line, crossing=scene.crossing)
    camera = Camera(scene, ground)
    return variation.develop(camera.render(variation.misplaced(state), 0)), truth


@lru_cache(maxsize=1)
def _varied_ground(
    seed: int, block: int, runway: Runway, track: Track, *, crossing: bool
) -> NDArray[np.uint8]:
    style = varied_style(np.random.default_rng((seed, block, 2)))
    return make_ground_atlas(dataclasses.replace(style, crossing=crossing), runway, track)


_CHUNK = 16
"""Scenes handed to a worker process at a time."""
_AHEAD = 2
"""Chunks per worker that are under way at once; their frames have to fit into the memory."""
T = TypeVar('T')
Numbered = tuple[int, Scenario]
"""A scene and its number in the dataset."""
Develop = Callable[[int, NDArray[np.uint8], TrackingError], T]
"""Makes of number, frame (200, 360, 3) uint8 RGB and true error what is wanted of a photograph.

It is called in the process that took the photograph, so a module must hold it under its name.
"""


def photographs(
    scenes: Iterable[Numbered], develop: Develop[T], *, varied: bool, seed: int, workers: int
) -> Generator[T, None, None]:
    """Photograph scenes and develop what is seen, in the order of the scenes.

    Closing it early ends the worker processes.

    Args:
        scenes: with their numbers, ascending.
        develop: what is kept of each photograph.
        varied: whether the look of the world varies.
        seed: of what is drawn for that.
        workers: processes to do it in; 1 is this one.

    Raises:
        InfraError: a worker process died, or the simulator failed.
    """
    take = partial(_take, develop, varied, seed)
    if workers == 1:
        for scene in scenes:
            yield take(scene)
        return
    # A process that is given a whole block of neighbours makes their common ground only once.
    blocks = _blocks(scenes, GROUND_BLOCK if varied else _CHUNK)
    stop = SPAWN.Event()
    with process_pool(workers, 'rendering worker', _start_worker, stop) as pool:
        try:
            yield from _in_order(pool, partial(_take_all, take), blocks, _AHEAD * workers)
        finally:
            stop.set()  # whoever has had enough should not wait for whole blocks


def _take(develop: Develop[T], varied: bool, seed: int, numbered: Numbered) -> T:
    index, scene = numbered
    image, truth = photograph(scene, varied=varied, seed=seed, index=index)
    return develop(index, image, truth)


def _take_all(take: Callable[[Numbered], T], block: list[Numbered]) -> list[T]:
    return [take(scene) for scene in block if not _asked_to_stop()]


def _blocks(scenes: Iterable[Numbered], size: int) -> Iterator[list[Numbered]]:
    for _, block in itertools.groupby(scenes, key=lambda numbered: numbered[0] // size):
        yield list(block)


def _in_order(
    pool: ProcessPool,
    work: Callable[[list[Numbered]], list[T]],
    blocks: Iterable[list[Numbered]],
    ahead: int,
) -> Iterator[T]:
    under_way: deque[Future[list[T]]] = deque()
    for block in blocks:
        under_way.append(pool.submit(work, block))
        if len(under_way) == ahead:
            yield from under_way.popleft().result()
    while under_way:
        yield from under_way.popleft().result()

_stop: list[Event] = []
"""In a worker process: what its parent sets when it wants no more."""


def _asked_to_stop() -> bool:
    return any(stop.is_set() for stop in _stop)


def _start_worker(stop: Event) -> None:
    _stop.append(stop)
    cv2.setNumThreads(1)
