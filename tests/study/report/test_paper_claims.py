"""Where it is known what is true, the verdicts on the paper's statements say it, or nothing."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
import pytest
from planted_studies import bins, on_truth, planted_study, searches, shadow_pairs
from scipy.stats import binom

from taxinet_ros.study.report.claim import (
    SIGNIFICANT,
    Claim,
    Sides,
    Verdict,
    evenly_often,
    judge,
    more_often,
    more_often_by,
    mostly_lower,
    share_above,
)
from taxinet_ros.study.report.paper import judge_claims
from taxinet_ros.study.report.results import Results

STATEMENTS = (
    'morning', 'early_morning', 'late_morning', 'clouds_morning', 'clouds_reversal',
    'original_crossing', 'halton_crossing', 'generic_crossing', 'original_start', 'halton_start',
    'original_angle', 'original_offset', 'blame', 'shadows', 'shadows_fluctuation', 'generic',
    'generic_off', 'halton', 'halton_off', 'halton_off_original', 'specialised_off_original',
    'specialised', 'specialised_crossing', 'specialised_elsewhere', 'specialised_metres',
    'generic_day', 'halton_day', 'generic_day_clouds', 'halton_day_clouds', 'learned',
    'learned_on_crossing', 'learned_at_start', 'iterative_generic', 'iterative_learned',
    'iterative_crossing', 'iterative_regression',
)

PAIRS = 120
HOURS = np.linspace(6.01, 17.99, PAIRS)
WAVES = np.where(HOURS < 12, 0.0, 0.4 + 0.3 * np.sin(20 * HOURS))
"""What a shadow takes from robustness [m] over a day: nothing before noon, then in waves."""

CALM = 1.4 + 0.001 * np.sin(7 * HOURS)


def at(scenes: pd.DataFrame, column: str, low: float, high: float) -> np.ndarray:
    return scenes[column].between(low, high, inclusive='left').to_numpy()


def by_place(crossing: float, elsewhere: float, start: float | None = None):
    """Chances at 1,200-1,600 m, elsewhere, and at 0-400 m."""
    def chance(scenes: pd.DataFrame) -> np.ndarray:
        found = np.where(at(scenes, 'distance_m', 1200, 1600), crossing, elsewhere)
        return np.where(at(scenes, 'distance_m', 0, 400), elsewhere if start is None else start,
                        found)
    return chance


def far(scenes: pd.DataFrame, column: str) -> np.ndarray:
    """Starts at an extreme angle, or far from the centreline."""
    return (scenes[column].abs() > {'heading_deg': 20, 'cross_track_m': 5}[column]).to_numpy()


def favourable(scenes: pd.DataFrame) -> np.ndarray:
    return at(scenes, 'time_of_day_h', 9.5, 12) & ~at(scenes, 'distance_m', 1200, 1600)


def original_as_in_the_paper(scenes: pd.DataFrame) -> np.ndarray:
    chance = by_place(0.95, 0.1, 0.5)(scenes)
    chance = np.where(at(scenes, 'time_of_day_h', 6, 8), 0.9, chance)
    dry, clouds = (scenes['rain_percent'] == 0).to_numpy(), scenes['clouds'].to_numpy()
    chance = np.where(dry & at(scenes, 'time_of_day_h', 7, 9) & (clouds == 'clear'), 0.1, chance)
    chance = np.where(dry & at(scenes, 'time_of_day_h', 13, 15),
                      np.where(clouds == 'clear', 0.9, 0.1), chance)
    both = far(scenes, 'heading_deg') & far(scenes, 'cross_track_m')
    late = np.where(both & ~at(scenes, 'distance_m', 1200, 1600), 0.4, 0.0)
    return np.where(at(scenes, 'time_of_day_h', 9.5, 12), late, chance)


def original_the_other_way(scenes: pd.DataFrame) -> np.ndarray:
    chance = by_place(0.1, 0.5, 0.2)(scenes)
    chance = np.where(at(scenes, 'time_of_day_h', 6, 8), 0.1, chance)
    dry, clouds = (scenes['rain_percent'] == 0).to_numpy(), scenes['clouds'].to_numpy()
    chance = np.where(dry & at(scenes, 'time_of_day_h', 7, 9) & (clouds == 'clear'), 0.9, chance)
    near = 0.5 * ~far(scenes, 'heading_deg') + 0.4 * ~far(scenes, 'cross_track_m')
    chance = np.where(favourable(scenes), near, chance)
    return np.where(dry & at(scenes, 'time_of_day_h', 13, 15) & (clouds == 'stratus'), 0.95, chance)


@cache
def as_in_the_paper(count: int) -> dict[str, Verdict]:
    """A world in which every statement is true."""
    some = slice(None) if count > 100 else slice(-4, None)
    shares = np.linspace(0.75, 0.83, 12 if count > 100 else 5)
    return verdicts(planted_study(
        count, 1, {
            'original': original_as_in_the_paper, 'generic': by_place(0.99, 0.03),
            'halton': by_place(0.98, 0.0, 0.04), 'specialised': by_place(0.6, 0.06),
            'iterative-generic': by_place(0.8, 0.01), 'iterative-crossing': by_place(1.0, 0.1),
            'iterative-learned': by_place(0.95, 0.02),
        },
        off={'original': 0.5, 'generic': 0.3, 'halton': 0.05, 'specialised': 0.05},
        localized=on_truth(min(count, 200), min(count, 200)),
        experiment_pairs=shadow_pairs((CALM - WAVES), CALM, some),
        searches=searches(*(bins(0.1, share, 0.08) for share in shares)),
    ))


@cache
def the_other_way(count: int) -> dict[str, Verdict]:
    """A world in which every statement is false."""

    def uneven(crossing: float, elsewhere: float, start: float):
        def chance(scenes: pd.DataFrame) -> np.ndarray:
            morning = at(scenes, 'time_of_day_h', 6, 9)
            return np.where(morning, 0.5, 0.0) + 0.5 * by_place(crossing, elsewhere, start)(scenes)
        return chance

    return verdicts(planted_study(
        count, 1, {
            'original': original_the_other_way, 'generic': uneven(0.0, 0.95, 0.8),
            'halton': uneven(0.0, 0.97, 0.8), 'specialised': uneven(0.6, 0.92, 0.78),
            'iterative-generic': uneven(0.6, 1.0, 0.9), 'iterative-crossing': uneven(0.0, 0.8, 0.7),
            'iterative-learned': uneven(0.1, 0.85, 0.8),
        },
        off={'original': 0.1, 'generic': 0.5, 'halton': 0.9, 'specialised': 0.9},
        localized=on_truth(100, 200), experiment_pairs=shadow_pairs(CALM, CALM - WAVES),
        searches=searches(*(bins(share, 0.02) for share in np.linspace(0.2, 0.24, 12))),
    ))


def verdicts(results: Results) -> dict[str, Verdict]:
    return {claim.name: claim.verdict for claim in judge_claims(results)}


@pytest.mark.parametrize('name', STATEMENTS)
def test_paper_given_a_statement_that_is_true_or_false_then_the_verdict_is_and_few_runs_say_nothing(
    name: str,
) -> None:
    assert as_in_the_paper(40_000)[name] is Verdict.AGREES
    assert the_other_way(4000)[name] is Verdict.DIFFERS
    assert as_in_the_paper(12)[name] is Verdict.UNCLEAR


def test_paper_given_everything_then_no_statement_is_left_out() -> None:
    assert tuple(sorted(as_in_the_paper(40_000))) == tuple(sorted(STATEMENTS))


# What a sentence says, and not what stands beside it ---------------------------------------------


def shadows(with_shadow: np.ndarray, without: np.ndarray) -> dict[str, Verdict]:
    found = verdicts(planted_study(50, 1, {}, experiment_pairs=shadow_pairs(with_shadow, without)))
    assert sorted(found) == ['shadows', 'shadows_fluctuation']
    return found


def test_paper_given_a_shadow_that_hurts_before_noon_then_the_afternoon_is_not_better() -> None:
    morning = np.where(HOURS < 12, 0.6, 0.0)
    assert shadows(CALM - morning, CALM)['shadows'] is Verdict.UNCLEAR
    afternoon = np.where(HOURS >= 12, 0.01, 0.0)
    assert shadows(CALM - morning, CALM - afternoon)['shadows'] is Verdict.DIFFERS


def test_paper_given_a_shadow_that_costs_the_same_all_afternoon_then_nothing_fluctuates() -> None:
    steady = np.where(HOURS >= 12, 0.5, 0.0)
    noise = 0.01 * np.random.default_rng(1).standard_normal((2, PAIRS))
    found = shadows(CALM - steady + noise[0], CALM + noise[1])
    assert found == {'shadows': Verdict.AGREES, 'shadows_fluctuation': Verdict.UNCLEAR}


def test_paper_given_failures_in_rain_alone_then_the_clouds_are_not_to_blame() -> None:
    def wet(scenes: pd.DataFrame) -> np.ndarray:
        stratus = (scenes['clouds'] == 'stratus').to_numpy()
        return np.where((scenes['rain_percent'] > 0).to_numpy() & stratus, 1.0, 0.1)

    found = verdicts(planted_study(4000, 2, {'original': wet}))
    assert found['clouds_morning'] is found['clouds_reversal'] is Verdict.UNCLEAR


def test_paper_given_a_bad_crossing_then_the_start_is_compared_with_the_rest_alone() -> None:
    found = verdicts(planted_study(4000, 3, {'original': by_place(0.9, 0.1, 0.2)}))
    assert (found['original_crossing'], found['original_start']) == (Verdict.AGREES,) * 2


def test_paper_given_a_late_morning_better_than_the_early_one_but_bad_then_it_does_not_work_well(
) -> None:
    def chance(scenes: pd.DataFrame) -> np.ndarray:
        return np.where(at(scenes, 'time_of_day_h', 6, 8), 0.9, 0.4)

    found = verdicts(planted_study(4000, 4, {'original': chance}))
    assert (found['morning'], found['late_morning']) == (Verdict.AGREES, Verdict.DIFFERS)


@pytest.mark.parametrize(('column', 'name'), [
    ('heading_deg', 'original_angle'), ('cross_track_m', 'original_offset'),
])
def test_a_factor_that_leads_to_failures_is_one_at_favourable_times_and_places(
    column: str, name: str,
) -> None:
    def only_there(scenes: pd.DataFrame) -> np.ndarray:
        return np.where(favourable(scenes) & far(scenes, column), 0.6, 0.2)

    def only_elsewhere(scenes: pd.DataFrame) -> np.ndarray:
        return np.where(~favourable(scenes) & far(scenes, column), 0.6, 0.2)

    for chance, verdict in ((only_there, Verdict.AGREES), (only_elsewhere, Verdict.DIFFERS)):
        assert verdicts(planted_study(20_000, 6, {'original': chance}))[name] is verdict


def test_paper_given_failures_that_stay_near_then_they_are_not_several_metres_away() -> None:
    study = planted_study(4000, 5, {'specialised': by_place(0.9, 0.0)})
    runs = study.networks['specialised'].runs
    assert verdicts(study)['specialised_metres'] is Verdict.AGREES
    near = runs.frame['rho'] < 0
    runs.frame.loc[near, 'rho'] = -0.3  # 1.8 m away
    assert verdicts(study)['specialised_metres'] is Verdict.DIFFERS


@pytest.mark.parametrize('share', [0.8, 0.9, 0.1])
def test_five_searches_that_all_learned_the_same_decide_no_statement(share: float) -> None:
    """Of five, no test that knows nothing of their distribution says less than p = 1/32."""
    five, dozen = (
        verdicts(planted_study(50, 1, {}, searches=searches(*[bins(share, 1 - share)] * count)))
        for count in (5, 12)
    )
    assert set(five.values()) == {Verdict.UNCLEAR}
    assert dozen['learned'] is Verdict.AGREES
    assert dozen['learned_on_crossing'] is (
        Verdict.DIFFERS if share > 0.5 else Verdict.AGREES)


# Over repeated studies ---------------------------------------------------------------------------


@pytest.mark.nightly
def test_paper_given_networks_that_are_all_alike_then_at_most_one_study_in_twenty_errs() -> None:
    def alike(scenes: pd.DataFrame) -> float:
        return 0.5

    names = ('original', 'generic', 'halton', 'specialised', 'iterative-generic',
             'iterative-crossing', 'iterative-learned')
    true = {'generic_day', 'halton_day', 'generic_day_clouds', 'halton_day_clouds'}
    false = {'late_morning', 'blame', 'original_angle', 'original_offset'}
    wrong, studies = 0, 50
    for seed in range(studies):
        rng = np.random.default_rng(1000 + seed)
        noise = rng.normal(1, 0.3, (2, PAIRS))
        learned = rng.dirichlet(np.ones(3), 5)
        study = planted_study(
            400, seed, dict.fromkeys(names, alike), alike=False,
            localized=on_truth(int(rng.binomial(200, 0.95)), 200),
            experiment_pairs=shadow_pairs(noise[0], noise[1]),
            searches=searches(*(bins(one[0] * 0.75, one[1] * 0.75) for one in learned)),
        )
        for name, verdict in verdicts(study).items():
            right = Verdict.AGREES if name in true else Verdict.DIFFERS if name in false else None
            if verdict not in (Verdict.UNCLEAR, right):
                wrong += 1
                break
    assert wrong <= binom.ppf(0.99, studies, SIGNIFICANT)


@pytest.mark.nightly
def test_paper_given_the_border_of_each_test_then_neither_side_is_found_more_often_than_stated(
) -> None:
    """Where a statement is neither true nor false, each side's p value is below 5 % in 5 %."""
    rng, repeats = np.random.default_rng(9), 400
    tests = {
        'share': lambda: share_above(int(rng.binomial(80, 0.95)), 80, 0.95),
        'groups': lambda: more_often(rng.random(69) < 0.4, rng.random(81) < 0.4),
        'lower': lambda: mostly_lower(rng.normal(0, 1, 60), rng.normal(0, 3, 40)),
        'even': lambda: evenly_often(
            [rng.random(100) < share for share in (0.175, 0.1, 0.1, 0.1)], 0.075
        ),
        'margin': lambda: more_often_by(rng.random(90) < 0.3, rng.random(200) < 0.2, 0.1),
    }
    most = binom.ppf(0.999, repeats, SIGNIFICANT)
    for name, test in tests.items():
        found = np.array([test() for _ in range(repeats)])
        assert found.shape == (repeats, 2)
        below = (found <= SIGNIFICANT).sum(axis=0)
        assert (below <= most).all(), f'{name}: {below} of {repeats}'


def test_paper_given_groups_that_lie_apart_then_the_lower_one_is_known() -> None:
    low, high = np.arange(20.0), 100 + np.arange(30.0)
    assert mostly_lower(low, high).if_false < 1e-9
    assert mostly_lower(high, low).if_true < 1e-9
    assert mostly_lower(low, low.copy()).if_false > SIGNIFICANT
    assert mostly_lower(np.ones(9), np.ones(9)) == (1.0, 1.0)
    many = np.arange(600.0)  # comb(1200, 600) is above the greatest float
    assert mostly_lower(many, 1000 + many) == (0.0, 1.0)


def test_paper_given_twenty_statements_of_nothing_then_one_that_is_just_significant_is_not_enough(
) -> None:
    def question(number: int, if_false: float) -> Claim:
        return Claim(name=f'{number}', statement='', source='', evidence='',
                        sides=Sides(if_false, 1 - if_false))

    alone = judge([question(0, 0.01)])
    among = judge([question(number, 0.5) for number in range(20)] + [question(20, 0.01)])
    assert alone[0].verdict is Verdict.AGREES
    assert {claim.verdict for claim in among} == {Verdict.UNCLEAR}
    assert among[-1].p_value == pytest.approx(0.42)
