"""What wind, gusts, friction, slope and speed do to the aircraft, where the answer is known."""

from __future__ import annotations

import dataclasses
import math

import pytest

from taxinet_ros.core.motion.aircraft import FRICTION, Aircraft
from taxinet_ros.core.motion.controller import SteeringGains, SteeringLaw
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.rig.aircraft_model import SpeedGains
from taxinet_ros.core.rig.catalogue import AIRCRAFT, find_aircraft
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import FOOT_M, AircraftState, TaxiCommand

AHEAD = math.degrees(default_runway().bearing_rad)
LEFT, RIGHT, BEHIND = AHEAD - 90 + 360, AHEAD + 90, AHEAD + 180
KINDS = AIRCRAFT.shipped
GRAVITY = 9.807
NO_HANDS = SpeedGains(lever_per_mps=0, lever_per_m=0, brake_per_lever=0, rolling_lever=0)


def scene(**pushing: object) -> Scenario:
    return scenario_from_human({'distance': 400, **pushing})


def law_drives(scenario: Scenario, steps: int = 300) -> list[AircraftState]:
    """The states of a run under the steering law on the true state, the start included."""
    aircraft, law = Aircraft(scenario), SteeringLaw(SteeringGains())
    law.begin(scenario)
    return [aircraft.state] + [
        aircraft.advance(law.command(aircraft.state.tracking_error)) for _ in range(steps)
    ]


def rolls(
    scenario: Scenario, steps: int = 50, steering_rad: float = 0.0
) -> tuple[Aircraft, list[AircraftState]]:
    """It rolls on: no lever, no brakes, the nose wheel held."""
    model = dataclasses.replace(scenario.aircraft_model, speed_gains=NO_HANDS)
    aircraft = Aircraft(scenario, model=model)
    command = TaxiCommand(steering_rad=steering_rad, speed_mps=scenario.speed_mps)
    return aircraft, [aircraft.state] + [aircraft.advance(command) for _ in range(steps)]


@pytest.mark.parametrize('kind', KINDS)
def test_given_wind_from_the_side_when_rolling_then_the_nose_turns_into_it(kind):
    calm = rolls(scene(aircraft=kind))[1][-1].yaw_rad
    yaws = {
        side: rolls(scene(aircraft=kind, wind_speed=5, wind_direction=side % 360))[1][-1].yaw_rad
        for side in (LEFT, RIGHT)
    }
    assert yaws[LEFT] - calm > math.radians(1) > math.radians(-1) > yaws[RIGHT] - calm
    assert yaws[LEFT] - calm == pytest.approx(calm - yaws[RIGHT], rel=0.05)


def test_given_wind_from_either_side_when_steered_then_the_paths_are_mirrored():
    left, right = (
        law_drives(scene(wind_speed=8, wind_direction=side % 360), 100) for side in (LEFT, RIGHT)
    )
    for one, other in zip(left, right, strict=True):
        assert one.y_m == pytest.approx(-other.y_m, abs=2e-3)
        assert one.x_m == pytest.approx(other.x_m, abs=2e-3)
    assert left[-1].y_m > 0.01, 'the law leans on an error, for it has no memory'


@pytest.mark.parametrize('kind', KINDS)
def test_given_wind_along_the_runway_when_rolling_then_it_slows_or_drives(kind):
    speeds = {
        name: rolls(scene(aircraft=kind, **wind), 100)[1][-1].speed_mps
        for name, wind in {
            'ahead': {'wind_speed': 5, 'wind_direction': AHEAD}, 'calm': {},
            'behind': {'wind_speed': 5, 'wind_direction': BEHIND},
        }.items()
    }
    assert speeds['ahead'] < speeds['calm'] - 0.05
    assert speeds['calm'] < speeds['behind']


def test_given_wind_of_any_direction_when_rolling_then_its_force_is_that_of_the_air_on_the_body():
    """0.05 cos(beta) along the fuselage and 0.7 sin(beta) across, times dynamic pressure, area."""
    for degrees in range(0, 360, 45):
        aircraft, _ = rolls(scene(wind_speed=12, wind_direction=degrees), 1)
        fdm = aircraft._fdm
        pressure_area = fdm['aero/qbar-psf'] * fdm['metrics/Sw-sqft']
        u, v, w = (fdm[f'velocities/{axis}-aero-fps'] for axis in 'uvw')
        fast = math.sqrt(u * u + v * v + w * w)
        assert fdm['forces/fbx-aero-lbs'] == pytest.approx(
            -0.05 * u / fast * pressure_area, abs=0.02 * pressure_area * abs(w) / fast + 1e-6
        )
        assert fdm['forces/fby-aero-lbs'] == pytest.approx(-0.7 * v / fast * pressure_area)


def test_given_a_wind_then_jsbsim_has_it_from_that_direction_and_of_that_speed():
    fdm = Aircraft(scene(wind_speed=10, wind_direction=270))._fdm
    assert fdm['atmosphere/wind-north-fps'] == pytest.approx(0, abs=1e-9)
    assert fdm['atmosphere/wind-east-fps'] * FOOT_M == pytest.approx(10), 'it goes east'


@pytest.mark.parametrize(('state', 'share'), FRICTION.items())
def test_given_a_full_stop_when_the_runway_is_slippery_then_it_slows_less(state, share):
    """What the tyres hold of the load on the main wheels; braking shifts load to the nose wheel."""
    scenario = scene(runway_state=state, speed=8)
    aircraft = Aircraft(scenario)
    stop = TaxiCommand(steering_rad=0.0, speed_mps=0.0)
    before = [aircraft.advance(stop).speed_mps for _ in range(5)]
    slowed_mps2 = (before[0] - before[-1]) / 0.4
    braked, rolling = 0.02 + share * (0.8 - 0.02), 0.02
    height_by_wheelbase = 1.55 / 4.05
    slowed_g = (0.89 * braked + 0.11 * rolling) / (1 + height_by_wheelbase * (braked - rolling))
    assert slowed_mps2 == pytest.approx(GRAVITY * slowed_g, rel=0.1)


