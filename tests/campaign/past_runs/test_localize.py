"""Failed runs of a campaign once more, in worker processes, with the truth for the network."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from taxinet_ros.analysis.fault_localisation import Blame, Suffices, judge_case
from taxinet_ros.campaign.past_runs.localisation import (
    TRIALS_NAME,
    Task,
    Trial,
    TrialSetup,
    localize,
    make_localize_options,
    make_trial,
)
from taxinet_ros.campaign.past_runs.recorded_campaign import (
    open_campaign,
    open_failed_campaign,
    scenario_of_row,
    spread_evenly,
)
from taxinet_ros.campaign.record.ledger import Ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.core.perception.perception import check_perception, make_perception
from taxinet_ros.core.perception.substituted import AS_RECORDED
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError

SPEC = 'phi_eventually'
FORMULA = 'eventually[0:10](always(abs(cte) <= 1.5))'
JUDGING = Judging(specs=(f'{SPEC}={FORMULA}',))
WET = scenario_from_human({
    'cross_track': 5, 'heading': 20, 'distance': 600, 'clouds': 'stratus', 'rain': 90,
    'time_of_day': 8, 'duration': 12,
})
OFF = [
    scenario_from_human({'cross_track': 5, 'heading': heading, 'duration': 11})
    for heading in (10, 15, 20)
]
"""With a nose wheel that never turns they go on and on to the left."""
LOCKED = {'heading_gain': 0.0}


def row_of(trial: Trial, scene: Scenario, index: int, perception: str) -> RunRow:
    return RunRow(
        run_id=trial.run_id, index=index, program='s_falsif', seed=3, perception=perception,
        fingerprint=check_perception(perception), sampler='random', weight=1.0,
        **scene.to_human(), outcome=Outcome.PASS if trial.passed else Outcome.FAIL,
        robustness={SPEC: trial.robustness},
        stopped_early=False, left_runway=trial.left_runway,
        max_cross_track_m=trial.max_cross_track_m, settle_time_s=trial.settle_time_s,
    )


def failed_campaign(
    folder: Path, scenes: Sequence[Scenario], *, perception: str = 'truth',
    gains: Mapping[str, float] = LOCKED, **changes: Any,
) -> list[RunRow]:
    """Run scenes as they are, and write down the ledger of a campaign of them."""
    bench = TrialSetup(perception=perception, judging=JUDGING, gains=gains)
    network = make_perception(perception)
    rows = []
    for index, scene in enumerate(scenes):
        task = Task(run_id=f'run-{index}', scenario=scene, word=AS_RECORDED, seed=(3, index))
        row = row_of(make_trial(task, bench, network), scene, index, perception)
        rows.append(dataclasses.replace(row, **changes))
    folder.mkdir()
    with Ledger(folder / 'ledger.jsonl') as ledger:
        ledger.campaign({
            'program': 's_falsif.scenic', 'seed': 3, 'runs': len(rows), 'perception': perception,
            'specs': {SPEC: FORMULA}, 'gains': dict(gains), 'stop_on': 'never',
        })
        for row in rows:
            ledger.result(row)
    return rows


def options(folder: Path, out: Path, **changes):
    given = {'runs': None, 'words': (), 'workers': 1, 'out': out, 'perception': None, **changes}
    return make_localize_options(folder, **given)


def events(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / TRIALS_NAME).read_text().splitlines()]


def never() -> bool:
    return False


def test_given_a_failure_of_the_network_then_it_comes_out_as_recorded_and_the_truth_passes(
    tmp_path,
):
    (row,) = failed_campaign(tmp_path / 'c', [WET], perception='original', gains={})
    assert row.outcome == 'FAIL'
    asked = options(tmp_path / 'c', tmp_path / 'out')
    trials = localize(asked, lambda done: None, never)
    assert sorted(word for _, word in trials) == [AS_RECORDED, 'truth', 'truth-cte',
                                                  'truth-heading']
    control = trials['run-0', AS_RECORDED]
    assert control.robustness == row.robustness[SPEC]
    assert control.max_cross_track_m == row.max_cross_track_m
    case = judge_case(row, {word: trial for (_, word), trial in trials.items()})
    assert (case.blame, case.counted) == (Blame.PERCEPTION, True)
    assert case.suffices is not Suffices.UNKNOWN


def test_given_a_nose_wheel_that_never_turns_then_the_truth_fails_too_and_the_law_is_to_blame(
    tmp_path,
):
    (row,) = failed_campaign(tmp_path / 'c', OFF[:1], perception='original')
    bench = TrialSetup(perception='original', judging=JUDGING, gains=LOCKED)
    network = make_perception('original')
    trials = {
        word: make_trial(
            Task(run_id='run-0', scenario=OFF[0], word=word, seed=(3, 0)), bench, network
        )
        for word in (AS_RECORDED, 'truth')
    }
    assert judge_case(row, trials).blame is Blame.CONTROLLER


def test_given_an_interrupt_then_the_same_command_does_what_is_left_and_more_may_be_asked(
    tmp_path,
):
    failed_campaign(tmp_path / 'c', OFF)
    out, counts = tmp_path / 'out', []
    asked = options(tmp_path / 'c', out, words=['truth', 'noisy:1'])
    assert asked.wanted == 9
    part = localize(asked, counts.append, lambda: len(counts) > 3)
    assert counts[0] == 0
    assert 3 <= len(part) < 9
    with (out / TRIALS_NAME).open('a') as file:
        file.write('{"event":"trial","tri')  # a torn last line, as of a power cut
    rest: list[int] = []
    whole = localize(asked, rest.append, never)
    assert (rest[0], rest[-1], len(whole)) == (len(part), 9, 9)
    assert {key: whole[key] for key in part} == part
    more = localize(
        options(tmp_path / 'c', out, words=['truth'], runs=1), lambda done: None, never)
    assert set(more) == {('run-1', AS_RECORDED), ('run-1', 'truth')}
    made = [(one['trial']['run_id'], one['trial']['word'])
            for one in events(out) if one['event'] == 'trial']
    assert len(made) == len(set(made)) == 9


def test_given_the_number_of_workers_then_the_trials_are_the_same(tmp_path):
    failed_campaign(tmp_path / 'c', OFF[:2])
    found = [
        localize(
            options(tmp_path / 'c', tmp_path / f'out{workers}', workers=workers,
                    words=['truth', 'noisy:2', 'truth-delayed:1']), lambda done: None, never)
        for workers in (1, 2)
    ]
    assert len(found[0]) == 8
    assert found[0] == found[1]
    assert found[0]['run-0', 'noisy:2'] != found[0]['run-1', 'noisy:2']


def test_given_trials_of_another_campaign_or_something_else_then_they_are_not_mixed(tmp_path):
    failed_campaign(tmp_path / 'c', OFF[:1])
    failed_campaign(tmp_path / 'other', OFF[:1], gains={'heading_gain': 0.01})
    out = tmp_path / 'out'
    localize(options(tmp_path / 'c', out), lambda done: None, lambda: True)
    with pytest.raises(UsageError, match='contains trials of another campaign or network'):
        localize(options(tmp_path / 'other', out), lambda done: None, never)
    (out / TRIALS_NAME).write_text('{"event":"localize"}\n')
    with pytest.raises(UsageError, match=r'trials.jsonl:1: damaged line'):
        localize(options(tmp_path / 'c', out), lambda done: None, never)
    with pytest.raises(UsageError, match='contains something else'):
        localize(options(tmp_path / 'c', tmp_path / 'other'), lambda done: None, never)


def test_given_bad_input_then_one_line_says_what_is_wrong(tmp_path):
    rows = failed_campaign(tmp_path / 'c', OFF[:1])
    bad = [
        (tmp_path, {}, 'not a campaign: no ledger.jsonl'),
        (tmp_path / 'c', {'runs': 0}, '--runs 0: needs to be 1 or more'),
        (tmp_path / 'c', {'workers': 0}, '--workers 0: needs to be within 1..64'),
        (tmp_path / 'c', {'words': ['turth']}, '--with turth: unknown'),
        (tmp_path / 'c', {'perception': 'original'}, 'the runs had the truth; name the file'),
    ]
    for folder, changes, words in bad:
        with pytest.raises(UsageError, match=words) as error:
            options(folder, tmp_path / 'out', **changes)
        assert '\n' not in str(error.value)
    failed_campaign(tmp_path / 'good', OFF[:1], gains={})
    with pytest.raises(UsageError, match='none of its 1 judged runs failed'):
        options(tmp_path / 'good', tmp_path / 'out')
    assert scenario_of_row(rows[0], tmp_path / 'c', {}) == (OFF[0], False)


def test_given_a_number_of_runs_then_they_are_spread_over_all(tmp_path):
    rows = failed_campaign(tmp_path / 'c', OFF)
    assert open_failed_campaign(tmp_path / 'c').counterexamples == tuple(rows)
    many = tuple(range(1996))
    chosen = spread_evenly(many, 200)
    assert len(set(chosen)) == 200
    steps = {b - a for a, b in pairwise(chosen)}
    assert steps <= {9, 10}
    assert chosen[0] < 10 > 1995 - chosen[-1]
    assert spread_evenly(many, None) == spread_evenly(many, 5000) == many
    assert Trial.from_json(Trial(run_id='a', word='truth', passed=None).to_json()).passed is None


def test_given_a_recorded_campaign_then_rows_rates_and_counterexamples_are_read_from_its_ledger(
    tmp_path,
):
    rows = failed_campaign(tmp_path / 'c', OFF)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob('*')}
    found = open_campaign(tmp_path / 'c')
    assert found.rows == found.judged == found.counterexamples == tuple(rows)
    table = found.table()
    assert list(table['run_id']) == [row.run_id for row in rows]
    assert (table['outcome'] == 'FAIL').all()
    rate = found.failure_rate.rate
    assert rate is not None
    assert (rate.rate, rate.high) == (1.0, 1.0)
    assert found.judging == JUDGING
    assert found.bag(rows[0]) is None
    assert found.scenario(rows[0]) == (OFF[0], False)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob('*')} == before
    with pytest.raises(UsageError, match=r'not a campaign: no ledger\.jsonl'):
        open_campaign(tmp_path)
