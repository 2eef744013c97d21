import dataclasses
import random

from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.study.acceptance import decide

ALPHA = 0.05


def row(index: int, rho: float, **changes) -> RunRow:
    scene = {
        'cross_track': 0.0, 'distance': 100.0 * (index % 20), 'heading': 0.0, 'clouds': 'clear',
        'rain': 0.0, 'time_of_day': 6 + index % 12, 'left_runway': False,
    }
    return RunRow(
        run_id=f'r{index}', index=index, program='s', seed=0, perception='p',
        outcome=Outcome.PASS if rho > 0 else Outcome.FAIL, rho={'phi': rho},
        **{**scene, **changes},
    )


def rows(*rhos: float, **changes) -> list[RunRow]:
    return [row(index, rho, **changes) for index, rho in enumerate(rhos)]


def test_given_far_fewer_failures_then_the_candidate_is_accepted():
    made = decide(rows(*[-1.0] * 8, *[1.0] * 92), rows(*[1.0] * 100), ALPHA)
    assert (made.accepted, made.failed_before, made.failed_now) == (True, 8, 0)
    assert (made.only_before, made.only_now, made.pairs) == (8, 0, 100)
    assert made.failures_p == 2 * 0.5**8
    assert made.why.startswith('fails less often (p 0.0078)')


def test_given_a_few_failures_less_then_that_is_no_proof():
    made = decide(rows(*[-1.0] * 4, *[1.0] * 96), rows(*[1.0] * 100), ALPHA)
    # Four pairs are not enough: 2 * 0.5**4 = 0.125; and the ranks of rho rest on the same four.
    assert (made.accepted, made.failures_p) == (False, 0.125)


def test_given_as_many_failures_and_a_better_robustness_then_it_is_accepted():
    chance = random.Random(1)
    before = [chance.gauss(1.0, 0.2) for _ in range(60)]
    now = [rho + 0.05 + chance.gauss(0, 0.05) for rho in before]
    made = decide(rows(*before), rows(*now), ALPHA)
    assert made.accepted
    assert 0 < made.rho_low <= made.rho_change <= made.rho_high
    assert 'nearer to the centreline' in made.why
    assert not decide(rows(*now), rows(*before), ALPHA).accepted


def test_given_better_rho_but_one_failure_more_then_it_is_rejected():
    made = decide(rows(*[0.5] * 60), rows(*[0.9] * 59, -0.1), ALPHA)
    assert (made.accepted, made.why) == (False, 'fails more often')


def test_given_fewer_failures_but_more_runs_off_the_runway_then_it_is_rejected():
    before = rows(*[-1.0] * 20, *[1.0] * 80)
    now = rows(*[1.0] * 99, -9.0)
    now[99] = dataclasses.replace(now[99], left_runway=True)
    made = decide(before, now, ALPHA)
    assert (made.accepted, made.off_before, made.off_now) == (False, 0, 1)
    assert 'leaves the runway more often (1 runs, not 0)' in made.why


def test_given_fewer_failures_in_all_but_more_at_one_hour_then_the_place_is_named():
    """40 failures mended at 12-15 h, 12 new ones at 6-9 h."""
    def campaign(failed: set[int]) -> list[RunRow]:
        return [
            row(index, -1.0 if index in failed else 1.0, distance=50.0,
                time_of_day=7.0 if index < 100 else 13.0)
            for index in range(200)
        ]
    made = decide(campaign(set(range(100, 140))), campaign(set(range(12))), ALPHA)
    assert made.failures_p < 0.001
    assert (made.accepted, made.worse) == (False, ('from 6 h',))


def test_given_scenes_that_only_one_of_them_was_judged_on_then_they_do_not_count():
    before, now = rows(*[-1.0] * 10, *[1.0] * 30), rows(*[1.0] * 40)
    assert decide(before[5:], now, ALPHA).pairs == 35
    assert decide(before, now[:20], ALPHA).pairs == 20


def test_given_no_pair_then_nothing_is_accepted_and_nothing_breaks():
    made = decide([], [], ALPHA)
    assert (made.accepted, made.pairs, made.satisfied_low) == (False, 0, 0.0)
    assert made.to_json()['rho_change'] is None


@given(st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2)), max_size=40))
def test_given_any_runs_then_never_both_directions_are_accepted(pairs):
    before, now = rows(*(one for one, _ in pairs)), rows(*(other for _, other in pairs))
    assert not (decide(before, now, ALPHA).accepted and decide(now, before, ALPHA).accepted)


@given(st.lists(st.floats(-2, 2), max_size=40))
def test_given_equal_runs_then_the_incumbent_stays(rhos):
    assert not decide(rows(*rhos), rows(*rhos), ALPHA).accepted
