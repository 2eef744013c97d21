"""Hold lines: how far they are, who is told of them, and the controller that stops at them."""

import math

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.core.clearance import Clearance
from taxinet_ros.core.faults import check_free
from taxinet_ros.core.motion.controller import SteeringGains, make_controller
from taxinet_ros.core.motion.hold_short import MARGIN_M
from taxinet_ros.core.mtl.specs import MOST_HOLD_DISTANCE_M, SHIPPED, parse_spec
from taxinet_ros.core.rig.catalogue import find_aircraft, load_aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sensors import load_sensors
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import NS_PER_S, TrackingError
from taxinet_ros.core.verdict.judge import check_others, check_specs
from taxinet_ros.errors import UsageError

NOSE_M = max(part.points[:, 0].max() for part in find_aircraft('caravan').outline if part.shades)
TURN = {'track': 'exit_left', 'distance_m': 200.0}
"""On x = 900 m after a turn of 90 degrees to the left, with a radius of 75 m, from (825, 0)."""
EXACT = {'gnss': {'rate_hz': 10}, 'wheel': {'rate_hz': 10}}


def line(x_m, y_m=0.0, heading_deg=0.0, **values):
    return {'kind': 'hold_line', 'x_m': x_m, 'y_m': y_m, 'heading_deg': heading_deg, **values}


def scene(*lines, sensors=None, **values):
    values |= {'sensors': load_sensors(sensors)} if sensors else {}
    return Scenario(traffic=load_traffic(lines), **values)


def way(scenario, x_m, y_m=0.0, *, at_s=0.0):
    return Clearance(scenario).to_hold_line(round(at_s * NS_PER_S), x_m, y_m)


def driven(*lines, sensors=None, controller='hold_short', **values):
    made = scene(*lines, sensors=sensors or EXACT, **{'duration_s': 40.0, **values})
    return tx.run(made, perception='truth', controller=controller, specs='hold_short')


# The signal ----------------------------------------------------------------------------------


def test_given_a_line_ahead_then_the_way_is_from_the_nose_to_its_middle():
    assert 3 < NOSE_M < 6
    one = scene(line(450))
    assert way(one, 400) == pytest.approx(50 - NOSE_M, abs=1e-9)
    assert way(one, 400, 5.0) == way(one, 400)
    assert way(one, 450) == pytest.approx(-NOSE_M, abs=1e-9)
    other = scene(line(450), aircraft='c172p')
    assert way(other, 400) > way(one, 400) + 1, 'the nose of the Cessna is nearer to its middle'


def test_given_a_line_behind_a_bend_then_the_way_is_that_along_the_arc():
    one = scene(line(902, 150, 90), **TURN)
    assert way(one, 800) == pytest.approx(25 + 75 * math.pi / 2 + 75 - NOSE_M)
    side_m = 75 * math.sqrt(0.5)
    assert way(one, 825 + side_m, 75 - side_m) == pytest.approx(75 * math.pi / 4 + 75 - NOSE_M)
    assert way(one, 898, 140) == pytest.approx(10 - NOSE_M)


def test_given_several_lines_then_the_first_that_is_not_cleared_counts_also_behind():
    both = scene(line(450, until_s=12.3), line(430, until_s=5.0), line(500, until_s=30))
    ways = {at_s: way(both, 440, at_s=at_s) + NOSE_M for at_s in (0, 4.9, 5, 12.2, 12.3, 29.9, 30)}
    assert ways == {
        0: pytest.approx(-10), 4.9: pytest.approx(-10), 5: pytest.approx(10),
        12.2: pytest.approx(10), 12.3: pytest.approx(60), 29.9: pytest.approx(60),
        30: MOST_HOLD_DISTANCE_M + NOSE_M,
    }
    assert way(scene(line(430)), 440, at_s=3000) < 0, 'never cleared'


def test_given_none_near_or_no_place_then_the_way_is_the_greatest_or_unknown(tmp_path):
    assert way(Scenario(), 400) == way(Scenario(), math.nan) == MOST_HOLD_DISTANCE_M
    assert way(scene(line(2600)), 400) == MOST_HOLD_DISTANCE_M
    assert way(scene(line(450, until_s=0)), 440) == MOST_HOLD_DISTANCE_M
    assert math.isnan(way(scene(line(450)), math.nan))
    assert math.isnan(way(scene(line(450)), 400, math.inf))
    (tmp_path / 'bare.yaml').write_text('{name: bare, model: c172p, taxi_speed_mps: [2, 8]}')
    bare = scene(line(450), aircraft=load_aircraft(str(tmp_path / 'bare.yaml')))
    assert math.isnan(way(bare, 400))
    with pytest.raises(UsageError, match='the outline of aircraft bare is unknown'):
        check_others([SHIPPED['hold_short']], bare)
    with pytest.raises(UsageError, match='hold_short: the outline of aircraft bare is unknown'):
        make_controller('hold_short', SteeringGains()).begin(
            tx.Scenario(traffic=bare.traffic, aircraft=bare.aircraft, sensors='standard'))


