"""An experiment's arms run by run: what is counted, said and drawn."""

from __future__ import annotations

import json

import pytest

from taxinet_ros.analysis.experiment_report import (
    experiment_json,
    experiment_report,
    experiment_sentences,
)
from taxinet_ros.analysis.paired_arms import PairedArms, paired_arms, pairs_frame
from taxinet_ros.analysis.picture_files import LIGHT, png_bytes
from taxinet_ros.campaign.experiment_file import Arm, Experiment
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.scenario import Scenario

ASKED = Experiment(
    name='shadows', program='p', runs=12, seed=0, sampler='halton', sampler_options={},
    specs=('phi_eventually',), overrides={}, over='', compare_to='on',
    arms=(Arm(name='on', perception='original'),
          Arm(name='off', perception='original', laid_over={'shadows': 'off'})),
)


def row(index: int, rho: float | None, *, shadows: bool, settled: bool = True) -> RunRow:
    scene = Scenario(time_of_day_s=(6 + index) * 3600.0, shadows=shadows)
    if rho is None:
        return RunRow(run_id=f'r-{index}', index=index, program='p', seed=0, perception='original',
                      outcome=Outcome.INFRA_ERROR, kind='died', **scene.to_human())
    return RunRow(
        run_id=f'r-{index}', index=index, program='p', seed=0, perception='original',
        outcome=Outcome.PASS if rho > 0 else Outcome.FAIL, rho={'phi_eventually': rho},
        left_runway=rho < -10, max_cross_track_m=2.0 - rho,
        settle_time_s=4.0 if settled and rho > 0 else None, **scene.to_human(),
    )


def found(on: list[float | None], off: list[float | None]) -> PairedArms:
    return paired_arms(ASKED, {
        'on': tuple(row(index, rho, shadows=True) for index, rho in enumerate(on)),
        'off': tuple(row(index, rho, shadows=False) for index, rho in enumerate(off)),
    })


WORSE = found([-1.0] * 7 + [-20.0] + [1.0] * 4, [0.5] * 8 + [1.0] * 4)


def test_given_two_arms_then_pairs_are_counted_by_scene():
    (one,) = WORSE.comparisons
    rates = one.satisfied
    assert (rates.both, rates.only_first, rates.only_second, rates.neither) == (4, 0, 8, 0)
    assert rates.p_value == pytest.approx(2 / 2**8)
    # The middle of 78 means: of 4 zeros, seven times 1.5 and once 20.5.
    assert one.rho.change.value == pytest.approx(1.5)
    assert (one.rho.more, one.rho.less) == (8, 0)
    assert (one.off_runway.first, one.off_runway.second) == (1, 0)
    assert (one.settled.first, one.settled.second, one.settle_time_s.pairs) == (4, 12, 4)
    assert (WORSE.over, WORSE.alone) == ('time_of_day', True)


def test_given_a_clear_difference_then_it_is_said_and_otherwise_not():
    words = ' '.join(experiment_sentences(WORSE))
    assert words.startswith('Clearly more runs are satisfied in off than in on.')
    assert 'Of 12 scenes 4 satisfy phi_eventually in on (33 %) and 12 in off (100 %)' in words
    assert '+66.7 points (95 % interval' in words
    assert '8 are satisfied in off only, 0 in on only' in words
    equal = ' '.join(experiment_sentences(found([1.0, -1.0], [1.0, -1.0])))
    assert equal.startswith('No difference between on and off is proven.')
    shifted = ' '.join(experiment_sentences(found([0.5] * 9, [1.0] * 9)))
    assert shifted.startswith('Rho is greater in off than in on, but how many')


def test_given_runs_that_were_not_judged_then_their_scenes_are_in_no_pair():
    some = found([1.0, None, 1.0], [1.0, 1.0])
    (one,) = some.comparisons
    assert (len(one.pairs), one.unpaired) == (1, 2)
    assert 'Runs of on without verdict, whose scenes are in no pair: 1 INFRA_ERROR (1 died).' in [
        *experiment_sentences(some)]
    nothing = found([None], [None])
    assert 'nothing can be said' in ' '.join(experiment_sentences(nothing))


def test_given_an_experiment_then_report_json_and_table_hold_it():
    report = experiment_report(WORSE)
    arms, pairs = report.sections
    assert arms.tables[0].rows[0] == ('on', 12, 4, pytest.approx(100 / 3), 1, -1.0, 0)
    assert pairs.tables[0].rows[0][0] == 7
    assert len(pairs.tables[0].rows) == 8
    values = json.loads(json.dumps(experiment_json(WORSE), allow_nan=False))
    assert values['comparisons'][0]['satisfied']['arm_only'] == 8
    assert values['arms']['off']['PASS'] == 12
    json.dumps(experiment_json(found([None], [None])), allow_nan=False)
    frame = pairs_frame(WORSE)
    assert len(frame) == 12
    assert list(frame['outcome_on']) == ['FAIL'] * 8 + ['PASS'] * 4
    assert frame['rho_off'].min() == 0.5
    image = png_bytes(arms.pictures[0], LIGHT)
    assert image == png_bytes(arms.pictures[0], LIGHT)
    assert len(png_bytes(experiment_report(found([None], [None])).sections[0].pictures[0],
                         LIGHT)) > 3000
