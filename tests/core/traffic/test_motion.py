"""Others on the ground that react to the aircraft: where they stand, go on, begin and follow."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

import taxinet_ros as tx
from taxinet_ros.core.traffic.motion import TrafficMotion
from taxinet_ros.core.traffic.traffic_file import find_traffic, load_traffic

PERIOD_NS = 100_000_000
CAR = {'kind': 'vehicle', 'x_m': 0, 'y_m': 0, 'path': [{'x_m': 90, 'y_m': 0, 'speed_mps': 10}]}
FAR = (500.0, 0.0)
DOCS = Path(__file__).parents[3] / 'docs' / 'world.md'


def traffic(**reaction):
    return find_traffic(load_traffic([{'kind': 'cone', 'x_m': 9, 'y_m': 9}, {**CAR, **reaction}]))


def ways_m(places, **reaction):
    """How far the car has come at each step, the aircraft at these places."""
    others = traffic(**reaction)
    motion = TrafficMotion(others, PERIOD_NS)
    found = []
    for step, place in enumerate(places):
        stamp_ns = step * PERIOD_NS
        held = motion.step(stamp_ns, *place)
        found.append(round(others.pose(1, stamp_ns, held).x_m, 9))
    return found


def test_given_a_distance_to_stand_then_it_stands_from_that_step_on_and_goes_on_where_it_is():
    near, away = (10.0, 0.0), (6.0, -30.0)
    # A metre a step: at 5 m the aircraft is 5 m away, which is not nearer than 5 m.
    assert ways_m([near] * 10 + [away] * 3, stands_within_m=5) == [
        0, 1, 2, 3, 4, 5, 6, 6, 6, 6, 6, 7, 8
    ]


def test_given_a_distance_to_start_then_wait_and_path_begin_once_and_go_on_without_the_aircraft():
    places = [FAR] * 3 + [(0.0, 19.0)] + [FAR] * 6
    assert ways_m(places, starts_within_m=20, wait_s=0.2) == [0, 0, 0, 0, 0, 0, 1, 2, 3, 4]
    assert ways_m([FAR] * 10, starts_within_m=20) == [0] * 10
    assert ways_m([(0.0, 20.0)] * 4, starts_within_m=20) == [0] * 4, 'not nearer'


def test_given_both_then_it_starts_when_the_aircraft_has_come_and_gone():
    places = [FAR, (0.0, 30.0), (0.0, 15.0), (0.0, 15.0), (0.0, -30.0), (0.0, -50.0), FAR, FAR]
    assert ways_m(places, starts_within_m=20, stands_within_m=40) == [0, 0, 0, 0, 0, 0, 1, 2]


def test_given_a_wait_on_the_way_then_it_stands_still_too_while_the_aircraft_is_near():
    path = [{'x_m': 2, 'y_m': 0, 'speed_mps': 10, 'wait_s': 0.2}, *CAR['path']]
    near = (2.0, 3.0)
    assert ways_m([FAR] * 7, path=path, stands_within_m=5) == [0, 1, 2, 2, 2, 3, 4]
    places = [FAR] * 3 + [near] * 4 + [FAR] * 3
    assert ways_m(places, path=path, stands_within_m=5) == [0, 1, 2, 2, 2, 2, 2, 2, 2, 3]


def test_given_a_faster_car_behind_then_it_follows_the_aircraft_at_the_distance():
    ahead = [(30.0 + 0.5 * step, 0.0) for step in range(60)]
    gaps = [x - way for (x, _), way in zip(ahead, ways_m(ahead, stands_within_m=20), strict=True)]
    assert gaps[0] == 30
    assert all(19 <= gap <= 20.5 for gap in gaps[30:])
    assert max(gaps[30:]) > 20 > min(gaps[30:]), 'it goes on and stands by turns'


def test_given_any_way_of_the_aircraft_then_no_pose_jumps_and_held_time_only_grows():
    rng = np.random.default_rng(5)
    some = 0
    for _ in range(40):
        path = [
            {'x_m': float(x), 'y_m': float(y), 'speed_mps': 8, 'wait_s': 0.3}
            for x, y in rng.uniform(-20, 20, (4, 2))
        ]
        stands, starts = rng.uniform(1, 25, 2).tolist()
        others = traffic(path=path, stands_within_m=stands, starts_within_m=starts)
        motion, before, held_ns = TrafficMotion(others, PERIOD_NS), (0.0, 0.0), 0
        place = rng.uniform(-30, 30, 2)
        for step in range(80):
            held = motion.step(step * PERIOD_NS, *place.tolist())
            pose = others.pose(1, step * PERIOD_NS, held)
            assert math.dist(before, pose[:2]) <= 0.8 + 1e-9
            assert held[1].ns - held_ns in (0, PERIOD_NS)
            assert 0 not in held, 'the cone does not react'
            before, held_ns = pose[:2], held[1].ns
            place += rng.uniform(-2, 2, 2)
        some += 0 < held_ns < 79 * PERIOD_NS
    assert some > 10


def test_given_a_missed_step_then_nobody_knows_from_there_on_until_a_run_begins():
    motion = TrafficMotion(traffic(stands_within_m=5), PERIOD_NS)
    held = [motion.step(step * PERIOD_NS, *FAR) for step in (0, 1, 3, 4, 0, 1)]
    assert [one is None for one in held] == [False, False, True, True, False, False]
    assert TrafficMotion(traffic(stands_within_m=5), PERIOD_NS).step(PERIOD_NS, *FAR) is None
    assert motion.step(2 * PERIOD_NS, math.nan, 0.0) is None
    assert motion.step(3 * PERIOD_NS, *FAR) is None
    assert TrafficMotion(traffic(), PERIOD_NS).step(7, math.nan, 0.0) == {}, 'nobody reacts'
    with pytest.raises(KeyError):
        traffic(stands_within_m=5).pose(1, PERIOD_NS, {})


def test_given_the_same_step_again_then_the_newest_place_counts():
    motion = TrafficMotion(traffic(stands_within_m=5, starts_within_m=10), PERIOD_NS)
    for step, *places in ((0, (3.0, 0.0), FAR, (7.0, 0.0)), (1, FAR, (2.0, 0.0)), (2, FAR)):
        for place in places:
            held = motion.step(step * PERIOD_NS, *place)
    assert held[1] == (PERIOD_NS, True, False), 'begun at 7 m, held once at 2 m'


def test_given_the_example_of_the_docs_then_it_lets_pass_follows_and_starts_late():
    section = DOCS.read_text(encoding='utf-8').partition('**Reacting to the aircraft.**')[2]
    objects = yaml.safe_load(section.partition('```yaml\n')[2].partition('```')[0])['objects']
    scene = tx.Scenario(distance_m=400.0, duration_s=27.0, traffic=tx.load_traffic(objects))
    run = tx.run(scene, specs='keep_clear')
    assert run.outcome == 'PASS'
    passing, following, late = (
        [scene.others.pose(number, now.stamp_ns, now.held)
         for now in (step.observation for step in run.steps)] for number in range(3)
    )
    aircraft = run.trace['x_m'].to_numpy()
    crossed = next(step for step, pose in enumerate(passing) if pose.y_m > -22)
    assert aircraft[crossed] > 490, 'the aircraft is past'
    gaps = [x - pose.x_m for x, pose in zip(aircraft, following, strict=True)]
    assert all(24 <= gap <= 26 for gap in gaps[40:])
    assert late[130].y_m == 30 > late[150].y_m
    assert late[-1].y_m == -30
