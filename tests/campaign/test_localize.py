"""Failed runs of a campaign once more, in worker processes, with the truth for the network."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import pytest
from localize_samples import FORMULA, LOCKED, OFF, SPEC, WET, failed_campaign

from taxinet_ros.analysis.fault_localisation import Blame, Suffices, judge_case
from taxinet_ros.campaign.counterexamples import failed_runs, scenario_of_row, spread
from taxinet_ros.campaign.localize import TRIALS_NAME, localize, make_localize_options
from taxinet_ros.campaign.trials import Bench, Task, Trial, make_trial
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.perception import make_perception
from taxinet_ros.core.substituted_perception import AS_RECORDED


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
    assert (control.rho_lower, control.rho_upper) == (row.rho[SPEC], row.rho[SPEC])
    assert control.max_cross_track_m == row.max_cross_track_m
    case = judge_case(row, {word: trial for (_, word), trial in trials.items()})
    assert (case.blame, case.counted) == (Blame.PERCEPTION, True)
    assert case.suffices is not Suffices.UNKNOWN


def test_given_a_nose_wheel_that_never_turns_then_the_truth_fails_too_and_the_law_is_to_blame(
    tmp_path,
):
    (row,) = failed_campaign(tmp_path / 'c', OFF[:1], perception='original')
    bench = Bench(perception='original', specs=(f'{SPEC}={FORMULA}',), gains=LOCKED)
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
    with pytest.raises(UsageError, match='holds trials of another campaign or network'):
        localize(options(tmp_path / 'other', out), lambda done: None, never)
    (out / TRIALS_NAME).write_text('{"event":"localize"}\n')
    with pytest.raises(UsageError, match=r'trials.jsonl:1: damaged line'):
        localize(options(tmp_path / 'c', out), lambda done: None, never)
    with pytest.raises(UsageError, match='holds something else'):
        localize(options(tmp_path / 'c', tmp_path / 'other'), lambda done: None, never)


def test_given_bad_input_then_one_line_says_what_is_wrong(tmp_path):
    rows = failed_campaign(tmp_path / 'c', OFF[:1])
    bad = [
        (tmp_path, {}, 'no campaign, for it has no ledger.jsonl'),
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
    assert failed_runs(tmp_path / 'c').rows == tuple(rows)
    many = tuple(range(1996))
    chosen = spread(many, 200)
    assert len(set(chosen)) == 200
    steps = {b - a for a, b in pairwise(chosen)}
    assert steps <= {9, 10}
    assert chosen[0] < 10 > 1995 - chosen[-1]
    assert spread(many, None) == spread(many, 5000) == many
    assert Trial.from_json(Trial(run_id='a', word='truth', passed=None).to_json()).passed is None