def test_given_a_formula_then_its_range_is_known_and_without_a_line_it_is_refused():
    spec = SHIPPED['hold_short']
    assert check_specs([spec], scene(line(450))).warnings == ()
    (warning,) = check_specs([parse_spec('always(hold_distance >= 2000)')], Scenario()).warnings
    assert 'no run can satisfy it' in warning
    with pytest.raises(UsageError, match='reads hold_distance, and there is no hold_line; place'):
        tx.run(Scenario(duration_s=1.0), specs='hold_short')
    with pytest.raises(UsageError, match='reads clearance, and nobody is on the ground'):
        tx.run(scene(line(450), duration_s=1.0), specs='keep_clear')


@pytest.mark.parametrize(('objects', 'values', 'words'), [
    ([{'kind': 'cone', 'x_m': 9, 'y_m': 9, 'until_s': 3}], {}, 'until_s: only a hold_line is clea'),
    ([line(450, until_s=-1)], {}, 'until_s: expected a number, 0 to 3600'),
    ([line(450, wait_s=3)], {}, 'wait_s: hold_line lies on the ground'),
    ([line(450), line(500, 16)], {}, 'hold_line at x_m 500, y_m 16 has no effect: it is 16.0 m be'),
    ([line(900, 140, 90)], {}, r'140.0 m beside the track runway, which is 15.24 m wide to either'),
    ([line(886, 140, 90)], TURN, r'14.0 m beside the track exit_left, .*; place it there, or '),
    ([line(900, 140)], TURN, 'faces 90 deg away from where the track exit_left goes; .* is 90$'),
    ([line(450, 0, 170)], {}, 'faces 170 deg away .* heading_deg there is 0$'),
])
def test_given_a_line_that_cannot_be_then_one_line_says_why(objects, values, words):
    with pytest.raises(UsageError, match=words):
        scene(*objects, **values)


def test_given_a_free_run_then_hold_lines_are_refused():
    with pytest.raises(UsageError, match='no hold_line in a free run'):
        check_free(scene(line(450)))


# Who is told ---------------------------------------------------------------------------------


def test_given_a_function_then_it_is_told_of_lines_until_they_are_cleared_without_sensors_too():
    told = []

    def steer(estimate, sensors):
        told.append(sensors)
        return 0.0, 5.0

    lines = line(460, until_s=0.3), line(450, until_s=0.5), line(900)
    tx.run(scene(*lines, duration_s=0.6), perception='truth', controller=steer, specs='hold_short')
    assert [one.hold_lines_m for one in told] == [
        *[(450.0, 460.0, 900.0)] * 3, *[(450.0, 900.0)] * 2, *[(900.0,)] * 2]
    assert {one.gnss for one in told} == {()}
    told.clear()
    tx.run(Scenario(sensors='standard', duration_s=0.2), perception='truth', controller=steer)
    assert {one.hold_lines_m for one in told} == {()}


def test_given_a_run_when_saved_then_the_bag_alone_gives_the_same_ways_and_verdict(tmp_path):
    run = driven(line(430, until_s=3.0), line(445, -2, 3.0, until_s=4), duration_s=6.0)
    recording = tx.open_recording(run.save_bag(tmp_path / 'run'))
    assert recording.scenario == run.scenario
    assert list(recording.trace.columns) == list(run.trace.columns)
    ways = run.trace['hold_distance_m'].to_numpy()
    assert ways.tobytes() == recording.trace['hold_distance_m'].to_numpy().tobytes()
    assert run.trace.attrs['units']['hold_distance_m'] == 'm'
    assert ways[-1] == MOST_HOLD_DISTANCE_M > ways.max(initial=0, where=ways < 1000) > 20
    assert recording.judge('hold_short').interval == run.rho['hold_short']
    assert tx.robustness('hold_short', recording.trace) == run.rho['hold_short'].lower == ways.min()
    again = [row['hold_distance'] for row in recording.samples.samples]
    assert again == ways.tolist() == [step.hold_distance_m for step in run.steps]


# The controller ------------------------------------------------------------------------------


