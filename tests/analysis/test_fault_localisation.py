"""What is concluded from trials, and how it is said."""

from __future__ import annotations

import dataclasses
import json
import math

import pandas as pd
import pytest

from taxinet_ros.analysis.fault_localisation import (
    Blame,
    Localisation,
    Suffices,
    judge_case,
    localisation_json,
    localisation_report,
    localisation_sentences,
    worst_cases,
    write_cases,
)
from taxinet_ros.analysis.report.pictures import DARK, LIGHT, png_bytes
from taxinet_ros.core.mtl import RobustnessInterval, exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.trials.past_runs.trials import Trial
from taxinet_ros.trials.record.row import RunRow

WORDS = ('as-recorded', 'truth', 'truth-heading', 'truth-cte')
DELAYED = 'delayed:0.5'


def row(index: int, rho: float = -2.0) -> RunRow:
    return RunRow(
        run_id=f'run-{index}', index=index, program='p', seed=1, perception='original',
        outcome=Outcome.FAIL, robustness=exact_intervals({'phi_eventually': rho}),
        stopped_early=False,
        **Scenario().to_human(),
    )


def trials(index: int, *answers: bool | None, exact: bool = True, control: float = -2.0):
    """Trials of a run: the control, then truth, heading, CTE and a delay as far as given."""
    made = [Trial(run_id=f'run-{index}', word='as-recorded', passed=control > 0, exact=exact,
                  robustness=RobustnessInterval.exactly(control))]
    made += [
        Trial(run_id=f'run-{index}', word=word, passed=passed)
        for word, passed in zip((*WORDS[1:], DELAYED), answers, strict=False)
    ]
    return {trial.word: trial for trial in made}


@pytest.mark.parametrize(
    ('made', 'blame', 'suffices'),
    [
        (trials(0, True, True, True), Blame.PERCEPTION, Suffices.EITHER),
        (trials(0, True, True, False), Blame.PERCEPTION, Suffices.HEADING),
        (trials(0, True, False, True), Blame.PERCEPTION, Suffices.CTE),
        (trials(0, True, False, False), Blame.PERCEPTION, Suffices.NEITHER),
        (trials(0, False, False, False), Blame.CONTROLLER, Suffices.NEITHER),
        (trials(0, True), Blame.PERCEPTION, Suffices.UNKNOWN),
        (trials(0, None, True, True), Blame.UNKNOWN, Suffices.EITHER),
        (trials(0), Blame.UNKNOWN, Suffices.UNKNOWN),
        ({}, Blame.UNKNOWN, Suffices.UNKNOWN),
        (trials(0, True, True, True, control=-2.0000001), Blame.NOT_REPRODUCED, Suffices.EITHER),
        (trials(0, True, True, True, control=1.0), Blame.NOT_REPRODUCED, Suffices.EITHER),
        (trials(0, True, exact=False, control=-1.9), Blame.PERCEPTION, Suffices.UNKNOWN),
        (trials(0, True, exact=False, control=0.1), Blame.NOT_REPRODUCED, Suffices.UNKNOWN),
    ],
)
def test_given_trials_then_the_verdict_follows(made, blame, suffices):
    case = judge_case(row(0), made)
    assert (case.blame, case.suffices) == (blame, suffices)


def found(answers, *, words=WORDS, chosen_by='random', failed=None, **kinds):
    cases = tuple(
        judge_case(row(index), {
            word: trial for word, trial in trials(index, *given, **kinds).items() if word in words
        }) for index, given in enumerate(answers)
    )
    return Localisation(
        spec='phi_eventually', perception='original', failed=failed or len(cases),
        runs=4 * len(cases), chosen_by=chosen_by, words=words, cases=cases,
    )


def said(*given, **kinds) -> str:
    return ' '.join(localisation_sentences(found(*given, **kinds)))


@pytest.mark.parametrize(('answers', 'parts'), [
    ([(True, True, False)] * 3 + [(True, False, False)], (
        'All 4 failed runs satisfy phi_eventually when driven again with perfect estimates',
        # Clopper and Pearson, 4 of 4: the lower end is 0.025 ** (1 / 4).
        f'{100 * 0.025**0.25:.0f}–100 %): the network is at fault, not the controller',
        'With a perfect heading error alone 3 of 4 pass: 75 % (19–99 %).',
        '3 pass with a perfect heading error alone, 1 passes only if both estimates are perfect')),
    ([(True, True, True), (False, False, False), (False, False, False)], (
        'With perfect estimates 1 of 3 failed runs satisfy', 'The others fail too')),
    ([(False, False, False)] * 2, (
        'All 2 failed runs fail with perfect estimates too', 'a better network would not help')),
])
def test_given_answers_then_network_law_or_both_are_to_blame(answers, parts):
    words = said(answers)
    for part in parts:
        assert part in words
    assert 'examined' not in words


