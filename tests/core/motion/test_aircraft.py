from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.motion.aircraft import TAXI_SPEED_MPS, Aircraft, SpeedHold
from taxinet_ros.core.motion.controller import STOP, SteeringGains, steer
from taxinet_ros.core.rig.aircraft_model import SpeedGains
from taxinet_ros.core.rig.catalogue import AIRCRAFT, find_aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState, TaxiCommand
from taxinet_ros.errors import InfraError

GAINS = SteeringGains()
STRAIGHT = TaxiCommand(steering_rad=0.0, speed_mps=TAXI_SPEED_MPS)
CORNERS = tuple(itertools.product((-8, -4, 0, 4, 8), (-30, -15, 0, 15, 30)))
KINDS = AIRCRAFT.shipped
ROOT = Path(__file__).parents[3]


def start(
    cte_m: float = 0.0, he_deg: float = 0.0, x_m: float = 400.0, kind: str = 'caravan'
) -> Scenario:
    return Scenario(
        cross_track_m=cte_m, heading_rad=math.radians(he_deg), distance_m=x_m, aircraft=kind
    )


def taxi(aircraft: Aircraft, steps: int = 300) -> list[AircraftState]:
    """The states of a run under the steering law on the true state, the start included."""
    states = [aircraft.state]
    states += [aircraft.advance(steer(aircraft.state.tracking_error, GAINS)) for _ in range(steps)]
    return states


def settling_step(states: list[AircraftState]) -> int:
    """First step from which on the aircraft is within 1.5 m of the centreline."""
    outside = [step for step, state in enumerate(states) if abs(state.y_m) > 1.5]
    return outside[-1] + 1 if outside else 0


