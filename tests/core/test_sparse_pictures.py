"""Runs with few pictures: what is taken, what is held, and what comes of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sparse_pictures import HeldError, SparseWorld
from taxinet_ros.core.types import NO_ESTIMATE, TrackingError
from taxinet_ros.core.world import SimulatedWorld

SCENE = Scenario(cross_track_m=2.0, heading_rad=0.1, duration_s=3.0)


class Biased(Perception):
    """Sees the picture, knows the truth, and errs as told for each picture."""

    word, fingerprint, needs_image = 'biased', '', True

    def __init__(self, *errors: float | None) -> None:
        self.errors, self.pictures = errors, 0

    def begin(self) -> None:
        self.pictures = 0

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        assert image is not None
        assert truth is not None
        error = self.errors[min(self.pictures, len(self.errors) - 1)]
        self.pictures += 1
        if error is None:
            return NO_ESTIMATE
        return TrackingError(cte_m=truth.cte_m + error, he_rad=truth.he_rad - error / 10)


def drive(perception: Perception, every: int = 0, scene: Scenario = SCENE) -> list[Step]:
    """The steps of a run; ``every`` 0: an ordinary one."""
    steps: list[Step] = []
    run_closed_loop(
        scene, HeldError(perception) if every else perception, specs=[SHIPPED['phi_always']],
        on_step=steps.append, **{'make_world': lambda scenario, *, pictures=True: SparseWorld(
            SimulatedWorld, scenario, every
        )} if every else {},
    )
    return steps


def test_given_a_picture_every_second_then_so_many_are_taken_and_errors_are_held_between():
    perception = Biased(0.5, -0.25, None, 1.0)
    steps = drive(perception, every=10)
    assert len(steps) == 31
    assert perception.pictures == 4
    taken = [step.observation.seq for step in steps if step.observation.image is not None]
    assert taken == [0, 10, 20, 30]
    off = [
        step.estimate.cte_m - step.observation.truth.cte_m if step.estimate.usable else math.nan
        for step in steps
    ]
    wanted = [0.5] * 10 + [-0.25] * 10 + [math.nan] * 10 + [1.0]
    np.testing.assert_allclose(off, wanted, atol=1e-12)
    turned = [step.estimate.he_rad - step.observation.truth.he_rad for step in steps[:20]]
    np.testing.assert_allclose(turned, [-0.05] * 10 + [0.025] * 10, atol=1e-12)


@pytest.mark.parametrize('every', [1, 7])
def test_given_an_error_that_does_not_change_then_the_path_is_that_of_all_pictures(every: int):
    whole, sparse = drive(Biased(0.4)), drive(Biased(0.4), every)
    for name in ('x_m', 'y_m', 'yaw_rad'):
        np.testing.assert_allclose(
            [getattr(step.observation.state, name) for step in sparse],
            [getattr(step.observation.state, name) for step in whole], atol=1e-9,
        )
    assert abs(whole[-1].observation.state.y_m) < 1.0, 'it has not moved, so this would tell little'
