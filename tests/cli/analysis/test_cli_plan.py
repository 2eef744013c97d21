"""``taxinet plan``: its numbers, its words, and which runs may count."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from taxinet_ros.analysis.gate.criteria import GateOptions, Look, Verdict, gate_result
from taxinet_ros.analysis.plan import Claim, hopeless, plan_claim
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.row import RunRow

CLAIM = Claim(criterion='min-satisfaction', threshold=0.9)


def campaign(passed: int, failed: int, **changes) -> RecordedCampaign:
    rows = []
    for index in range(passed + failed):
        good = index < passed
        values = {
            'run_id': f'run-{index}', 'index': index, 'program': 'p', 'seed': 1,
            'perception': 'truth', **Scenario().to_human(), 'left_runway': not good,
            'robustness': exact_intervals({'phi': 1.0 if good else -1.0}), **changes,
        }
        rows.append(RunRow(outcome=Outcome.PASS if good else Outcome.FAIL, **values))
    content = CampaignContent(rows=tuple(rows), facts={'runs': len(rows)})
    return RecordedCampaign(folder=Path('made'), content=content)


def test_given_the_claim_of_the_rule_of_three_then_its_numbers_are_printed(taxinet):
    code, said, _ = taxinet('plan', '--min-satisfaction', 0.999)
    assert code == 0
    assert '       0  2,995\n       1  4,742\n' in said
    assert ('if you may look again: 3,688 runs of a new campaign, a number fixed beforehand, '
            'without a failure: taxinet gate --min-satisfaction 0.999\n') in said
    assert 'chance' not in said


def test_given_an_assumed_share_then_chances_and_a_sequential_test_are_there(taxinet):
    code, said, _ = taxinet(
        'plan', '--max-off-runway', 0.05, '--if-true', 0.005, '--power', 0.95, '--json')
    found = json.loads(said)
    assert code == 0
    assert found['with_power']['chance'] >= 0.95
    assert found['sequential']['test'] == 'max-off-runway=0.05,design=0.005'
    assert found['sequential']['at_limit']['passes'] <= 0.05
    assert found['sequential']['if_true']['mean_runs'] < found['with_power']['runs']


def test_given_runs_so_far_then_the_further_ones_are_those_of_gate(taxinet):
    code, said, _ = taxinet('plan', '--min-satisfaction', 0.999, '--so-far', '4000:6')
    assert code == 0
    assert 'so far 6 of 4,000 runs failed, 0.15 %' in said
    assert 'at this share the claim is false' in said
    assert '13,215 more runs, without a failure' in said
    assert 'to decide: about 85,000 more runs needed if the share stays the same' in said
    assert 'by --sequential alone, 12,080 without a failure' in said
    code, said, _ = taxinet('plan', '--min-satisfaction', 0.99, '--so-far', '4000:6')
    assert 'the claim holds already: taxinet gate --min-satisfaction 0.99' in said


@pytest.mark.parametrize(('passed', 'open_ended'), [
    (30, False), (30, True), (1, False), (60, True),
])
def test_gate_and_plan_count_the_same_further_runs(passed, open_ended):
    runs = campaign(passed, 0)
    options = GateOptions(min_satisfaction=0.9)
    planned = 10 if open_ended else passed
    content = dataclasses.replace(runs.content, facts={'runs': planned})
    plan = plan_claim(CLAIM, dataclasses.replace(runs, content=content))
    criterion = gate_result(runs.rows, options, planned=planned).criteria[0]
    further = plan.further[0].drawn
    assert further == (criterion.more_runs or 0)
    # With them the gate passes, and with one fewer it does not.
    for more, verdict in ((further, Verdict.PASS), (further - 1, Verdict.INCONCLUSIVE)):
        if more >= 0 and further:
            rows = campaign(passed + more, 0).rows
            assert gate_result(rows, options, planned=planned).verdict is verdict


def test_thirty_satisfied_runs_are_told_alike_by_gate_and_plan(tmp_path, taxinet):
    found = gate_result(campaign(30, 0).rows, GateOptions(min_satisfaction=0.9), planned=30)
    assert found.criteria[0].sentence == (
        '100.00 % of 30 runs are satisfied: at least 88.43 % and at most 100.00 % (97.5 % '
        'one-sided each, as you may look again; if you look once, --planned: 90.50 % and 100.00 '
        '%); 14 more runs needed, without a failure')
    once = gate_result(campaign(30, 0).rows, GateOptions(
        min_satisfaction=0.9, look=Look.PLANNED), planned=30)
    assert once.verdict is Verdict.PASS
    assert 'at least 90.50 % and at most 100.00 % (95 % one-sided each, as you look once)' in (
        once.criteria[0].sentence)


def test_a_plan_of_another_confidence_prints_a_gate_of_that_confidence(taxinet):
    _, said, _ = taxinet('plan', '--min-satisfaction', 0.9, '--confidence', 0.8, '--so-far', '9:0')
    gates = [line for line in said.splitlines() if 'taxinet gate' in line]
    assert len(gates) == 3
    assert all('--min-satisfaction 0.9 --confidence 0.8' in line for line in gates)


def test_a_plan_says_which_numbers_are_for_a_new_campaign_and_which_count_on(taxinet):
    _, said, _ = taxinet('plan', '--min-satisfaction', 0.9, '--so-far', '36:0')
    before, after = said.split('\nso far 0 of 36 runs failed')
    assert 'if you may look again: 36 runs of a new campaign, a number fixed beforehand' in before
    assert '\n8 more runs, without a failure\n' in after
    assert 'these count on from the runs that you have seen, and you may look again: ' in after
    assert after.endswith('The numbers before "so far" are for a new campaign, by itself\n')


def test_given_a_campaign_then_only_what_the_program_itself_drew_counts():
    plain = plan_claim(CLAIM, campaign(95, 5))
    assert (plain.found.drawn, plain.found.drawn_hits) == (100, 5)
    assert plain.likely is not None
    assert plain.likely.chance >= 0.9
    with pytest.raises(UsageError, match='no rate from this search: grid chose all'):
        plan_claim(CLAIM, campaign(95, 5, sampler='grid', drawn=False))
    searched = campaign(95, 5, sampler='active')
    rows = tuple(
        dataclasses.replace(row, drawn=row.index % 4 == 0) for row in searched.rows)
    searched = dataclasses.replace(
        searched, content=dataclasses.replace(searched.content, rows=rows))
    partly = plan_claim(CLAIM, searched)
    assert (partly.found.drawn, partly.found.runs) == (25, 100)
    assert partly.further[0].runs == 4 * partly.further[0].drawn


def test_given_a_campaign_that_refutes_the_claim_then_that_is_known():
    assert hopeless(plan_claim(CLAIM, campaign(50, 50)))
    assert not hopeless(plan_claim(CLAIM, campaign(88, 12)))
    off = Claim(criterion='max-off-runway', threshold=0.1)
    assert hopeless(plan_claim(off, campaign(50, 50)))
