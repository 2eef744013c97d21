"""Every numbered sentence of docs/mtl.md, and every row of its table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from taxinet_ros.core.mtl import (
    SHIPPED,
    SIGNALS,
    Monitor,
    Reading,
    RobustnessInterval,
    Verdict,
    parse_formula,
    parse_spec,
    robustness,
)
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judge import Judge, check_specs
from taxinet_ros.errors import UsageError

S = 1_000_000_000
HORIZON = 30 * S
DOC = (Path(__file__).parents[3] / 'docs' / 'mtl.md').read_text(encoding='utf-8')
ROWS = re.findall(r'^\| `([^`]+)` \| ([-0-9. ]+) \| (\S+) \| ([0-9, ]+) \|$', DOC, re.MULTILINE)
SENTENCES = [int(number) for number in re.findall(r'^(\d+)\. .*', DOC.split('## Sources')[0], re.M)]
TESTED: set[int] = {int(number) for *_, numbers in ROWS for number in numbers.split(',')}


def sentence(*numbers: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Marks a test as that of numbered sentences."""
    TESTED.update(numbers)
    return lambda test: test


def rho(text: str, values: list[float], stamps: list[int] | None = None) -> float:
    stamps = [i * S for i in range(len(values))] if stamps is None else stamps
    return robustness(parse_formula(text), stamps, {'cte': values})


def sample(cte: float) -> dict[str, float]:
    return dict.fromkeys(SIGNALS, 0.0) | {'cte': cte}


def watch(stamps: list[int], values: list[float], text: str = 'phi_always') -> Reading:
    monitor = Monitor(parse_spec(text), HORIZON, max_gap_ns=S)
    for stamp, value in zip(stamps, values, strict=True):
        monitor.push(stamp, {'cte': value})
    return monitor.push(HORIZON + 1, {})


def test_given_the_document_when_its_sentences_are_counted_then_each_has_a_test() -> None:
    assert list(range(1, 22)) == SENTENCES
    assert set(SENTENCES) == TESTED


def test_given_the_document_when_its_formulas_are_read_then_they_are_the_shipped_ones() -> None:
    shipped = re.findall(r'^\| `(\w+)` \| `([^`]+)` \| [a-z]', DOC, re.MULTILINE)
    assert dict(shipped) == {name: spec.text for name, spec in SHIPPED.items()}


@pytest.mark.parametrize(('text', 'values', 'wanted', 'numbers'), ROWS)
def test_given_a_row_of_the_document_when_evaluated_then_rho_is_as_written(
    text: str, values: str, wanted: str, numbers: str
) -> None:
    cte = [float(value) for value in values.split()]
    assert rho(text, cte) == float(wanted), numbers
    monitor = Monitor(parse_spec(text), 100 * S)
    for index, value in enumerate(cte):
        monitor.push(index * S, {'cte': value})
    reading = monitor.push(100 * S + 1, {})
    assert (reading.lower, reading.upper, reading.final) == (float(wanted), float(wanted), True)


@sentence(1)
def test_given_a_crossing_between_samples_when_evaluated_then_it_does_not_exist() -> None:
    assert rho('eventually(abs(cte) <= 1)', [-9.0, 9.0]) == -8.0
    assert rho('always[1:1](cte >= 0)', [-9.0, 9.0, 3.0], [0, S - 1, S + 1]) == math.inf