def digest(states: list[AircraftState]) -> str:
    return hashlib.sha256(repr(states).encode()).hexdigest()


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize(('cte_m', 'he_deg', 'x_m'), [(8, -30, 0), (-5, 20, 2000), (0, 0, 1234)])
def test_given_a_scenario_when_constructed_then_it_rolls_from_there(
    kind: str, cte_m: float, he_deg: float, x_m: float
) -> None:
    state = Aircraft(start(cte_m, he_deg, x_m, kind)).state

    assert (state.x_m, state.y_m) == pytest.approx((x_m, cte_m), abs=1e-6)
    assert state.yaw_rad == pytest.approx(math.radians(he_deg), abs=1e-9)
    assert state.z_m == pytest.approx(find_aircraft(kind).settled.z_m, abs=1e-6)
    assert state.speed_mps == pytest.approx(TAXI_SPEED_MPS, abs=0.01)
    assert state.yaw_rate_radps == pytest.approx(0.0, abs=1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize(('kind', 'x_m', 'off_mps'), [
    ('caravan', 0.0, 0.1), ('caravan', 1000.0, 0.1), ('caravan', 2000.0, 0.1),
    ('c172p', 400.0, 0.3),
])
def test_given_every_corner_when_taxiing_on_the_truth_then_phi_eventually_holds(
    kind: str, x_m: float, off_mps: float
) -> None:
    runs = [taxi(Aircraft(start(cte_m, he_deg, x_m, kind))) for cte_m, he_deg in CORNERS]

    assert len(runs) == 25
    # 1.5 s of margin to the ten seconds, and 0.5 m to the 1.5 m from then on.
    assert max(settling_step(states) for states in runs) <= 85
    assert max(abs(state.y_m) for states in runs for state in states[100:]) < 1.0
    assert max(abs(states[-1].y_m) for states in runs) < 0.01
    speeds = [state.speed_mps for states in runs for state in states]
    assert (min(speeds), max(speeds)) == pytest.approx((5.0, 5.0), abs=off_mps)
    # At least 4 m/s along the runway: they went somewhere.
    assert min(states[-1].x_m for states in runs) > x_m + 120


@pytest.mark.parametrize(('cte_m', 'he_deg'), [(8, 30), (4, -15), (0, 30)])
def test_given_mirrored_starts_when_taxiing_then_the_trajectories_are_mirrored(
    cte_m: float, he_deg: float
) -> None:
    left = taxi(Aircraft(start(cte_m, he_deg)))
    right = taxi(Aircraft(start(-cte_m, -he_deg)))

    # Not exactly zero: the Earth turns.
    assert max(abs(a.y_m + b.y_m) for a, b in zip(left, right, strict=True)) < 0.005
    assert max(abs(a.x_m - b.x_m) for a, b in zip(left, right, strict=True)) < 0.005
    assert max(abs(a.yaw_rad + b.yaw_rad) for a, b in zip(left, right, strict=True)) < 0.001


@pytest.mark.parametrize('kind', KINDS)
def test_given_a_start_when_rolling_straight_then_it_neither_drops_nor_nods_and_is_as_the_table(
    kind: str
) -> None:
    aircraft, settled = Aircraft(start(kind=kind)), find_aircraft(kind).settled
    first = aircraft.state
    states = [aircraft.advance(STRAIGHT) for _ in range(150)]

    for name, most in (
        ('z_m', 0.001), ('pitch_rad', math.radians(0.1)), ('roll_rad', math.radians(0.1)),
    ):
        begin = getattr(first, name)
        assert max(abs(getattr(state, name) - begin) for state in states[:10]) < most, name
        assert getattr(states[-1], name) == pytest.approx(getattr(settled, name), abs=1e-4), name
    assert states[-1].speed_mps == pytest.approx(TAXI_SPEED_MPS, abs=0.01)


@pytest.mark.nightly
def test_given_the_same_scenario_when_run_in_two_processes_then_no_bit_no_word_no_file_differs(
    tmp_path: Path,
) -> None:
    script = (
        'import sys, test_aircraft as t\n'
        'for kind in t.KINDS:\n'
        '    sys.stdout.write(t.digest(t.taxi(t.Aircraft(t.start(5, -20, kind=kind)))))\n'
    )
    path = os.pathsep.join([str(ROOT), str(Path(__file__).parent)])
    environment = {**os.environ, 'PYTHONPATH': path, 'PYTHONDONTWRITEBYTECODE': '1'}
    here = ''.join(digest(taxi(Aircraft(start(5, -20, kind=kind)))) for kind in KINDS)

    children = [
        subprocess.run(
            [sys.executable, '-c', script],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    ]

    # Standard output holds nothing but the digests: JSBSim's banner would show here.
    assert [child.stdout for child in children] == [here, here]
    assert [child.stderr for child in children] == ['', '']
    assert list(tmp_path.iterdir()) == []


def test_given_interleaved_aircraft_when_taxiing_then_each_goes_its_own_way() -> None:
    scenarios = [start(8, -30), start(-3, 10, kind='c172p'), start(8, -30), start(0, 15, 2000)]
    alone = [taxi(Aircraft(scenario), steps=100) for scenario in scenarios]

    fleet = [Aircraft(scenario) for scenario in scenarios]
    together = [[aircraft.state] for aircraft in fleet]
    for _ in range(100):
        for aircraft, states in zip(fleet, together, strict=True):
            states.append(aircraft.advance(steer(aircraft.state.tracking_error, GAINS)))

    assert [digest(states) for states in together] == [digest(states) for states in alone]
    assert len({digest(states) for states in alone}) == 3


@pytest.mark.parametrize('kind', KINDS)
def test_given_the_fail_safe_when_commanded_then_it_stops_and_stays_until_told_to_go(
    kind: str
) -> None:
    aircraft = Aircraft(start(kind=kind))
    stopping = [aircraft.advance(STOP) for _ in range(40)]
    stopped = stopping[-1]
    stays = [aircraft.advance(STOP) for _ in range(60)][-1]
    goes = [aircraft.advance(STRAIGHT) for _ in range(250)][-1]

    assert stopped.x_m - 400.0 < 10.0
    assert stays.speed_mps == pytest.approx(0.0, abs=0.001)
    assert stays.x_m == pytest.approx(stopped.x_m, abs=0.02)
    assert stays.y_m == pytest.approx(stopped.y_m, abs=0.02)
    assert goes.speed_mps == pytest.approx(TAXI_SPEED_MPS, abs=0.1)
    if kind == 'caravan':
        assert max(state.pitch_rad for state in stopping[:5]) > math.radians(1.0), 'nose down'


@pytest.mark.parametrize('kind', KINDS)
def test_given_steering_to_the_left_when_advanced_then_the_nose_goes_left_and_the_body_right(
    kind: str,
) -> None:
    aircraft = Aircraft(start(kind=kind))
    for _ in range(20):
        state = aircraft.advance(TaxiCommand(steering_rad=0.1, speed_mps=TAXI_SPEED_MPS))

    assert state.yaw_rad > 0.05
    assert state.yaw_rate_radps > 0.05
    assert state.y_m > 0.1
    # The body leans out of the turn: right wing down.
    assert state.roll_rad > find_aircraft(kind).settled.roll_rad + 0.001


def test_given_a_small_steering_angle_when_circling_then_the_radius_is_the_wheelbases() -> None:
    aircraft = Aircraft(start())
    for _ in range(100):
        state = aircraft.advance(TaxiCommand(steering_rad=0.1, speed_mps=TAXI_SPEED_MPS))

    radius_m = state.speed_mps / state.yaw_rate_radps
    assert radius_m == pytest.approx(4.05 / math.tan(0.1), rel=0.1)


def test_given_a_command_beyond_the_stops_when_advanced_then_it_is_clipped() -> None:
    beyond, at_the_stop = Aircraft(start()), Aircraft(start())
    limit = at_the_stop.max_steering_rad

    for _ in range(5):
        wide = beyond.advance(TaxiCommand(steering_rad=9.0, speed_mps=5.0))
        full = at_the_stop.advance(TaxiCommand(steering_rad=limit, speed_mps=5.0))

    assert limit == math.radians(15)
    assert wide == full


@pytest.mark.parametrize(
    ('steering_rad', 'speed_mps'),
    [(math.nan, 5.0), (math.inf, 5.0), (0.0, math.nan), (0.0, math.inf), (0.0, -1.0)],
)
def test_given_an_impossible_command_when_advanced_then_it_is_refused_and_nothing_moves(
    steering_rad: float, speed_mps: float
) -> None:
    aircraft = Aircraft(start())
    before = aircraft.state

    with pytest.raises(ValueError, match='command'):
        aircraft.advance(TaxiCommand(steering_rad=steering_rad, speed_mps=speed_mps))
    assert aircraft.state == before


def test_given_half_the_period_when_advanced_then_half_the_way_is_gone() -> None:
    whole, half = Aircraft(start()), Aircraft(dataclasses.replace(start(), control_rate_hz=20))

    assert whole.advance(STRAIGHT).x_m == pytest.approx(400.5, abs=0.01)
    assert half.advance(STRAIGHT).x_m == pytest.approx(400.25, abs=0.01)


def test_given_a_broken_state_when_advanced_then_it_is_an_infrastructure_error() -> None:
    aircraft = Aircraft(start())
    aircraft.advance(STRAIGHT)
    aircraft._fdm['atmosphere/wind-north-fps'] = math.nan

    with pytest.raises(InfraError, match='finite') as caught:
        aircraft.advance(STRAIGHT)
    assert (caught.value.kind, caught.value.who, caught.value.step) == ('sim', 'simulator', 2)


@pytest.mark.parametrize('text', [None, '<fdm_config', '<fdm_config name="x"></fdm_config>'])
def test_given_a_model_that_does_not_load_when_constructed_then_the_reason_is_told(
    text: str | None,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    broken = dataclasses.replace(find_aircraft('caravan'), folder=tmp_path)
    if text is not None:
        (tmp_path / 'caravan').mkdir()
        (tmp_path / 'caravan' / 'caravan.xml').write_text(text)

    with pytest.raises(InfraError, match=r'JSBSim, loading caravan: \S') as caught:
        Aircraft(start(), model=broken)
    assert (caught.value.kind, caught.value.step) == ('sim', -1)
    assert capfd.readouterr() == ('', '')


SPEED_GAINS = SpeedGains(lever_per_mps=0.5, lever_per_m=0.1, brake_per_lever=2.0, rolling_lever=0.1)


def test_given_a_speed_when_updated_then_lever_and_brakes_answer_its_difference() -> None:
    hold = SpeedHold(SPEED_GAINS)
    assert [hold.update(5.0, 5.0, 0.1) for _ in range(3)] == [(0.1, 0.0)] * 3, 'in balance'

    slow = SpeedHold(SPEED_GAINS)
    levers = [slow.update(5.0, 4.8, 0.1) for _ in range(20)]
    assert levers[0][0] > 0.19
    assert levers[-1][0] > levers[0][0], 'it goes on opening'
    assert {brake for _, brake in levers} == {0.0}

    lever, brake = SpeedHold(SPEED_GAINS).update(5.0, 5.4, 0.1)
    assert lever == 0.0
    assert 0.0 < brake < 1.0


def test_given_a_stop_when_updated_then_the_brakes_are_full_and_the_integral_starts_again() -> None:
    hold = SpeedHold(SPEED_GAINS)
    for _ in range(50):
        hold.update(5.0, 0.0, 0.1)

    assert hold.update(0.0, 4.0, 0.1) == (0.0, 1.0)
    assert hold.update(5.0, 5.0, 0.1) == SpeedHold(SPEED_GAINS).update(5.0, 5.0, 0.1)


@given(speeds=st.lists(st.tuples(st.floats(0, 20), st.floats(-5, 30)), min_size=1, max_size=50))
def test_given_any_speeds_when_updated_then_lever_and_brake_are_in_range_and_exclusive(
    speeds: list[tuple[float, float]],
) -> None:
    hold = SpeedHold(SPEED_GAINS)
    answers = [hold.update(wanted_mps, actual_mps, 0.1) for wanted_mps, actual_mps in speeds]

    assert len(answers) == len(speeds)
    assert all(0 <= lever <= 1 and 0 <= brake <= 1 for lever, brake in answers)
    assert all(lever == 0 or brake == 0 for lever, brake in answers)
