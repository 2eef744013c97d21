"""Distances to others on the ground: known answers, and what follows from them for requirements."""

import math

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.core.clearance import Clearance
from taxinet_ros.core.mtl.specs import MOST_CLEARANCE_M, SHIPPED, parse_spec
from taxinet_ros.core.rig.catalogue import find_aircraft, load_aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import quaternion
from taxinet_ros.core.verdict.judge import check_others, check_specs

OUTLINE = [part.points for part in find_aircraft('caravan').outline if part.shades]
X_M, Y_M = 400.0, 0.0
LEVEL = quaternion(0.0, 0.0, 0.0)


def near(*objects, y_m=Y_M, heading_deg=0.0, stamp_ns=0, aircraft='caravan'):
    clearance = Clearance(Scenario(aircraft=aircraft, traffic=load_traffic(objects)))
    return clearance.at(stamp_ns, X_M, y_m, quaternion(0.0, 0.0, math.radians(heading_deg)))


def there(kind, ahead_m, left_m, **values):
    return {'kind': kind, 'x_m': X_M + ahead_m, 'y_m': Y_M + left_m, **values}


def test_given_a_van_straight_ahead_then_the_gap_is_from_the_nose_to_its_rear():
    nose_m = max(part[:, 0].max() for part in OUTLINE)
    assert near(there('vehicle', 30, 0)) == pytest.approx(30 - 5.4 / 2 - nose_m)
    assert near(there('vehicle', 30, 0, heading_deg=90)) == pytest.approx(30 - 2.1 / 2 - nose_m)


def test_given_an_aircraft_beside_then_the_gap_is_from_wing_tip_to_wing_tip():
    tip_m = max(part[:, 1].max() for part in OUTLINE)
    assert near(there('aircraft', 0, 25)) == pytest.approx(25 - 15.9 / 2 - tip_m, abs=0.02)


def test_given_a_cone_under_the_wing_then_the_wing_passes_over_it_and_a_tall_thing_is_hit():
    assert near(there('cone', 0, 5)) == pytest.approx(5 - 0.2 - 1.9, abs=0.02), 'to the wheel'
    assert near(there('person', 0, 5)) > 2.5
    assert near(there('vehicle', 0, 5, height_m=3.5)) == 0.0


def test_given_another_aircraft_then_it_is_its_outline_that_counts(tmp_path):
    tip_m = max(part.points[:, 1].max() for part in find_aircraft('c172p').outline)
    beside = there('vehicle', 0, 12, height_m=4)
    found = near(beside, aircraft='c172p')
    assert found == pytest.approx(12 - 2.1 / 2 - tip_m, abs=0.1)
    assert found > near(beside) + 2, 'the wing of the Caravan is longer'

    (tmp_path / 'bare.yaml').write_text('{name: bare, model: c172p, taxi_speed_mps: [2, 8]}')
    bare = Scenario(
        aircraft=load_aircraft(str(tmp_path / 'bare.yaml')), traffic=load_traffic([beside])
    )
    assert math.isnan(Clearance(bare).at(0, X_M, 0.0, LEVEL))
    with pytest.raises(tx.UsageError, match='the outline of aircraft bare is unknown'):
        check_others([SHIPPED['no_collision']], bare)


def test_given_a_tail_wheel_then_heights_are_those_of_the_aircraft_with_its_nose_up(tmp_path):
    (tmp_path / 'cub.yaml').write_text(
        '{name: cub, model: J3Cub, taxi_speed_mps: [2, 8], '
        'settled: {height_m: 1.16, pitch_deg: -12, roll_deg: 0}, outline: ['
        '{part: body, sections: [[2, 0, 0, 0.4, 0.4], [-4.5, 0, 0, 0.1, 0.1]]}]}'
    )
    cub = load_aircraft(str(tmp_path / 'cub.yaml'))
    low = there('vehicle', 1.9, 0, height_m=1.0, length_m=0.2)
    assert near(low, aircraft=cub) > 0.5, 'it passes below the raised nose'
    behind = there('vehicle', -4.3, 0, height_m=0.5, length_m=0.2)
    assert near(behind, aircraft=cub) == 0.0, 'the tail is down'


def test_given_an_upright_plate_without_thickness_then_it_can_be_hit(tmp_path):
    (tmp_path / 'plate.yaml').write_text(
        '{name: plate, model: c172p, taxi_speed_mps: [2, 8], outline: ['
        '{part: hull, points: [[-4, 0, -1], [-4, 0, 2], [3, 0, 2], [3, 0, -1]]}]}'
    )
    plate = load_aircraft(str(tmp_path / 'plate.yaml'))
    assert near(there('vehicle', -1, 5), aircraft=plate) == pytest.approx(5 - 2.1 / 2, abs=2e-3)
    assert near(there('vehicle', -1, 0), aircraft=plate) == 0.0