@pytest.mark.parametrize('values', [
    {}, {'control_rate_hz': 20.0}, *(
        pytest.param(values, marks=pytest.mark.nightly) for values in (
            {'runway_state': 'wet'}, {'aircraft': 'c172p'},
            {'speed_mps': 8.0, 'distance_m': 380.0},
        )
    ),
], ids=str)
def test_given_a_line_then_it_stops_at_the_margin_stands_and_goes_on_when_cleared(values):
    run = driven(line(470, until_s=30.0), **values)
    trace = run.trace.set_index('t_s')
    assert run.outcome == 'PASS'
    assert run.rho['hold_short'].lower == pytest.approx(MARGIN_M, abs=0.5)
    assert abs(trace.speed_mps.loc[25:29.9]).max() < 0.02
    assert trace.distance_m.loc[20:29.9].std() < 0.02
    assert trace.speed_mps.loc[40] == pytest.approx(run.scenario.speed_mps, rel=0.1)
    assert trace.speed_mps.loc[:5].min() > 0.98 * run.scenario.speed_mps, 'no sooner than it has to'


def test_given_two_lines_on_a_bend_then_it_stops_at_each_and_the_delay_of_fixes_is_undone():
    late = {'gnss': {'rate_hz': 2, 'delay_s': 1.0}, 'wheel': {'rate_hz': 5, 'delay_s': 0.2}}
    lines = line(900, 90, 90, until_s=30), line(900, 130, 90, until_s=55)
    run = driven(*lines, sensors=late, duration_s=60.0, track='exit_left', distance_m=260.0)
    ways = run.trace.set_index('t_s').hold_distance_m
    assert [ways.loc[29.9], ways.loc[54.9]] == [pytest.approx(MARGIN_M, abs=1.0)] * 2


def test_given_a_bias_along_the_taxiway_then_it_overruns_by_as_much_and_fails():
    values = {'track': 'exit_left', 'distance_m': 300.0}
    good, bad = (driven(line(900, 120, 90), gnss_bias_m=bias, **values) for bias in (0.0, -6.0))
    assert (good.outcome, bad.outcome) == ('PASS', 'FAIL')
    away = good.rho['hold_short'].lower - bad.rho['hold_short'].lower
    assert away == pytest.approx(6, abs=0.1)
    assert bad.trace.speed_mps.iloc[-1] == pytest.approx(0, abs=0.02), 'beyond it, it stands too'


def test_given_a_drop_out_then_the_wheels_carry_it_on_and_else_its_commands():
    wheel = {'rate_hz': 10}
    silent = {**wheel, 'dropouts': [{'start_s': 2, 'length_s': 60}]}
    ways = [
        driven(line(470), sensors={'gnss': silent, **more}).rho['hold_short'].lower
        for more in ({'wheel': wheel}, {'wheel': {**wheel, 'bias_percent': -20}}, {})
    ]
    assert ways[0] == pytest.approx(MARGIN_M, abs=0.5)
    assert ways[1] < -5, 'wheels that tell of too short a way'
    assert ways[2] == pytest.approx(MARGIN_M, abs=3.0)


def test_given_no_fix_yet_then_it_stands_and_with_noise_it_does_not_creep():
    mute = {'gnss': {'rate_hz': 10, 'dropouts': [{'start_s': 0, 'length_s': 10}]}}
    trace = driven(line(470), sensors=mute, duration_s=12.0).trace.set_index('t_s')
    assert (trace.speed_cmd_mps.loc[:9.9] == 0).all()
    assert trace.speed_cmd_mps.loc[11] == 5.0
    noisy = {'gnss': {'rate_hz': 10, 'noise_m': 2.0, 'correlation_s': 3}}
    standing = driven(line(450), sensors=noisy, duration_s=80.0).trace.set_index('t_s')
    assert standing.distance_m.loc[30:].std() < 0.05


def test_given_no_gnss_then_it_is_refused_by_name_and_without_lines_it_is_the_law():
    with pytest.raises(UsageError, match=r'hold_short: finds a hold_line by a gnss .*; set the '):
        driven(line(450), sensors={'wheel': {'rate_hz': 10}}, duration_s=1.0)
    plain = Scenario(cross_track_m=4.0, speed_mps=6.0, duration_s=3.0)
    ours, law = (
        tx.run(plain, perception='truth', controller=word) for word in ('hold_short', 'steering'))
    assert ours.trace.equals(law.trace)


def test_given_one_controller_for_two_runs_then_the_second_is_as_the_first():
    controller = make_controller('hold_short', SteeringGains())
    runs = [driven(line(430, until_s=12), controller=controller, duration_s=20.0) for _ in range(2)]
    assert runs[0].trace.equals(runs[1].trace)
    controller.begin()
    assert controller.command(TrackingError(cte_m=0.0, he_rad=0.0)).speed_mps == 5.0


def test_given_a_fork_then_the_lines_stay_and_the_controller_knows_where_it_is():
    run = driven(line(470, until_s=30), duration_s=30.0)
    forked = run.fork(5.0, settings={'runway_state': 'icy'})
    assert np.array_equal(forked.trace.hold_distance_m[:51], run.trace.hold_distance_m[:51])
    assert forked.rho['hold_short'].lower < 0 < run.rho['hold_short'].lower, 'it slides'