@sentence(2)
def test_given_irregular_stamps_when_evaluated_then_they_place_the_samples() -> None:
    values = [9.0, 0.0, 9.0]
    assert rho('eventually[0:1](cte <= 1)', values, [0, S, 2 * S]) == 1.0
    assert rho('eventually[0:1](cte <= 1)', values, [0, S + 1, 2 * S]) == -8.0
    assert rho('eventually[0:1](cte <= 1)', values, [S // 2, S, 2 * S]) == 1.0


@sentence(13)
@pytest.mark.parametrize(
    ('value', 'verdict'),
    [(0.5, Verdict.SATISFIED), (-0.5, Verdict.VIOLATED), (0.0, Verdict.MARGINAL)],
)
def test_given_a_rho_when_judged_then_zero_is_no_success(value: float, verdict: Verdict) -> None:
    assert RobustnessInterval.exactly(value).verdict is verdict
    judge = Judge([parse_spec('phi_always')], HORIZON, S)
    for second in range(31):
        judge.push(second * S, sample(1.5 - value))
    assert judge.judgement.complete
    assert judge.judgement.satisfied is (verdict is Verdict.SATISFIED)


@sentence(14)
@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize('text', ['phi_always', 'eventually(1 / (cte - cte) >= 0)'])
def test_given_no_finite_value_when_judged_then_there_is_no_rho(bad: float, text: str) -> None:
    values = [0.0, bad, 9.0, *[0.0] * 28]
    reading = watch([i * S for i in range(31)], values, text)
    assert (reading.valid, reading.final, reading.verdict) == (False, False, Verdict.UNKNOWN)
    with pytest.raises(UsageError):
        robustness(parse_spec(text).formula, [i * S for i in range(31)], {'cte': values})


@sentence(15)
@pytest.mark.parametrize('stamps', [[0, S, S], [0, 2 * S, S], [-1], [HORIZON, HORIZON]])
def test_given_bad_stamps_when_judged_then_there_is_no_rho(stamps: list[int]) -> None:
    monitor = Monitor(SHIPPED['phi_always'], HORIZON)
    readings = [monitor.push(stamp, {'cte': 0.0}) for stamp in stamps]
    assert [reading.valid for reading in readings] == [True] * (len(stamps) - 1) + [False]
    assert readings[-1].rejected == 1
    reading = monitor.push(HORIZON + 1, {'cte': 0.0})
    assert (reading.valid, reading.final, reading.verdict) == (False, False, Verdict.UNKNOWN)
    with pytest.raises(UsageError):
        rho('always(cte <= 1)', [0.0] * len(stamps), stamps)


@sentence(16, 17)
@pytest.mark.parametrize('missing', [0, 1, 15, 30])
def test_given_a_gap_when_judged_then_there_is_no_rho(missing: int) -> None:
    stamps = [i * S // 2 for i in range(61)]
    assert watch(stamps, [0.0] * 61).verdict is Verdict.SATISFIED
    kept = [stamp for stamp in stamps if not missing * S < stamp + S <= (missing + 2) * S]
    assert len(kept) < 61
    reading = watch(kept, [0.0] * len(kept))
    assert (reading.valid, reading.final, reading.verdict) == (False, False, Verdict.UNKNOWN)


@sentence(11, 18)
def test_given_a_run_that_ends_early_when_judged_then_it_is_incomplete_and_no_pass() -> None:
    # Its finite-trace robustness is 1.2: a false pass.
    values = [6.0] * 4 + [0.3]
    assert rho(SHIPPED['phi_eventually'].text, values) == pytest.approx(1.2)
    judge = Judge([SHIPPED['phi_eventually']], HORIZON, S)
    for second, value in enumerate(values):
        (reading,) = judge.push(second * S, sample(value))
    assert (reading.lower, reading.upper) == (-math.inf, 1.5)
    assert (reading.final, reading.verdict) == (False, Verdict.UNKNOWN)
    assert (judge.judgement.complete, judge.judgement.satisfied) == (False, False)


@sentence(19)
@pytest.mark.parametrize('text', [
    'always(eventually[1:2](cte <= 0))', 'always[1:2](once[3:4](cte <= 0))',
])
def test_given_windows_without_samples_when_judged_then_rho_is_infinite_and_no_verdict(
    text: str,
) -> None:
    values = [-1.0] * 31
    assert math.isinf(rho(text, values))
    reading = watch([i * S for i in range(31)], values, text)
    assert (reading.final, reading.verdict) == (True, Verdict.UNKNOWN)


@sentence(20)
def test_given_a_window_beyond_the_run_when_it_is_to_be_judged_then_it_is_refused() -> None:
    with pytest.raises(UsageError, match='begins 35 s into the run, which lasts 30 s'):
        Judge([parse_spec('far=always[35:40](cte <= 1)')], HORIZON, S)


@sentence(21)
def test_given_a_window_that_the_end_cuts_off_when_judged_then_what_lies_within_counts() -> None:
    values = [5.0] * 31
    assert rho('eventually[0:60](cte <= 1)', values) == -4.0
    assert rho('always[0:60](cte <= 6)', values) == 1.0
    late = parse_spec('late=eventually[0:60](cte <= 1)')
    (warning,) = check_specs([late], Scenario()).warnings
    assert 'ends at 60 s, after the run of 30 s' in warning
