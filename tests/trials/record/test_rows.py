"""Rows: what they may say, and of runs that were stopped early; in tables and for a sampler."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import falsify_samples
import pytest
from campaign_records import change_row, write_campaign

from taxinet_ros.core.mtl import RobustnessInterval, exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.verdict.run_statistics import RunStatistics
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import failure_rate, off_runway_rate
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.summary import (
    Summary,
    campaign_summary,
    row_line,
    summary_json,
    worst_words,
)

SPECS = ('phi_eventually', 'near')


def result(index: int, *, stopped: bool, furthest: float = 4.0) -> RunResult:
    given = {
        'phi_eventually': RobustnessInterval(-math.inf, -0.25),
        'near': RobustnessInterval.exactly(-0.5),
    } if stopped else exact_intervals({'phi_eventually': -3.0, 'near': -3.5})
    return RunResult(
        outcome=Outcome.FAIL, last_seq=101 if stopped else 300, wall_s=1.0, stopped_early=stopped,
        statistics=RunStatistics(max_cross_track_m=furthest, settle_time_s=1.0), robustness=given,
    )


def row(index: int, *, stopped: bool, furthest: float = 4.0) -> RunRow:
    asked = RunRequest(
        run_id=f'run-{index}', index=index, program='s_falsif', seed=5, scenario=Scenario(),
        participants=(), judging=Judging(specs=SPECS, stop_on=StopOn.VIOLATED),
    )
    answer = result(index, stopped=stopped, furthest=furthest)
    sim_s = answer.last_seq / 10
    made = RunRow.of_run(asked, answer, perception='truth', sim_s=sim_s, bag=asked.run_id)
    return made.with_choice(sampler='random', point={}, weight=1.0, retries=0)


def campaign(folder: Path, *rows: RunRow, **more: Any) -> Path:
    return write_campaign(folder, rows, {'specs': dict.fromkeys(SPECS, '')}, **more)


def test_given_a_stopped_run_when_tabulated_then_it_has_an_interval_and_says_when(tmp_path: Path):
    frame = read_table(campaign(tmp_path, row(0, stopped=True), row(1, stopped=False)))
    assert list(frame['stopped_early']) == [True, False]
    assert frame['stopped_s'][0] == 10.1
    assert math.isnan(frame['stopped_s'][1])
    assert math.isnan(frame['rho'][0])
    assert frame['rho'][1] == frame['rho_phi_eventually'][1] == -3.0
    assert list(frame['rho_near']) == [-0.5, -3.5]
    assert list(frame['rho_lower.phi_eventually']) == [-math.inf, -3.0]
    assert list(frame['rho_upper.phi_eventually']) == [-0.25, -3.0]
    assert list(frame['outcome']) == ['FAIL', 'FAIL']
    names = [name for name in frame.columns if name.startswith('rho')]
    assert names == ['rho', *(f'{start}{name}' for start in ('rho_', 'rho_lower.', 'rho_upper.')
                              for name in SPECS)]


def test_given_a_stopped_run_then_nobody_claims_to_know_what_came_after():
    inside, outside = row(0, stopped=True), row(1, stopped=True, furthest=30.0)
    assert (inside.left_runway, inside.settle_time_s) == (None, None)
    assert outside.left_runway is True
    assert inside.max_cross_track_m == 4.0
    rows = [inside, outside, row(2, stopped=False)]
    assert off_runway_rate(rows) is None
    assert off_runway_rate(rows[1:]) is not None
    found = failure_rate(rows)
    assert (found.hits, found.runs, found.drawn_hits) == (3, 3, 3)


def test_given_a_stopped_run_then_a_sampler_is_told_the_end_that_is_nearer_to_zero():
    stopped = row(0, stopped=True)
    assert stopped.robustness_for_sampler('phi_eventually') == -0.25
    assert stopped.headline == (-math.inf, -0.25)
    assert row(1, stopped=False).robustness_for_sampler('phi_eventually') == -3.0
    assert stopped.robustness_for_sampler('unknown') is None
    open_ended = dataclasses.replace(stopped, robustness={
        'a': RobustnessInterval(0.5, math.inf), 'b': RobustnessInterval(-1.0, 1.0),
    })
    assert open_ended.robustness_for_sampler('a') == 0.5
    assert open_ended.robustness_for_sampler('b') is None


def test_given_a_stopped_run_when_printed_then_the_bound_and_the_saving_are_told(tmp_path: Path):
    rows = [row(0, stopped=True), row(1, stopped=False)]
    text = row_line(rows[0]).plain
    assert 'rho <=-0.25 ' in text
    assert 'stopped at 10.1 s' in text
    assert Summary(rows).stopped_words() == [
        '1 stopped early, which saved 20 of 60 s of simulated time (33%)'
    ]
    assert Summary(rows[1:]).stopped_words() == []
    words = campaign_summary(Summary(rows), falsify_samples.options(tmp_path).campaign)
    assert '0 off the runway before they were stopped' in words


def test_given_a_run_that_violates_another_formula_than_the_headline_then_that_is_named(tmp_path):
    def judged(index, **rho):
        return dataclasses.replace(
            row(index, stopped=False), robustness=exact_intervals(rho),
            outcome=Outcome.PASS if min(rho.values()) > 0 else Outcome.FAIL)

    other, headline = judged(0, near=2.0, clear=-3.0), judged(1, near=-1.0, clear=-4.0)
    passed = judged(2, near=5.0, clear=6.0)
    line = row_line(other).plain
    assert 'FAIL  rho   -3.00 ' in line
    assert ' m  clear ' in line
    assert 'FAIL  rho   -1.00 ' in row_line(headline).plain
    assert 'PASS  rho   +5.00 ' in row_line(passed).plain
    assert not any('clear ' in row_line(one).plain[:45] for one in (headline, passed))
    options = falsify_samples.options(tmp_path).campaign
    worst = summary_json(Summary([passed, headline, other]), options, None)['worst']
    assert (worst['run_id'], worst['spec'], worst['rho']['upper']) == (other.run_id, 'clear', -3.0)
    assert worst_words(other) == 'rho -3.00 of clear'
    worst = summary_json(Summary([passed, headline]), options, None)['worst']
    assert (worst['rho']['upper'], 'spec' in worst) == (-1.0, False)


@pytest.mark.parametrize('made', [
    row(0, stopped=True), row(1, stopped=False),
    RunRow(run_id='r', index=2, program='p', seed=1, perception='', outcome=Outcome.REJECTED),
])
def test_given_a_row_when_recorded_then_it_is_read_as_it_was(made: RunRow, tmp_path: Path):
    assert read_campaign(campaign(tmp_path, made)).rows == (made,)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('changes', 'said'), [
    ({'robustness': {'phi': (0.5, 0.5)}}, 'FAIL with robustness'),
    ({'robustness': {'phi': (-0.5, 0.5)}}, 'has intervals'),
    ({'robustness': {}}, 'FAIL with rho'),
    ({'outcome': 'PASS'}, 'PASS with robustness'),
    ({'outcome': 'PASS', 'robustness': {'phi': (0.0, 0.0)}}, 'PASS with robustness'),
    ({'outcome': 'PASS', 'robustness': {}}, 'PASS with rho'),
    ({'outcome': 'INFRA_ERROR'}, 'INFRA_ERROR with rho'),
    ({'outcome': 'GREAT'}, "'GREAT' is not a valid Outcome"),
    ({'run_id': '../../etc'}, "run_id is '../../etc', not a plain name"),
    ({'bag': '../../etc'}, "bag is '../../etc', not a plain name"),
    ({'index': -1}, 'index is -1'),
    ({'clouds': 'purple'}, 'clouds is'),
    ({'distance_m': math.inf}, 'distance_m is inf'),
    ({'fingerprints': ''}, 'unexpected keyword argument'),
])
def test_given_a_row_that_cannot_be_then_the_record_is_refused(
    changes: dict[str, Any], said: str, tmp_path: Path
):
    campaign(tmp_path, row(0, stopped=False))
    change_row(tmp_path, 0, **changes)
    with pytest.raises(UsageError, match=r'campaign\.db: not a row of this version') as caught:
        read_campaign(tmp_path)
    assert said in str(caught.value)
    assert '\n' not in str(caught.value)


def test_given_a_later_requirement_when_on_record_then_the_rows_of_before_have_it(tmp_path: Path):
    passed = dataclasses.replace(
        row(3, stopped=False), outcome=Outcome.PASS,
        robustness=exact_intervals(dict.fromkeys(SPECS, 1.0)),
    )
    rows = (
        row(0, stopped=True).also_judged('late', RobustnessInterval(-1.0, 2.0)),
        row(1, stopped=False).also_judged('late', RobustnessInterval.exactly(0.5)),
        row(2, stopped=False),
        passed.also_judged('late', RobustnessInterval.exactly(-4.0)),
    )
    folder = campaign(tmp_path, *rows, added={'late': 'always(cte < 1)'})
    content = read_campaign(folder)
    assert content.added == {'late': 'always(cte < 1)'}
    first, second, third, fourth = content.rows
    assert first.robustness['late'] == (-1.0, 2.0)
    assert first.headline == (-math.inf, -0.25), 'the headline stays the first'
    assert second.rho['late'] == 0.5
    assert second.headline == (-3.0, -3.0)
    assert 'late' not in third.robustness, 'it was run afterwards'
    assert (fourth.outcome, fourth.rho['late']) == ('PASS', -4.0), 'outcomes are of the first ones'
    frame = read_table(folder)
    assert list(frame['rho_late'].fillna(9)) == [9, 0.5, 9, -4.0]
    assert list(frame['rho_upper.late'].fillna(9)) == [2.0, 0.5, 9, -4.0]
    with pytest.raises(ValueError, match='FAIL with bad'):
        row(1, stopped=False).also_judged('bad', RobustnessInterval(-1.0, 2.0))
