"""The monitor's reading: intervals, verdicts, and runs that are not valid."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from taxinet_ros.core.mtl import (
    SHIPPED,
    Monitor,
    Reading,
    RobustnessInterval,
    Verdict,
    parse_spec,
    robustness,
)
from taxinet_ros.errors import UsageError

S = 1_000_000_000
HORIZON = 30 * S
INF = math.inf


def watch(
    values: list[float],
    spec: str = 'phi_eventually',
    period_ns: int = S,
    horizon_ns: int = HORIZON,
    max_gap_ns: int | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    rates: Mapping[str, float] | None = None,
) -> tuple[Monitor, list[Reading]]:
    monitor = Monitor(parse_spec(spec), horizon_ns, bounds, rates, max_gap_ns)
    return monitor, [monitor.push(i * period_ns, {'cte': v}) for i, v in enumerate(values)]


def test_given_a_truncated_run_when_it_ends_early_then_it_has_no_rho() -> None:
    monitor, readings = watch([6.0] * 4 + [0.25])
    assert readings[-1] == Reading(
        lower=-INF,
        upper=1.5,
        verdict=Verdict.UNKNOWN,
        final=False,
        valid=True,
        samples=5,
        rejected=0,
    )
    assert monitor.reading is readings[-1]


def test_given_phi_always_when_it_is_broken_then_the_verdict_comes_at_once() -> None:
    _, readings = watch([0.0, 1.0, 2.0, 0.0], 'phi_always')
    assert [r.verdict.name for r in readings] == ['UNKNOWN', 'UNKNOWN', 'VIOLATED', 'VIOLATED']
    assert [r.upper for r in readings] == [1.5, 0.5, -0.5, -0.5]
    assert {r.lower for r in readings} == {-INF}
    assert not readings[-1].final


def test_given_phi_eventually_when_late_by_one_sample_then_it_is_violated_after_10_s() -> None:
    _, readings = watch([8.0] * 10 + [1.0] * 5 + [2.0] + [0.0] * 15)
    verdicts = [r.verdict for r in readings]
    assert len(verdicts) == 31
    assert verdicts.index(Verdict.VIOLATED) == 15
    assert readings[15].upper == -0.5
    assert readings[-1].lower == readings[-1].upper == -0.5
    assert [r.final for r in readings] == [False] * 30 + [True]


def test_given_phi_eventually_when_settled_then_it_is_satisfied_at_the_horizon_only() -> None:
    _, readings = watch([8.0] * 5 + [0.5] * 26)
    assert [r.verdict for r in readings] == [Verdict.UNKNOWN] * 30 + [Verdict.SATISFIED]
    assert (readings[-1].lower, readings[-1].upper, readings[-1].final) == (1.0, 1.0, True)


def test_given_rho_of_zero_when_final_then_it_is_marginal() -> None:
    _, readings = watch([1.5] * 31, 'phi_always')
    assert readings[-1].verdict is Verdict.MARGINAL
    assert [v.value for v in Verdict] == [0, 1, 2, 3]


def test_given_jittered_stamps_when_the_clock_passes_the_horizon_then_it_closes_on_offline() -> (
    None
):
    rng = np.random.default_rng(7)
    stamps = np.arange(300) * (S // 10) + rng.integers(0, 30_000_000, 300)
    values = 8 * np.exp(-np.arange(300) / 30) * np.cos(np.arange(300) / 7)
    spec = SHIPPED['phi_eventually']
    monitor = Monitor(spec, HORIZON, max_gap_ns=3 * S // 10)
    for stamp, value in zip(stamps.tolist(), values.tolist(), strict=True):
        assert not monitor.push(stamp, {'cte': value}).final
    reading = monitor.push(HORIZON + 1, {})
    assert reading.final
    assert reading.lower == reading.upper == robustness(spec.formula, stamps, {'cte': values})
    assert reading.samples == 300
    assert monitor.push(HORIZON + 2, {'cte': math.nan}) == reading


@pytest.mark.parametrize('bad', [math.nan, INF, -INF])
def test_given_a_value_that_is_not_finite_when_pushed_then_the_run_never_passes(
    bad: float,
) -> None:
    _, readings = watch([0.0] * 5 + [bad] + [0.0] * 25, 'phi_always')
    assert all(r.valid for r in readings[:5])
    for reading in readings[5:]:
        assert (reading.valid, reading.verdict, reading.final) == (False, Verdict.UNKNOWN, False)
    assert (readings[-1].samples, readings[-1].rejected) == (5, 1)
    assert (readings[-1].lower, readings[-1].upper) == (-INF, 1.5)


def test_given_a_violated_run_when_a_sample_is_refused_then_the_verdict_is_withdrawn() -> None:
    _, readings = watch([9.0, math.nan, 0.0], 'phi_always')
    assert [r.verdict for r in readings] == [Verdict.VIOLATED, Verdict.UNKNOWN, Verdict.UNKNOWN]


def test_given_a_sample_from_the_run_when_the_clock_had_left_it_then_it_is_not_valid() -> None:
    monitor, _ = watch([0.0] * 30, 'phi_always')
    assert monitor.push(HORIZON + 1, {}).verdict is Verdict.SATISFIED
    late = monitor.push(HORIZON, {'cte': 0.0})
    assert (late.valid, late.verdict, late.rejected) == (False, Verdict.UNKNOWN, 1)


@pytest.mark.parametrize(
    ('stamps', 'valid'),
    [
        ([0, S, 2 * S, 3 * S], True),
        ([S, 2 * S, 3 * S], True),
        ([S + 1, 2 * S, 3 * S], False),
        ([0, S, 2 * S + 1, 3 * S], False),
        ([0, S, 2 * S, 3 * S + 1], False),
        ([0, S, 2 * S + 1, 3 * S + 1], False),
    ],
)
def test_given_a_longest_gap_when_it_is_exceeded_then_the_run_is_not_valid(
    stamps: list[int], valid: bool
) -> None:
    monitor = Monitor(SHIPPED['phi_always'], 3 * S, max_gap_ns=S)
    for stamp in stamps:
        reading = monitor.push(stamp, {'cte': 0.0})
    assert (reading.valid, reading.final, reading.rejected) == (valid, valid, 0)
    assert reading.verdict is (Verdict.SATISFIED if valid else Verdict.UNKNOWN)


def test_given_no_samples_when_the_clock_passes_the_horizon_then_there_is_no_rho() -> None:
    reading = Monitor(SHIPPED['phi_always'], HORIZON).push(HORIZON + 1, {})
    assert (reading.final, reading.valid, reading.verdict) == (False, False, Verdict.UNKNOWN)


def test_given_bounds_when_pushed_then_the_lower_end_is_finite() -> None:
    monitor, readings = watch([0.0, 3.0, 39.0], 'phi_always', bounds={'cte': (-40.0, 40.0)})
    assert [r.lower for r in readings] == [-38.5, -38.5, -38.5]
    assert [r.trusted for r in readings] == [True] * 3
    assert monitor.breach == ''


@pytest.mark.parametrize(
    ('limits', 'breach'),
    [
        ({'bounds': {'cte': (-2.0, 2.0)}}, 'at 2 s cte is 3, bounds are -2:2'),
        ({'rates': {'cte': 1.5}}, 'at 2 s cte changes by 3 in 1 s, its rate is 1.5 per s'),
        ({'rates': {'cte': 1.5, 'he': 0.0}}, 'at 2 s cte changes by 3 in 1 s'),
    ],
)
def test_given_a_broken_assumption_when_pushed_then_the_interval_is_that_without_it(
    limits: dict[str, dict[str, float]], breach: str
) -> None:
    values = [0.0, 0.0, 3.0, *[0.5] * 28]
    monitor, readings = watch(values, **limits)
    _, without = watch(values)
    assert readings[1].lower > without[1].lower == -INF
    assert [r.trusted for r in readings] == [True] * 2 + [False] * 29
    assert [r._replace(trusted=True) for r in readings[2:]] == without[2:]
    assert (readings[-1].valid, readings[-1].final, readings[-1].lower) == (True, True, 1.0)
    assert monitor.breach.startswith(breach)


def test_given_a_rate_when_the_end_is_near_then_satisfaction_is_known_early() -> None:
    _, readings = watch([0.0] * 31, 'phi_always', rates={'cte': 1.0})
    verdicts = [r.verdict for r in readings]
    assert verdicts.index(Verdict.SATISFIED) == 29
    assert readings[28].lower == pytest.approx(-0.5, abs=1e-4)


@pytest.mark.parametrize('jump', [1.5, -1.5])
def test_given_a_rate_when_a_sample_jumps_then_it_is_trusted_no_more(jump: float) -> None:
    _, readings = watch([0.0, 1.0, 1.0 + jump], 'phi_always', rates={'cte': 1.0})
    assert [r.trusted for r in readings] == [True, True, False]
    assert [r.lower for r in readings[:2]] == [pytest.approx(-28.5, abs=1e-3)] * 2
    assert readings[2].lower == -INF


def test_given_a_signal_at_its_rate_when_pushed_then_rounding_never_widens_the_interval() -> None:
    values = [1.0 + 0.7 * i * 0.1 for i in range(301)]
    _, readings = watch(values, 'always(cte <= 22)', S // 10, rates={'cte': 0.7})
    lowers = [r.lower for r in readings]
    assert len(lowers) == 301
    assert lowers == sorted(lowers)
    assert all(r.valid for r in readings)


def test_given_bounds_when_a_window_may_stay_empty_then_the_lower_end_is_infinite() -> None:
    spec, bounds = 'always[5:10](eventually[2:5](cte <= 1))', {'cte': (-3.0, 3.0)}
    _, readings = watch([0.0] * 8, spec, bounds=bounds)
    assert [r.lower for r in readings] == [-INF] * 8


def test_given_a_goal_that_stays_reached_when_reached_then_it_is_satisfied_at_once() -> None:
    _, readings = watch([0.0, 0.0, 6.0, 0.0], 'eventually[0:10](always(once(cte >= 5)))')
    assert [r.verdict for r in readings] == [Verdict.UNKNOWN] * 2 + [Verdict.SATISFIED] * 2
    assert [r.lower for r in readings] == [-5.0, -5.0, 1.0, 1.0]


def test_given_an_old_sample_decided_late_when_later_ones_are_higher_then_it_still_counts() -> None:
    text = 'always[0:10](eventually[0:3]((always[0:8](he >= 0)) or (cte >= 0)))'
    monitor = Monitor(parse_spec(text), 20 * S)
    for t in range(21):
        sample = {'he': -3.0 if t < 6 else 5.0, 'cte': 10.0 if t in (2, 9) else -20.0}
        reading = monitor.push(t * S, sample)
    assert (reading.lower, reading.upper, reading.final) == (5.0, 5.0, True)


def test_given_a_sample_without_a_signal_when_pushed_then_it_raises() -> None:
    with pytest.raises(UsageError, match="phi_always reads 'cte', the sample has he"):
        Monitor(SHIPPED['phi_always'], HORIZON).push(0, {'he': 0.0})


@pytest.mark.parametrize(
    ('kwargs', 'message'),
    [
        ({'horizon_ns': 0}, 'horizon is 0 ns'),
        ({'horizon_ns': 1, 'max_gap_ns': 0}, 'max_gap is 0 ns'),
        ({'horizon_ns': 1, 'bounds': {'cte': (1.0, 0.0)}}, 'bounds of cte'),
        ({'horizon_ns': 1, 'bounds': {'cte': (math.nan, 0.0)}}, 'bounds of cte'),
        ({'horizon_ns': 1, 'bounds': {'cte': (INF, INF)}}, 'bounds of cte'),
        ({'horizon_ns': 1, 'rates': {'cte': -1.0}}, 'rate of cte'),
        ({'horizon_ns': 1, 'rates': {'cte': INF}}, 'rate of cte'),
        ({'horizon_ns': 1, 'rates': {'lateral': 1.0}}, "unknown signal 'lateral'; known: cte"),
    ],
)
def test_given_bad_settings_when_made_then_it_raises(kwargs: dict[str, int], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Monitor(SHIPPED['phi_always'], **kwargs)


@pytest.mark.parametrize(('rho', 'words', 'bound'), [
    (-0.0004, 'rho -0.0004', 'rho -0.0004'), (0.004, 'rho +0.004', 'rho +0.004'),
    (-1e-9, 'rho -1e-09', 'rho -1e-09'), (0.0, 'rho +0.000', 'rho +0.00'),
    (-0.0, 'rho +0.000', 'rho +0.00'), (-0.5, 'rho -0.500', 'rho -0.50'),
    (-math.inf, 'rho -inf', 'rho -inf'),
])
def test_given_a_robustness_near_zero_when_shown_then_its_sign_means_something(
    rho: float, words: str, bound: str
) -> None:
    known = RobustnessInterval.exactly(rho)
    assert (known.words(), known.bound_words()) == (words, bound)
    beyond = RobustnessInterval(rho, 100.0).words()
    assert beyond == f'rho within [{words.removeprefix("rho ")}, +100.000]'


@pytest.mark.parametrize(
    ('lower', 'upper', 'verdict'),
    [
        (0.5, INF, Verdict.SATISFIED),
        (-INF, -0.5, Verdict.VIOLATED),
        (0.0, 0.0, Verdict.MARGINAL),
        (0.0, 1.0, Verdict.UNKNOWN),
        (-1.0, 0.0, Verdict.UNKNOWN),
        (INF, INF, Verdict.UNKNOWN),
        (-INF, -INF, Verdict.UNKNOWN),
    ],
)
def test_given_an_interval_when_judged_then_only_what_is_sure_counts(
    lower: float, upper: float, verdict: Verdict
) -> None:
    assert RobustnessInterval(lower, upper).verdict is verdict


def test_given_nan_when_judged_then_it_raises() -> None:
    with pytest.raises(UsageError, match='no interval'):
        _ = RobustnessInterval.exactly(math.nan).verdict