def test_given_another_perception_then_its_share_is_told_beside_what_the_truth_shows():
    words = said([(True, True, True, True), (True, True, True, False)], words=(*WORDS, DELAYED))
    assert "With the network's estimate of 0.5 s ago 1 of 2 passes: 50 % (1–99 %)." in words
    assert words.count('With ') == 3


def test_given_runs_that_are_not_as_recorded_then_they_are_named_and_in_no_share():
    mixed = found([(True, True, True)] * 3, control=-2.5)
    assert [case.row.index for case in mixed.not_reproduced] == [0, 1, 2]
    assert mixed.passing('truth')[:2] == (0, 0)
    words = ' '.join(localisation_sentences(mixed))
    assert 'so nothing can be concluded' in words
    assert '3 of 3 did not come out as recorded (run-0, run-1, run-2)' in words


def test_given_a_biased_choice_a_sample_or_scenes_of_the_record_then_the_reader_is_told():
    words = said([(True, True, True)] * 2, chosen_by='ce', failed=50, exact=False)
    assert '2 of the 50 failed runs were examined' in words
    assert 'chosen by ce' in words
    assert '2 runs had no bag' in words


def test_given_a_localisation_then_json_table_and_picture_hold_it(tmp_path):
    one = found([(True, True, False), (False, False, None)], words=(*WORDS, 'delayed:0.5'))
    text = json.dumps(localisation_json(one), allow_nan=False)
    values = json.loads(text)
    assert values['blame'] == {'perception': 1, 'controller': 1, 'not reproduced': 0, 'unknown': 0}
    assert values['suffices']['heading'] == 1
    assert [s['judged'] for s in values['substitutions']] == [2, 2, 2, 1, 0]
    csv, parquet = write_cases(one, tmp_path)
    frame = pd.read_parquet(parquet)
    assert list(frame['run_id']) == list(pd.read_csv(csv)['run_id']) == ['run-0', 'run-1']
    assert list(frame['blame']) == ['perception', 'controller']
    assert frame['passed_truth_cte'].isna().tolist() == [False, True]
    report = localisation_report(one)
    (section,) = report.sections
    assert [line[2:4] for line in section.tables[0].rows] == [
        (0, 2), (1, 2), (1, 2), (0, 1), (0, 0)]
    assert math.isnan(section.tables[0].rows[-1][4])
    for theme in (LIGHT, DARK):
        image = png_bytes(section.pictures[0], theme)
        assert image == png_bytes(section.pictures[0], theme)
        assert len(image) > 5000


def test_given_counterexamples_with_bags_then_the_worst_of_each_fault_is_shown_the_worst_first(
    tmp_path,
):
    answers = [(True,), (False,), (True,), (False,), (True,)]
    rhos = (-2.0, -5.0, -9.0, -3.0, -30.0)
    cases = [
        judge_case(
            dataclasses.replace(row(index, rho), bag=f'run-{index}'),
            trials(index, *given, control=rho),
        )
        for index, (given, rho) in enumerate(zip(answers, rhos, strict=True))
    ]
    one = dataclasses.replace(found(answers), cases=tuple(cases))
    assert worst_cases(one, tmp_path) == (), 'no bag, no picture'
    for index in range(4):  # the bag of the worst run of all is gone
        (tmp_path / f'run-{index}').mkdir()
        (tmp_path / f'run-{index}' / f'run-{index}_0.mcap').touch()
    worst = worst_cases(one, tmp_path)
    assert [case.row.run_id for case in worst] == ['run-2', 'run-1']
    report = localisation_report(one, worst, tmp_path)
    assert (report.worst, list(report.runs), report.rho) == (
        'run-2', ['run-2', 'run-1'], {'run-2': -9.0, 'run-1': -5.0})
    assert report.worst_words == "The worst run, the network's fault"
    blamed = localisation_report(one, worst[1:], tmp_path)
    assert blamed.worst_words == 'The worst run, not the fault of the network'
