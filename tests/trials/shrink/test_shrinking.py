"""Shrinking a failed run on disk: what is asked, kept, refused and resumed; runs by a formula."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from campaign_records import write_campaign
from rich.console import Console

from taxinet_ros.core.mtl import exact_intervals, parse_spec
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import BY_KEY, FAULTS, WIND_SPEED
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.verdict.judge import check_others
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.verdict.run_statistics import RunStatistics
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import scenario_program
from taxinet_ros.scenes.source import sample_scenarios
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.past_runs.recorded_campaign import find_run
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS, RunRow
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.shrink.algorithm import End
from taxinet_ros.trials.shrink.shrinking import (
    Report,
    Shrinking,
    _finding,
    finding_lines,
    make_report,
    make_shrinking,
    parameter_table,
    result_lines,
    run_command,
)
from taxinet_ros.trials.shrink.space import make_shrink_space

NAME = 'phi_eventually'
WET = Scenario(
    cross_track_m=3.0123456789012345, distance_m=420.0, heading_rad=0.2, clouds='stratus',
    rain_fraction=0.8, time_of_day_s=15.5 * 3600, duration_s=1.0,
)

Judge = Callable[[RunRequest], RunResult]


def judged(request: RunRequest, outcome: Outcome | None = None) -> RunResult:
    """What a run gives: a failure in more than 30.5 % of rain on the first 705 m."""
    scenario = request.scenario
    rho = max(0.305 - scenario.rain_fraction, (scenario.distance_m - 705) / 1000)
    outcome = outcome or (Outcome.PASS if rho > 0 else Outcome.FAIL)
    return RunResult(
        outcome=outcome, last_seq=10,
        robustness=exact_intervals({NAME: rho} if outcome.judged else {}),
        kind='' if outcome.judged else 'test', who='' if outcome.judged else 'simulator',
        statistics=RunStatistics(max_cross_track_m=2.0) if outcome.judged else None,
    )


def campaign(folder: Path, scenario: Scenario = WET, **changes: Any) -> Path:
    """A campaign with one run and no bag; the path of the run."""
    request = RunRequest(run_id='p-s7-00000', index=0, program='p', seed=7, scenario=scenario,
                         judging=Judging(specs=(NAME,)), participants=())
    result = judged(request, changes.pop('outcome', None))
    specs = changes.pop('specs', {NAME: 'eventually[0:10](always(abs(cte) <= 1.5))'})
    row = RunRow.of_run(request, result, perception='truth', sim_s=1.0)
    write_campaign(folder, [dataclasses.replace(row, **changes)], {
        'specs': specs,
        'gains': {'heading_gain': 1.5},
    })
    return folder / request.run_id


def options(path: Path, out: Path, **changes: Any) -> Shrinking:
    return make_shrinking(path, **{'runs': 100, 'out': out, **changes})


def drive(chosen: Shrinking, judge: Judge = judged, most: int = 1000) -> Engine[Shrinking]:
    """Run it as so many workers would, the newest run ending first; interrupt it after ``most``."""
    with Engine(chosen, ('perception',)) as shrinking:
        under_way: list[RunRequest] = []
        at_once = chosen.campaign.workers
        while True:
            if most <= 0:
                shrinking.interrupt()
            while len(under_way) < at_once and (request := shrinking.next()) is not None:
                (chosen.campaign.out / request.run_id).mkdir()
                under_way.append(request)
            if not under_way:
                return shrinking
            request, most = under_way.pop(), most - 1
            result = judge(request) if most >= 0 else judged(request, Outcome.INTERRUPTED)
            shrinking.take(request, result)


def shrunk(shrinking: Engine[Shrinking]) -> dict[str, Any]:
    return {one.key: one.shrunk for one in make_report(shrinking.proposer).findings}


NEAREST = {
    'cross_track_m': 0.0, 'heading_deg': 0.0, 'clouds': 'broken', 'rain_percent': 31.0,
    'time_of_day_h': 10.0, 'distance_m': 700.0,
}


def test_given_a_run_that_satisfies_its_headline_then_what_it_violates_is_shrunk(tmp_path):
    path = campaign(
        tmp_path / 'c', robustness=exact_intervals({'low': 2.0, NAME: -1.0}),
        specs={'low': 'always(cte <= 99)', NAME: 'eventually[0:10](always(abs(cte) <= 1.5))'},
    )
    chosen = options(path, tmp_path / 'out')
    assert chosen.headline == NAME
    assert chosen.campaign.judging.names == (NAME, 'low')
    assert chosen.told == (f'the run does not violate low; looked into: {NAME}',)
    named = options(path, tmp_path / 'out', specs=[NAME])
    assert (named.campaign.judging, named.told) == (chosen.campaign.judging, ())
    with pytest.raises(UsageError, match='satisfied low with'):
        options(path, tmp_path / 'out', specs=['low'])


@pytest.mark.parametrize('workers', [
    2, *(pytest.param(count, marks=pytest.mark.nightly) for count in (1, 8)),
])
def test_given_a_failed_run_then_what_matters_is_found_and_every_run_is_on_record(
    tmp_path, workers
):
    out = tmp_path / 'out'
    shrinking = drive(options(campaign(tmp_path / 'c'), out, workers=workers))
    found = make_report(shrinking.proposer)
    assert shrunk(shrinking) == NEAREST
    assert found.state.end is End.MINIMAL
    matters = {one.key: (one.passes_at, one.matters) for one in found.findings}
    assert matters == {
        'cross_track_m': (None, False), 'heading_deg': (None, False),
        'time_of_day_h': (None, False), 'clouds': ('scattered', True),
        'rain_percent': (30.0, True), 'distance_m': (710.0, True),
    }
    assert all(one.rho_passes_at > 0 and one.rho_in_shrunk > 0
               for one in found.findings if one.matters)
    assert all(one.rho_in_original is not None for one in found.findings)
    table = read_table(out)
    assert len(table) == len(shrinking.rows)
    assert set(table['sampler']) == {'shrink'}
    assert table['distance_m'].between(420, 1000).all()
    facts = read_campaign(out).facts
    assert facts['shrinks'] == 'p-s7-00000'
    assert facts['gains'] == {'heading_gain': 1.5}


def test_given_an_interrupt_when_resumed_then_nothing_is_run_twice_and_the_result_is_the_same(
    tmp_path
):
    path, out = campaign(tmp_path / 'c'), tmp_path / 'out'
    whole = drive(options(path, tmp_path / 'whole'))
    begun = drive(options(path, out, workers=2), most=6)
    assert make_report(begun.proposer).state.end is End.NOT_YET
    assert begun.interrupted
    rows = read_campaign(out).rows
    assert sum(row.outcome is Outcome.INTERRUPTED for row in rows) == 1
    done = drive(options(path, out, resume=True))
    assert shrunk(done) == shrunk(whole) == NEAREST
    assert make_report(done.proposer).state == make_report(whole.proposer).state
    scenes = [json.dumps(row.to_json(), default=str) for row in done.rows]
    assert len(scenes) == len(set(scenes))
    one, other = (
        read_table(folder).drop(columns=list(WALL_CLOCK_COLUMNS))
        for folder in (tmp_path / 'whole', out)
    )
    pd.testing.assert_frame_equal(one, other)


@pytest.mark.nightly
def test_given_few_runs_then_no_more_are_made_and_more_may_be_asked_for_on_resumption(tmp_path):
    path, out = campaign(tmp_path / 'c'), tmp_path / 'out'
    few = drive(options(path, out, runs=9, workers=8))
    found = make_report(few.proposer)
    assert found.state.end is End.SPENT
    assert len(few.rows) == 9
    assert 'its runs are spent' in result_lines(found, few.proposer, 1.0)[0]
    assert shrunk(drive(options(path, out, runs=200, resume=True))) == NEAREST


def test_given_a_run_that_breaks_once_then_it_is_retried_and_if_twice_the_bench_is_broken(
    tmp_path
):
    broken: list[str] = []

    def once(request: RunRequest) -> RunResult:
        if request.index == 3 and not broken:
            broken.append(request.run_id)
            return judged(request, Outcome.INFRA_ERROR)
        return judged(request)

    path = campaign(tmp_path / 'c')
    shrinking = drive(options(path, tmp_path / 'once'), once)
    assert shrunk(shrinking) == NEAREST
    assert [row.retries for row in shrinking.rows if row.retries] == [1]
    assert (tmp_path / 'once' / f'{broken[0]}.broken-1').is_dir()

    def never(request: RunRequest) -> RunResult:
        return judged(request, Outcome.INFRA_ERROR if request.index == 3 else None)

    shrinking = drive(options(path, tmp_path / 'never'), never)
    assert shrinking.broken is not None
    assert (shrinking.broken.index, shrinking.broken.retries) == (3, 1)
    assert len(shrinking.proposer.judged) == 3
    assert shrunk(drive(options(path, tmp_path / 'never', resume=True))) == NEAREST


@pytest.mark.nightly
def test_f1_given_a_bench_that_broke_when_resumed_then_the_table_is_that_of_an_undisturbed_one(
    tmp_path
):
    path, but = campaign(tmp_path / 'c'), [*WALL_CLOCK_COLUMNS, 'retries']
    drive(options(path, tmp_path / 'whole'))
    whole = read_table(tmp_path / 'whole')
    for at in (0, 3, len(whole) - 1):
        out = tmp_path / f'at-{at}'

        def broken(request: RunRequest, at=at) -> RunResult:
            return judged(request, Outcome.INFRA_ERROR if request.index == at else None)

        for sitting in range(2):
            assert drive(options(path, out, resume=sitting > 0), broken).broken is not None
        drive(options(path, out, resume=True), most=2)
        assert shrunk(drive(options(path, out, resume=True))) == NEAREST
        table = read_table(out)
        pd.testing.assert_frame_equal(table.drop(columns=but), whole.drop(columns=but))
        assert dict(table['retries'].value_counts()) == {0: len(whole) - 1, 4: 1}


def test_given_a_run_that_passes_now_then_it_is_not_reproduced(tmp_path):
    shrinking = drive(
        options(campaign(tmp_path / 'c'), tmp_path / 'out'),
        lambda request: judged(request, None)
        if request.scenario.rain_fraction < 0.1 else RunResult(
            outcome=Outcome.PASS, robustness=exact_intervals({NAME: 0.5}), last_seq=10,
            statistics=RunStatistics(max_cross_track_m=1.0),
        ),
    )
    assert make_report(shrinking.proposer).state.end is End.NOT_REPRODUCED
    assert len(shrinking.rows) == 2


def screen(found: Report) -> list[str]:
    console = Console(width=80, record=True, highlight=False, file=io.StringIO())
    console.print(parameter_table(found))
    return [line.rstrip() for line in console.export_text().splitlines()]


def test_given_the_outcome_when_printed_then_it_fits_80_columns(tmp_path):
    scenario = scenario_from_human({
        **WET.to_human(), 'heading_deg': -30.0, 'cross_track_m': -12.3, 'distance_m': 420.0,
    })
    shrinking = drive(options(campaign(tmp_path / 'c', scenario), tmp_path / 'out'))
    found = make_report(shrinking.proposer)
    lines = screen(found)
    assert lines[1].split() == [
        'parameter', 'original', 'nominal', 'shrunk', 'original', 'shrunk', 'verdict']
    assert lines[2].split()[:5] == ['cross_track_m', '-12.3', 'm', '0.0', 'm']
    assert lines[6].split() == [
        'clouds', 'stratus', 'clear', 'broken', '+0.30', '+0.30', 'matters']
    assert len(lines) == 8
    assert 'rain_percent: 31 % fails, 30 % passes (rho +0.01)' in finding_lines(found)
    assert '(a clear sky is dry too)' in finding_lines(found)[0]
    assert run_command(shrinking.proposer, 'a b.scenic') == (
        "taxinet run 'a b.scenic' --perception truth --set steering.heading_gain=1.5")


@pytest.mark.nightly
def test_given_others_and_faults_when_printed_then_keys_are_whole_on_80_columns(tmp_path):
    kinds = ('vehicle', 'person', 'cone', 'hold_line', 'patch')
    failing = dataclasses.replace(
        WET, sensors='standard', gnss_dropout_s=9.7, steering_rate_limit_radps=0.1,
        traffic=load_traffic([{'kind': kind, 'x_m': 900 + 9 * k, 'y_m': 0}
                              for k, kind in enumerate(kinds)]),
    )
    found = make_report(options(campaign(tmp_path / 'c', failing), tmp_path / 'out'))
    lines = screen(found)
    assert {line.split()[0] for line in lines if line[:1].strip()} == {
        'parameter', *(one.key for one in found.findings)}
    assert not any('…' in line or '@' in line for line in lines)
    assert max(map(len, lines)) <= 80
    whole = ' '.join(' '.join(lines).split())
    assert '1 vehicle' in whole
    assert 'hold line' in whole


def test_given_a_shrinking_that_was_cut_short_then_only_what_was_run_passes_or_matters(tmp_path):
    """A value that fails too was printed as one that passes (rho -0.50)."""
    for runs in range(2, 30):
        folder = tmp_path / str(runs)
        folder.mkdir()
        found = make_report(
            drive(options(campaign(folder / 'c'), folder / 'out', runs=runs)).proposer
        )
        for one in found.findings:
            assert one.matters is None or one.matters == (
                one.off_nominal and one.rho_in_shrunk > 0)
            assert (one.passes_at is None) == (one.rho_passes_at is None)
            assert one.rho_passes_at is None or one.rho_passes_at > 0
        if runs == 2:
            assert all('not known' in line for line in screen(found)[2:])


@pytest.mark.parametrize('rho', [-0.5, 0.0])
def test_given_the_value_beside_fails_too_then_it_is_not_said_to_pass(tmp_path, rho):
    """Robustness 0 is no pass."""
    shrinking = drive(options(campaign(tmp_path / 'c'), tmp_path / 'out'))
    search, space = shrinking.proposer.search, shrinking.proposer.space
    at = search.state.at
    axis = [one.key for one in space.moving].index('rain_percent')
    search.tell(search.moved(at, axis, at[axis] - 1), rho)
    found = _finding(shrinking.proposer, space.moving[axis], axis, at)
    assert (found.passes_at, found.rho_passes_at) == (None, None)


def test_given_a_run_with_two_causes_then_that_is_said(tmp_path):
    def either(request: RunRequest) -> RunResult:
        scenario = request.scenario
        rho = min(0.305 - scenario.rain_fraction, 1.0 if scenario.distance_m > 705 else -0.1)
        return RunResult(
            outcome=Outcome.PASS if rho > 0 else Outcome.FAIL,
            robustness=exact_intervals({NAME: rho}), last_seq=10,
            statistics=RunStatistics(max_cross_track_m=1.0),
        )

    shrinking = drive(options(campaign(tmp_path / 'c'), tmp_path / 'out'), either)
    matter = [one.key for one in make_report(shrinking.proposer).findings if one.matters]
    assert matter == ['clouds', 'rain_percent']
    lines = finding_lines(make_report(shrinking.proposer))
    assert 'rain_percent: the original fails without it too, so it has another cause' in lines


REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    'workers': ({}, {'workers': 9}, 'workers 9: needs to be within 1..8'),
    'runs': ({}, {'runs': 1}, 'runs 1: needs to be 2 or more'),
    'unknown key': ({}, {'nominal': ['duration=3']}, 'nominal duration_s: unknown; known: '),
    'no key': ({}, {'nominal': ['rain']}, "nominal 'rain': expected key=value"),
    'impossible': ({}, {'nominal': ['rain=50']}, 'nominal: rain needs clouds broken'),
    'perception': ({}, {'perception': 'nobody'}, "perception: 'nobody' is unknown"),
    'images': ({}, {'images': 'few'}, 'images few: unknown'),
    'resume': ({}, {'resume': True, 'out': None}, 'resume: name the campaign to continue'),
    'passed': ({'scenario': Scenario()}, {}, 'satisfied phi_eventually with rho +0.30'),
    'broken': ({'outcome': Outcome.INFRA_ERROR}, {}, 'INFRA_ERROR, so it was never judged'),
    'rejected': (
        {'outcome': Outcome.REJECTED, 'distance_m': None}, {}, 'no scene was drawn'),
    'other weights': (
        {'fingerprint': 'ab' * 32}, {},
        'truth is without weights here, and was sha256 abababababab… in the runs; name it as '
        'perception, at its new place or as it is'),
    'lost file': ({'perception': 'gone.onnx'}, {}, 'name it as perception'),
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize('case', REFUSED)
def test_given_a_mistake_or_a_run_that_cannot_be_shrunk_then_one_line_says_so(tmp_path, case):
    of_run, asked, expected = REFUSED[case]
    path = campaign(tmp_path / 'c', **of_run)
    with pytest.raises(UsageError) as caught:
        options(path, **{'out': tmp_path / 'out', **asked})
    assert expected in str(caught.value)
    assert '\n' not in str(caught.value)


def test_given_no_run_or_a_whole_campaign_then_one_line_says_what_to_name(tmp_path):
    path = campaign(tmp_path / 'c')
    with pytest.raises(UsageError, match='no such run; name it <campaign>/<run>'):
        find_run(path.with_name('p-s7-00001'))
    with pytest.raises(UsageError, match=r'1 failed runs, as in .*c/p-s7-00000$'):
        find_run(path.parent)
    with pytest.raises(UsageError, match='no such run'):
        find_run(tmp_path / 'nowhere' / 'x')


def test_given_a_run_on_a_nominal_scenario_then_there_is_nothing_to_shrink(tmp_path):
    nominal = make_shrink_space(WET).nominal
    with pytest.raises(UsageError, match='the run is nominal already'):
        make_shrink_space(nominal)
    assert [one.key for one in make_shrink_space(nominal, ['shadows=off']).moving] == ['shadows']


def test_given_another_shrinking_in_the_folder_then_resuming_it_is_refused(tmp_path):
    path, out = campaign(tmp_path / 'c'), tmp_path / 'out'
    drive(options(path, out))
    with pytest.raises(UsageError, match='was begun with nominal'):
        drive(options(path, out, resume=True, nominal=['time_of_day=11']))
    with pytest.raises(UsageError, match='already exists'):
        options(path, out)


def test_given_a_space_then_its_ends_are_exact_and_its_steps_are_what_people_would_type():
    space = make_shrink_space(WET)
    top = tuple(one.axis.steps for one in space.moving)
    assert space.scenario(top) == WET, 'to the last bit'
    assert space.scenario((0,) * len(top)) == space.nominal
    hours = next(one.values for one in space.parameters if one.key == 'time_of_day_h')
    assert hours[:3] == (10.0, 10.05, 10.1)
    assert hours[-2:] == (15.45, 15.5)
    clouds = next(one.values for one in space.parameters if one.key == 'clouds')
    assert clouds == ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')
    beyond = make_shrink_space(Scenario(distance_m=1500.0, clouds='cirrus'))
    assert beyond.nominal.distance_m == 1800.0
    assert make_shrink_space(Scenario(clouds='clear'), ['clouds=broken', 'rain=30']).moving[
        -2
    ].values == ('broken', 'scattered', 'cirrus', 'clear')


def test_given_a_run_that_was_pushed_then_what_pushed_it_goes_to_nominal_with_what_hangs_on_it():
    pushed = dataclasses.replace(
        WET, wind_speed_mps=2.0, wind_direction_rad=1.0, gust_mps=1.0, gust_seed=7.0,
        runway_state='icy', slope_fraction=0.002, speed_mps=6.0,
    )
    space = make_shrink_space(pushed)
    moving = {one.key: one.values for one in space.moving}
    assert moving['wind_speed_mps'] == (0.0, 0.5, 1.0, 1.5, 2.0)
    assert moving['runway_state'] == ('dry', 'auto', 'wet', 'icy')
    assert moving['slope_percent'] == (0.0, 0.1, 0.2)
    assert moving['speed_mps'] == (5.0, 5.5, 6.0)
    top = tuple(one.axis.steps for one in space.moving)
    assert space.scenario(top) == pushed
    assert not space.nominal.pushed
    assert space.scenario((0,) * len(top)) == space.nominal
    place = list(moving).index('wind_speed_mps')
    calm = space.scenario((*top[:place], 0, *top[place + 1:]))
    assert calm == dataclasses.replace(pushed, wind_speed_mps=0.0, wind_direction_rad=0.0)
    breeze = space.scenario((*top[:place], 1, *top[place + 1:]))
    assert breeze == dataclasses.replace(pushed, wind_speed_mps=0.5)
    assert 'wind_speed_mps' not in {one.key for one in make_shrink_space(WET).parameters}
    with pytest.raises(UsageError, match='nominal: aircraft c172p: wind_speed_mps'):
        make_shrink_space(dataclasses.replace(pushed, wind_speed_mps=9.0), ['aircraft=c172p'])


@pytest.mark.parametrize(('length_m', 'crossing_m', 'begun_m', 'nominal_m'), [
    (1180.0, None, 200.0, 200.0),   # 1000 m is beyond the last start
    (2000.0, None, 200.0, 1000.0),
    (2000.0, 520.0, 200.0, 200.0),  # 1000 m is beyond the crossing
    (2000.0, 520.0, 800.0, 800.0),
    (2400.0, 520.0, 800.0, 1800.0),
])
def test_given_a_short_runway_then_the_nominal_start_is_on_it_and_before_the_same_crossing(
    length_m, crossing_m, begun_m, nominal_m
):
    runway = {
        'ends': [{'designation': '18', 'latitude_deg': 0.0, 'longitude_deg': 8.0},
                 {'designation': '36', 'latitude_deg': -length_m / 110_574.3,
                  'longitude_deg': 8.0}],
        'width_m': 23, 'elevation_m': 0, 'category': 'visual', 'surface': 'asphalt',
    }
    if crossing_m is not None:
        runway['crossings'] = [{'x_m': crossing_m, 'yaw_deg': 80, 'width_m': 30}]
    place = json.dumps({'name': 'short', 'time_zone': 'UTC+01:00', 'runway': runway})
    space = make_shrink_space(Scenario(place=place, distance_m=begun_m, clouds='cirrus'))
    assert space.nominal.distance_m == nominal_m
    assert ('distance_m' in {one.key for one in space.moving}) is (begun_m != nominal_m)


def test_given_a_run_on_a_track_then_it_stays_there_and_where_it_began(tmp_path):
    failed = Scenario(track='exit_left', distance_m=250.0, cross_track_m=4.0, clouds='cirrus')
    space = make_shrink_space(failed)
    assert {one.key for one in space.moving} == {'cross_track_m', 'clouds', 'time_of_day_h'}
    assert (space.nominal.track, space.nominal.distance_m) == ('exit_left', 250.0)
    path = tmp_path / 'shrunk.scenic'
    path.write_text(scenario_program(failed, 'on a track', {}))
    assert sample_scenarios(path, seed=3, n=1) == [failed]


def test_given_a_scenario_when_written_as_a_program_then_that_draws_it(tmp_path):
    path = tmp_path / 'shrunk.scenic'
    remarks = {'rain_percent': 'matters', 'heading_deg': 'matters'}
    text = scenario_program(WET, 'From "a" \\ b.', remarks)
    path.write_text(text)
    assert '# heading_deg matters' in text
    (drawn,) = sample_scenarios(path, seed=3, n=1)
    for key, value in WET.to_human().items():
        assert drawn.to_human()[key] == value
    assert drawn.cross_track_m == WET.cross_track_m
    assert drawn.heading_rad == pytest.approx(WET.heading_rad, abs=1e-15)


def test_given_a_run_with_faults_then_each_goes_to_none_and_the_last_takes_onset_and_seed_along():
    failing = dataclasses.replace(
        WET, duration_s=10.0, lens_dirt_fraction=0.035, steering_rate_limit_radps=0.1,
        fault_onset_s=2.0, fault_seed=7.0,
    )
    space = make_shrink_space(failing)
    moving = {one.key: one.values for one in space.moving}
    assert moving['lens_dirt_percent'] == (0.0, 1.0, 2.0, 3.0, 3.5)
    assert len(moving['steering_rate_limit_degps']) == 2
    assert not {'fault_onset_s', 'fault_seed', 'lens_drops_percent'} & moving.keys()
    top = tuple(one.axis.steps for one in space.moving)
    assert space.scenario(top) == failing
    assert space.nominal == space.nominal.without_faults(*FAULTS)
    assert space.scenario((0,) * len(top)) == space.nominal
    dirt = list(moving).index('lens_dirt_percent')
    clean = space.scenario((*top[:dirt], 0, *top[dirt + 1:]))
    assert clean == dataclasses.replace(failing, lens_dirt_fraction=0.0, fault_seed=0.0)
    with pytest.raises(UsageError, match='nominal: wind_speed_mps needs a number'):
        make_shrink_space(dataclasses.replace(WET, wind_speed_mps=3.0), ['wind_speed=strong'])


def test_given_others_on_the_ground_then_they_are_taken_away_from_the_last_to_the_first():
    cones = [{'kind': 'cone', 'x_m': 1100 + k, 'y_m': 5} for k in range(3)]
    crowded = dataclasses.replace(WET, traffic=load_traffic(cones))
    space = make_shrink_space(crowded)
    others = next(one for one in space.moving if one.key == 'traffic')
    assert [word.split('_')[0] for word in others.values] == ['nobody', '1', '2', '3']
    top = [one.axis.steps for one in space.moving]
    assert space.scenario(tuple(top)) == crowded
    top[space.moving.index(others)] = 1
    assert space.scenario(tuple(top)).traffic == load_traffic(cones[:1])
    assert space.nominal.traffic == 'nobody'
    assert 'traffic' not in {one.key for one in make_shrink_space(WET).parameters}


@pytest.mark.parametrize(('spec', 'kinds'), [
    ('phi_always', ['nobody', '1 cone', '1 cone and 1 hold line',
                    '1 cone, 1 hold line and 1 patch']),
    ('hold_short', ['1 hold line', '1 cone and 1 hold line', '1 cone, 1 hold line and 1 patch']),
    ('no_collision', ['1 cone', '1 cone and 1 hold line', '1 cone, 1 hold line and 1 patch']),
])
def test_given_a_formula_about_others_then_those_stay_that_it_is_about(spec, kinds):
    there = load_traffic([
        {'kind': kind, 'x_m': 1100 + 9 * k, 'y_m': 0}
        for k, kind in enumerate(('cone', 'hold_line', 'patch'))
    ])
    specs = [parse_spec(spec)]
    space = make_shrink_space(dataclasses.replace(WET, traffic=there), (), specs)
    others = next(one for one in space.moving if one.key == 'traffic')
    assert [BY_KEY['traffic'].value_words(value) for value in others.values] == kinds
    check_others(specs, space.nominal)
    if spec != 'phi_always':
        with pytest.raises(UsageError, match=f'^nominal: {spec}: reads .*, and '):
            make_shrink_space(dataclasses.replace(WET, traffic=there), ['traffic=nobody'], specs)


def test_given_a_run_with_signals_then_its_control_points_go_to_nominal_one_by_one(tmp_path):
    gusty = scenario_from_human({
        'wind_speed': 2, 'wind_direction': 90, 'wind_direction@3': 100, 'wind_speed@5': 12,
        'wind_speed@8': 3, 'wind_speed@form': 'cubic', 'runway_state@4': 'icy', 'cross_track': 1,
        'time_of_day': 10, 'distance': 1000,
    })
    space = make_shrink_space(gusty)
    moving = {one.key: one for one in space.moving}
    assert list(moving) == [
        'cross_track_m', 'wind_speed_mps', 'wind_speed_mps@5', 'wind_speed_mps@8', 'runway_state@4',
    ]
    assert moving['wind_speed_mps@8'].values == (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    assert moving['runway_state@4'].values == ('dry', 'auto', 'wet', 'icy')
    assert [moving[key].axis.scan for key in moving] == [False, False, False, False, True]
    top = tuple(one.axis.steps for one in space.moving)
    assert space.scenario(top) == gusty
    # A signal that stays at its start is none, and a direction without wind goes with it.
    assert space.scenario((0,) * 5) == space.nominal
    assert space.nominal.signals == ''
    assert not space.nominal.pushed
    assert space.scenario((top[0], 0, 0, 0, top[4])).points == {'runway_state@4': 'icy'}

    def judge(request: RunRequest) -> RunResult:
        """A failure in a wind of more than 6 m/s at 5 s."""
        rho = 6.2 - request.scenario.at(WIND_SPEED, 5_000_000_000)
        return dataclasses.replace(
            judged(request, Outcome.PASS if rho > 0 else Outcome.FAIL),
            robustness=exact_intervals({NAME: rho}),
        )

    shrinking = options(campaign(tmp_path / 'c', gusty, outcome=Outcome.FAIL,
                                 robustness=exact_intervals({NAME: -5.8})), tmp_path / 'out')
    found = make_report(drive(shrinking, judge).proposer)
    assert found.state.end is End.MINIMAL
    assert dict(found.scenario.points) == {
        'wind_speed_mps@form': 'cubic', 'wind_speed_mps@5': 6.5, 'wind_speed_mps@8': 0.0,
        'wind_direction_deg@3': 100.0,
    }
    assert (found.scenario.wind_speed_mps, found.scenario.runway_state) == (0.0, 'dry')
    assert [one.key for one in found.findings if one.matters] == ['wind_speed_mps@5']