def test_given_an_object_within_or_around_the_aircraft_then_it_is_hit():
    assert near(there('cone', 0, 0, height_m=0.5)) > 0, 'between the wheels, below the belly'
    assert near(there('person', 0, 0)) == 0.0
    assert near(there('vehicle', 0, 0, length_m=100, width_m=100, height_m=5)) == 0.0


def test_given_world_and_aircraft_turned_together_then_the_gap_is_the_same():
    plain = near(there('aircraft', 12, 14, heading_deg=20))
    turned = []
    for turn_deg in (30, 117, 200, -75):
        cos, sin = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        turned.append(near(
            there('aircraft', 12 * cos - 14 * sin, 12 * sin + 14 * cos, heading_deg=20 + turn_deg),
            heading_deg=turn_deg,
        ))
    assert turned == [pytest.approx(plain, abs=1e-9)] * 4


def test_given_many_random_scenes_then_the_gap_is_that_of_a_brute_search():
    rng = np.random.default_rng(3)
    for _ in range(60):
        ahead, left, turn = rng.uniform(-15, 15), rng.uniform(-15, 15), rng.uniform(-180, 180)
        found = near(there('vehicle', ahead, left, heading_deg=turn, height_m=20))
        assert found == pytest.approx(brute(ahead, left, turn), abs=0.06)


def brute(ahead, left, turn):
    """Least distance between sampled points of the outlines' plans; 0 where one is inside."""
    cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    least = math.inf
    for part in OUTLINE:
        shares = np.random.default_rng(1).dirichlet([0.25] * len(part), 3000)
        dx, dy = (shares @ part[:, :2] - (ahead, left)).T
        along, across = cos * dx + sin * dy, cos * dy - sin * dx
        out = np.hypot(np.maximum(np.abs(along) - 2.7, 0), np.maximum(np.abs(across) - 1.05, 0))
        least = min(least, out.min())
    return least


def test_given_several_then_the_nearest_counts_and_marks_never_do():
    far, close = there('vehicle', 60, 0), there('cone', 20, 1)
    marks = [there(kind, 5, 0) for kind in ('closed_marking', 'patch', 'tyre_marks')]
    assert near(far, close, *marks) == near(close) < near(far)
    assert near(*marks) == MOST_CLEARANCE_M
    assert near(there('cone', 3000, 0)) == MOST_CLEARANCE_M


def test_given_a_position_that_is_no_number_then_there_is_no_distance():
    clearance = Clearance(Scenario(traffic=load_traffic([there('cone', 5, 0)])))
    assert math.isnan(clearance.at(0, math.nan, 0.0, LEVEL))


def test_given_a_run_into_a_van_then_it_goes_on_and_the_requirements_say_what_happened():
    crossing = there('vehicle', 20, -8, heading_deg=90)
    crossing['path'] = [{'x_m': X_M + 20, 'y_m': 8, 'speed_mps': 2.5}]
    scene = Scenario(distance_m=X_M, traffic=load_traffic([crossing]), duration_s=8.0)
    run = tx.run(scene, specs=['no_collision', 'keep_clear', 'hit=always(collision <= 0.5)'])
    assert run.outcome == 'FAIL'
    assert len(run.steps) == 81
    trace = run.trace
    assert trace.attrs['units']['clearance_m'] == 'm'
    assert run.rho['no_collision'].lower == trace['clearance_m'].min() == 0.0
    assert run.rho['keep_clear'].lower == -3.0
    assert run.rho['hit'].lower == -0.5
    assert tx.robustness('no_collision', trace) == 0.0
    assert tx.robustness('always(collision <= 0.5)', trace) == -0.5

    late = dict(crossing, wait_s=6.0)
    passed = tx.run(Scenario(distance_m=X_M, traffic=load_traffic([late]), duration_s=8.0),
                    specs=['no_collision'])
    assert passed.outcome == 'PASS'
    assert passed.rho['no_collision'].lower == passed.trace['clearance_m'].min() > 0


@pytest.mark.parametrize('name', ['no_collision', 'keep_clear', 'hit=always(collision < 0.5)'])
def test_given_nobody_to_be_near_then_a_formula_about_it_is_refused_by_name(name):
    with pytest.raises(tx.UsageError, match=r'reads (clearance|collision), and nobody is'):
        tx.run(Scenario(duration_s=1.0), specs=[name])
    flat = load_traffic([there('patch', 20, 0)])
    with pytest.raises(tx.UsageError, match='nobody is on the ground to be near'):
        tx.run(Scenario(duration_s=1.0, traffic=flat), specs=[name])


def test_given_that_somebody_may_be_there_then_the_formula_is_not_refused_and_its_range_is_known():
    spec = parse_spec('no_collision')
    assert check_specs([spec], Scenario()).warnings == ()
    assert 'clearance between 0 m and 1000 m' in check_specs([spec], Scenario()).reaches[0]
    with pytest.raises(tx.UsageError):
        check_others([spec], Scenario())
    check_others([SHIPPED['phi_always']], Scenario())
    (warning,) = check_specs([parse_spec('always(clearance >= 2000)')], Scenario()).warnings
    assert 'no run can satisfy it' in warning
