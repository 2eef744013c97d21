"""Worlds, and what is handed into them: aircraft, camera and runway are values."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import pytest

from taxinet_ros.core.camera.camera import Camera, pose
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.rig.catalogue import WING, find_aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.world import SimulatedWorld, find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import KMWH

KMWH_04 = default_runway()
SCENE = Scenario(cross_track_m=3.0, heading_rad=0.2, duration_s=2.0)
FAR_NORTH = dataclasses.replace(
    KMWH_04, threshold_deg=(67.0, 18.0), end_deg=(67.0, 18.1), time_zone='UTC+01:00',
    bearing_rad=math.radians(90.0), elevation_m=0.0,
)


def states(world, steps: int = 5) -> list:
    seen = []
    for _ in range(steps):
        seen.append(world.observe(picture=False).state)
        world.advance(TaxiCommand(steering_rad=0.1, speed_mps=5.0))
    return seen


def test_given_the_word_of_the_simulated_world_when_found_then_it_is_the_one_that_runs_have() -> (
    None
):
    chosen = find_world(KMWH)
    assert (chosen.make, chosen.fingerprint) == (SimulatedWorld, '')
    with pytest.raises(UsageError, match="'mars' is unknown; known: kmwh, xplane; packages add"):
        find_world('mars')


def test_given_a_world_of_ones_own_when_handed_into_the_loop_then_the_run_takes_place_there() -> (
    None
):
    asked = []

    def make(scenario: Scenario, *, pictures: bool = True) -> SimulatedWorld:
        asked.append((scenario, pictures))
        return SimulatedWorld(
            scenario, pictures=pictures,
            aircraft=lambda scene: Aircraft(scene, model=find_aircraft('c172p')),
        )

    runs = {}
    for name, how in {'usual': {}, 'own': {'make_world': make}}.items():
        seen: list = []
        run_closed_loop(
            SCENE, make_perception('truth'), specs=[SHIPPED['phi_always']], on_step=seen.append,
            **how,
        )
        runs[name] = [step.observation.state for step in seen]
    assert asked == [(SCENE, False)]
    light = dataclasses.replace(SCENE, aircraft='c172p')
    assert runs['own'] == driven(light) != runs['usual'] == driven(SCENE)


def driven(scene: Scenario) -> list:
    seen: list = []
    run_closed_loop(
        scene, make_perception('truth'), specs=[SHIPPED['phi_always']], on_step=seen.append
    )
    return [step.observation.state for step in seen]


def test_given_the_usual_values_when_handed_in_then_states_and_bytes_are_as_without() -> None:
    named = SimulatedWorld(
        SCENE,
        aircraft=functools.partial(Aircraft, model=find_aircraft('caravan'), runway=KMWH_04),
        camera=functools.partial(Camera, model=WING, runway=KMWH_04),
    )
    usual = SimulatedWorld(SCENE)
    assert named.observe().image.tobytes() == usual.observe().image.tobytes()
    assert states(named) == states(usual)


def test_given_another_runway_when_taxied_then_the_frame_is_its_own_and_the_motion_alike() -> None:
    here = states(SimulatedWorld(SCENE))
    there = states(SimulatedWorld(SCENE, aircraft=functools.partial(Aircraft, runway=FAR_NORTH)))
    assert here != there
    for one, other in zip(here, there, strict=True):
        assert (one.x_m, one.y_m, one.yaw_rad) == pytest.approx(
            (other.x_m, other.y_m, other.yaw_rad), abs=0.02
        )


def test_given_another_runway_when_photographed_then_its_sun_shines() -> None:
    state = Aircraft(SCENE).state
    here, there = (Camera(SCENE, runway=place).render(state, 0) for place in (KMWH_04, FAR_NORTH))
    assert here.mean() > there.mean(), 'a lower sun'


def test_given_another_mount_when_photographed_then_it_looks_from_there() -> None:
    state = Aircraft(SCENE).state
    nose = dataclasses.replace(WING, offset_m=(2.0, 0.0, 0.5), yaw_rad=0.0)
    (_, _, wing_m), (_, _, nose_m) = pose(state), pose(state, nose)
    assert math.hypot(*(nose_m - wing_m)) == pytest.approx(math.hypot(2.0 - 0.085, 2.17), abs=1e-9)
    assert not np.array_equal(
        Camera(SCENE).render(state, 0), Camera(SCENE, model=nose).render(state, 0)
    )
