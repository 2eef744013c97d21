"""Trouble and outcomes keep their meaning wherever they travel.

A run ends at the step that decides what it was run for, and not one step later.
"""

import math
import pickle

import pytest

from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.mtl import Verdict, parse_spec
from taxinet_ros.core.pacing.lockstep import Lockstep, reports_progress
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judge import Judge
from taxinet_ros.core.verdict.judging import StopOn, parse_stop_on
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError, UsageError


def test_given_trouble_in_a_worker_process_then_it_arrives_with_kind_name_and_step():
    facts = ('sim', 'simulator', 7, 'not finite')
    error = pickle.loads(pickle.dumps(InfraError(*facts)))
    assert (error.kind, error.who, error.step, error.detail) == facts
    assert str(error) == 'sim: simulator at step 7: not finite'


def test_given_the_five_outcomes_then_only_pass_and_fail_carry_a_robustness():
    assert [outcome for outcome in Outcome if outcome.judged] == [Outcome.PASS, Outcome.FAIL]
    assert len(Outcome) == 5


STEP_NS = 100_000_000
REACH = parse_spec('reach=eventually[0:0.5](abs(cte) <= 1.5)')
STAY = parse_spec('stay=always(abs(cte) <= 1.5)')
SEEN = parse_spec('seen=always(abs(cte_estimate) <= 9)')


def judged(ctes, stop_on, specs=(STAY, REACH), last_seq=10, estimates=None):
    """Push until the judge stops the run, or there is no more."""
    judge = Judge(specs, last_seq * STEP_NS, STEP_NS, stop_on)
    for seq, cte in enumerate(ctes):
        sample = dict.fromkeys(('he', 'x', 'speed', 'steering', 'he_estimate'), 0.0)
        estimate = cte if estimates is None else estimates[seq]
        judge.push(seq * STEP_NS, {**sample, 'cte': cte, 'cte_estimate': estimate})
        if judge.stopped_early:
            break
    return seq, judge.judgement


# What a run's ends are: its last step, whether it is complete, stopped early, satisfied.
ENDS = {
    'no rule: to the horizon': ([0, 2, *[0] * 9], StopOn.NEVER, (STAY, REACH), (10, 1, 0, 0)),
    'only another formula is violated':
        ([2, *[0] * 10], StopOn.VIOLATED, (REACH, STAY), (10, 1, 0, 0)),
    'the last formula is decided':
        ([2, 2, 2, 1, 0, 0, 0], StopOn.DECIDED, (REACH, STAY), (3, 0, 1, 0)),
    'all formulas are satisfied': ([2, 2, 1, 0, 0], StopOn.DECIDED, (REACH,), (2, 0, 1, 1)),
    'a robustness of at most zero': ([0, 1.5, 0], StopOn.VIOLATED, (STAY, REACH), (1, 0, 1, 0)),
    'decided at the horizon': ([*[0] * 10, 9], StopOn.VIOLATED, (STAY, REACH), (10, 1, 0, 0)),
}


@pytest.mark.parametrize('case', ENDS)
def test_given_a_rule_then_the_run_ends_at_the_step_that_decides_and_not_before(case: str) -> None:
    ctes, stop_on, specs, ends = ENDS[case]
    seq, judgement = judged(ctes, stop_on, specs)
    assert (seq, judgement.complete, judgement.stopped_early, judgement.satisfied) == ends
    if case == 'all formulas are satisfied':
        assert judgement.readings[0].lower == 0.5
    if case == 'a robustness of at most zero':
        assert judgement.readings[0].verdict is Verdict.UNKNOWN, 'zero or worse, both are failures'


def test_given_violated_when_the_headline_cannot_hold_any_more_then_the_run_ends_there() -> None:
    seq, judgement = judged([0.25, 1, 2.5, 9, 9, 9, 9, 9, 9, 9, 9], StopOn.VIOLATED)
    assert (seq, judgement.stopped_early, judgement.complete) == (2, True, False)
    assert not judgement.satisfied
    stay, reach = judgement.readings
    assert (stay.lower, stay.upper, stay.verdict) == (-math.inf, -1.0, Verdict.VIOLATED)
    assert (reach.lower, reach.upper) == (1.25, 1.5), 'the other formula is not decided'
    assert judgement.statistics.max_cross_track_m == 2.5


def test_given_an_unusable_sample_then_a_run_without_verdict_is_never_stopped() -> None:
    blind = [0, math.nan, *[0] * 9]
    seq, judgement = judged([0, 0, *[9] * 9], StopOn.VIOLATED, (STAY, SEEN), estimates=blind)
    assert (seq, judgement.complete, judgement.stopped_early) == (10, False, False)


def test_given_an_unknown_word_then_the_known_ones_are_named():
    with pytest.raises(UsageError, match='late: unknown; known: never, violated, decided'):
        parse_stop_on('late')
    assert parse_stop_on('') is StopOn.NEVER


def test_given_a_monitor_that_may_end_the_run_then_time_waits_for_it_at_every_frame():
    followers = ('monitor', 'recorder')
    protocol = Lockstep(
        participants=followers, chain=(), followers=followers, last_seq=300, enders=('monitor',)
    )
    for node in followers:
        protocol.ready(node)
    protocol.begin(0)
    assert protocol.missing() == ['monitor'], 'the recorder may lag'
    protocol.progress('monitor', 0)
    assert protocol.may_advance
    protocol.begin(1)
    protocol.end('monitor')
    assert not protocol.may_advance
    assert protocol.missing() == ['recorder']
    protocol.progress('recorder', 1)
    assert protocol.complete
    assert protocol.last_seq == 1


def test_given_a_run_that_may_end_anywhere_then_every_step_is_reported():
    assert all(reports_progress(seq, 300, StopOn.VIOLATED) for seq in range(9))
    assert not all(reports_progress(seq, 300) for seq in range(9))


def test_given_the_closed_loop_then_a_stopped_run_is_the_whole_one_cut_at_the_deciding_step():
    scene = scenario_from_human({'cross_track': 6, 'heading': 15, 'duration': 6})
    spec = parse_spec('soon=eventually[0:1](always(abs(cte) <= 1.5))')
    runs = {}
    for rule in StopOn:
        steps = []
        judgement = run_closed_loop(
            scene, make_perception('truth'), specs=[spec], stop_on=rule, on_step=steps.append
        )
        runs[rule] = steps, judgement
    whole, cut = runs[StopOn.NEVER][0], runs[StopOn.VIOLATED][0]
    deciding = next(k for k, step in enumerate(whole) if step.readings[0].upper <= 0)
    assert 0 < deciding < 60
    assert len(whole) == 61
    assert len(cut) == len(runs[StopOn.DECIDED][0]) == deciding + 1
    for one, other in zip(cut, whole, strict=False):
        assert one.observation.state == other.observation.state
        assert (one.command, one.readings) == (other.command, other.readings)
    judgement = runs[StopOn.VIOLATED][1]
    assert judgement.stopped_early
    assert judgement.readings == whole[deciding].readings
    rho = runs[StopOn.NEVER][1].readings[0].lower
    assert judgement.readings[0].lower <= rho <= judgement.readings[0].upper <= 0