def test_given_a_slippery_runway_when_turning_then_it_holds_less_and_corrects_later():
    turns = {
        state: max(
            abs(one.speed_mps * one.yaw_rate_radps)
            for one in rolls(scene(runway_state=state, speed=8), 60, math.radians(12))[1]
        )
        for state in FRICTION
    }
    assert turns['dry'] >= turns['wet'] > 3 * turns['icy']
    assert turns['icy'] < GRAVITY * 0.05 * 1.5, 'the tyres hold 0.05 of the weight'
    late = {
        state: next(
            step for step, one in enumerate(law_drives(
                scene(cross_track=8, heading=20, runway_state=state)
            )) if abs(one.y_m) < 1.5
        ) for state in FRICTION
    }
    assert max(late['dry'], late['wet']) < late['icy']


def test_given_auto_then_the_runway_is_wet_where_it_rains():
    rain = {'clouds': 'overcast', 'rain': 20}
    for weather, state in (({}, 'dry'), (rain, 'wet')):
        auto, named = (
            law_drives(scene(cross_track=3, runway_state=word, **weather), 20)
            for word in ('auto', state)
        )
        assert auto == named
    assert law_drives(scene(cross_track=8, heading=30, **rain), 20) == law_drives(
        scene(cross_track=8, heading=30), 20
    ), 'dry, if nobody says otherwise: as ever'


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('percent', [-3.0, 2.0])
def test_given_a_slope_when_rolling_then_it_is_gravitys_part_that_slows(kind, percent):
    level, sloping = (
        rolls(scene(aircraft=kind, slope=slope), 20)[1] for slope in (0.0, percent)
    )
    gained = (sloping[-1].speed_mps - level[-1].speed_mps) / 2.0
    expected = -GRAVITY * math.sin(math.atan(percent / 100))
    assert gained == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize('kind', KINDS)
def test_given_a_slope_when_held_then_the_lever_makes_up_for_it(kind):
    levers = {}
    for slope in (-2.0, 0.0, 2.0):
        scenario = scene(slope=slope, aircraft=kind)
        aircraft, law = Aircraft(scenario), SteeringLaw(SteeringGains())
        law.begin(scenario)
        for _ in range(300):
            aircraft.advance(law.command(aircraft.state.tracking_error))
        fdm = aircraft._fdm
        levers[slope] = fdm['fcs/throttle-cmd-norm'] - fdm['fcs/left-brake-cmd-norm']
        assert aircraft.state.speed_mps == pytest.approx(5.0, abs=0.25)
    assert levers[-2.0] < levers[0.0] < levers[2.0]


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('speed_mps', [2.0, 8.0])
def test_given_a_speed_then_the_run_starts_with_it_and_the_law_holds_it(kind, speed_mps):
    states = law_drives(scene(speed=speed_mps, aircraft=kind, cross_track=2))
    assert states[0].speed_mps == pytest.approx(speed_mps, abs=0.02)
    assert states[-1].speed_mps == pytest.approx(speed_mps, abs=0.15)
    assert abs(states[-1].y_m) < 0.5


def test_given_a_gain_for_the_speed_then_it_says_what_is_held():
    law = SteeringLaw(SteeringGains(speed_mps=3.0))
    scenario = scene(speed=8)
    law.begin(scenario)
    assert law.command(Aircraft(scenario).state.tracking_error).speed_mps == 3.0
    law = SteeringLaw(SteeringGains())
    law.begin(scenario)
    assert law.command(Aircraft(scenario).state.tracking_error).speed_mps == 8.0
    law.begin(scene())
    assert law.command(Aircraft(scenario).state.tracking_error).speed_mps == 5.0


def test_given_gusts_then_the_air_moves_as_strongly_as_they_say():
    """Root mean square over many seeds; the scatter of the mean is that of the seeds."""
    squares = []
    for seed in range(60):
        aircraft, _ = rolls(scene(gust=3, gust_seed=seed), 2)
        fdm = aircraft._fdm
        squares.append(sum(
            (fdm[f'atmosphere/gust-{axis}-fps'] * FOOT_M) ** 2 for axis in ('north', 'east')
        ) / 2)
    mean = sum(squares) / len(squares)
    error = math.sqrt(sum((one - mean) ** 2 for one in squares) / (len(squares) - 1) / len(squares))
    assert abs(mean - 9.0) < 4 * error


def test_given_gusts_then_a_seed_says_which_and_the_same_scene_has_the_same_bits():
    def way(seed: int) -> list[AircraftState]:
        return law_drives(scene(gust=4, gust_seed=seed, wind_speed=6, wind_direction=10), 30)

    assert way(1) == way(1) != way(2)


def test_given_interleaved_aircraft_in_gusts_then_each_has_its_own():
    scenario = scene(gust=4, gust_seed=1)
    alone = rolls(scenario, 20)[1]
    command = TaxiCommand(steering_rad=0.0, speed_mps=5.0)
    model = dataclasses.replace(find_aircraft('caravan'), speed_gains=NO_HANDS)
    one, other = Aircraft(scenario, model=model), Aircraft(scene(gust=4, gust_seed=9))
    states = [one.state]
    for _ in range(20):
        other.advance(command)
        states.append(one.advance(command))
    assert states == alone
