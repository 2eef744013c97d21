"""Labelled images: camera frames of scenes at the start of a run.

They can be rendered by several processes; the result does not depend on their number.
"""

from __future__ import annotations

import contextlib
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

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.ground.atlas import make_ground_atlas
from taxinet_ros.core.camera.ground.pavement import varied_style
from taxinet_ros.core.datarefs import refuse_datarefs
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.place.place import AirportGround
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.renderer import OURS, find_renderer
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TrackingError
from taxinet_ros.processes.pool import SPAWN, ProcessPool, process_pool
from taxinet_ros.training.data.augmentation import draw_variation

GROUND_BLOCK = 64
"""Number of consecutive pictures with the same varied ground, which takes half a second."""
_VARIED_EVERY = 4
"""One block in four is varied: enough for real pictures, with little loss on our own."""


def photograph(
    scene: Scenario, *, varied: bool = False, seed: int = 0, index: int = 0, camera: str = OURS
) -> tuple[NDArray[np.uint8], TrackingError]:
    """Render the start of a scene: a frame, (200, 360, 3) uint8 RGB, and its true error.

    Args:
        scene: the scene.
        varied: whether to vary the look of the world (domain randomisation): every fourth block of
            :data:`GROUND_BLOCK` pictures has its own ground, and each picture in it its own mount,
            lens and exposure; the other blocks are not varied.
        seed: seed of the variation.
        index: number of the picture in its dataset; with ``seed`` it determines all random draws.
        camera: who takes the picture (:mod:`taxinet_ros.core.renderer`); only ours varies.

    Raises:
        UsageError: the camera is unknown, or cannot show the scene.
        InfraError: it failed.
    """
    state = Aircraft(scene).state
    _, cte_m, he_rad = scene.line.measure(state.x_m, state.y_m, state.yaw_rad)
    truth = TrackingError(cte_m=cte_m, he_rad=he_rad)
    renderer = _renderer(camera)
    if renderer is not None:
        with contextlib.closing(renderer.make(scene)) as theirs:
            return theirs.render(state, 0), truth
    refuse_datarefs(scene.datarefs, f'camera {OURS}')
    block = index // GROUND_BLOCK
    if not varied or block % _VARIED_EVERY != 1:
        return Camera(scene).render(state, 0), truth
    variation = draw_variation(np.random.default_rng((seed, index, 1)))
    ground = _varied_ground(
        seed, block, scene.runway, scene.line, scene.airport, crossing=scene.crossing
    )
    ours = Camera(scene, ground)
    return variation.develop(ours.render(variation.misplaced(state), 0)), truth


_renderer = lru_cache(maxsize=1)(find_renderer)


@lru_cache(maxsize=1)
def _varied_ground(
    seed: int, block: int, runway: Runway, track: Track, airport: AirportGround | None, *,
    crossing: bool,
) -> NDArray[np.uint8]:
    style = varied_style(np.random.default_rng((seed, block, 2)))
    return make_ground_atlas(dataclasses.replace(style, crossing=crossing), runway, track, airport)


_CHUNK = 16
"""Scenes handed to a worker process at a time."""
_AHEAD = 2
"""Chunks in progress per worker; their frames must fit into memory."""
T = TypeVar('T')
Numbered = tuple[int, Scenario]
"""A scene and its number in the dataset."""
Develop = Callable[[int, NDArray[np.uint8], TrackingError, Rig], T]
"""Computes the result from number, frame (200, 360, 3) uint8 RGB, true error and rig.

It is called in the rendering process, so it must be importable by name.
"""


def photographs(
    scenes: Iterable[Numbered], develop: Develop[T], *, varied: bool, seed: int, workers: int,
    camera: str = OURS, chunk: int = 0,
) -> Generator[T, None, None]:
    """Render scenes and yield the result of ``develop`` for each, in order.

    Closing it early ends the worker processes.

    Args:
        scenes: scenes with their numbers, ascending.
        develop: computes the result for each frame.
        varied: whether the look of the world varies.
        seed: seed of these variations.
        workers: number of processes; 1 is this one.
        camera: who takes the pictures.
        chunk: most scenes, of one place, that a process gets at a time; 0 for a few.

    Raises:
        UsageError: the camera cannot show a scene.
        InfraError: a worker process died, or the simulator failed.
    """
    take = partial(_take, develop, varied, seed, camera)
    if workers == 1:
        for scene in scenes:
            yield take(scene)
        return
    # A process that receives a whole block makes its common ground only once.
    blocks = _blocks(scenes, max(chunk, GROUND_BLOCK if varied else _CHUNK))
    stop = SPAWN.Event()
    with process_pool(workers, 'rendering worker', _start_worker, stop) as pool:
        try:
            yield from _in_order(pool, partial(_take_all, take), blocks, _AHEAD * workers)
        finally:
            stop.set()  # do not wait for whole blocks after an early close


def _take(
    develop: Develop[T], varied: bool, seed: int, camera: str, numbered: Numbered
) -> T:
    index, scene = numbered
    image, truth = photograph(scene, varied=varied, seed=seed, index=index, camera=camera)
    return develop(index, image, truth, scene.rig)


def _take_all(take: Callable[[Numbered], T], block: list[Numbered]) -> list[T]:
    return [take(scene) for scene in block if not _asked_to_stop()]


def _blocks(scenes: Iterable[Numbered], size: int) -> Iterator[list[Numbered]]:
    """Consecutive scenes of one place, since its ground takes half a second, too."""
    def key(numbered: Numbered) -> tuple[str, int]:
        number, scene = numbered
        return scene.place, number // size

    for _, block in itertools.groupby(scenes, key=key):
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
"""In a worker process: the event by which its parent requests a stop."""


def _asked_to_stop() -> bool:
    return any(stop.is_set() for stop in _stop)


def _start_worker(stop: Event) -> None:
    _stop.append(stop)
    cv2.setNumThreads(1)
