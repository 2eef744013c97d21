"""One labelled picture: a scene as the camera sees it at the start of a run."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera import Camera
from taxinet_ros.core.ground import make_ground_atlas
from taxinet_ros.core.ground_style import varied_style
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TrackingError
from taxinet_ros.training.variation import varied as draw_variation

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
    truth = state.tracking_error
    block = index // GROUND_BLOCK
    if not varied or block % _VARIED_EVERY != 1:
        return Camera(scene).render(state, 0), truth
    variation = draw_variation(np.random.default_rng((seed, index, 1)))
    camera = Camera(scene, _varied_ground(seed, block, crossing=scene.crossing))
    return variation.develop(camera.render(variation.misplaced(state), 0)), truth


@lru_cache(maxsize=1)
def _varied_ground(seed: int, block: int, *, crossing: bool) -> NDArray[np.uint8]:
    style = varied_style(np.random.default_rng((seed, block, 2)))
    return make_ground_atlas(dataclasses.replace(style, crossing=crossing))
