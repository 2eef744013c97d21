"""Robustness of finished traces: signs, window edges, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from taxinet_ros.core.mtl import SHIPPED, parse_formula, robustness
from taxinet_ros.errors import UsageError

S = 1_000_000_000


def rho(text: str, values: list[float], stamps: list[int] | None = None) -> float:
    stamps = list(range(0, len(values) * S, S)) if stamps is None else stamps
    return robustness(parse_formula(text), stamps, {'cte': values})


@pytest.mark.parametrize(
    ('name', 'values', 'wanted'),
    [
        ('phi_always', [0.0, 0.0], 1.5),
        ('phi_always', [1.5], 0.0),
        ('phi_eventually', [8.0, 4.0, 1.0, 0.25, -0.5], 1.0),
        ('on_runway', [0.0, 16.24], -1.0),
    ],
)
def test_given_shipped_formulas_when_evaluated_then_rho_is_the_margin(
    name: str, values: list[float], wanted: float
) -> None:
    stamps = np.arange(len(values)) * S
    assert robustness(SHIPPED[name].formula, stamps, {'cte': np.array(values)}) == pytest.approx(
        wanted, abs=1e-12
    )


def test_given_a_rising_trace_when_evaluated_then_the_window_edge_at_10_s_counts() -> None:
    values = [6.0] * 10 + [1.0, 0.0]
    formula = SHIPPED['phi_eventually'].formula
    at_edge = list(range(0, 12 * S, S))
    assert robustness(formula, at_edge, {'cte': values}) == 0.5
    past_edge = [*at_edge[:10], 10 * S + 1, 11 * S]
    assert robustness(formula, past_edge, {'cte': values}) == -4.5


@pytest.mark.parametrize(
    ('text', 'wanted'),
    [
        ('historically[1:2] (cte <= 1)', math.inf),
        ('(cte <= 9) since[1:5] (cte <= 9)', -math.inf),
    ],
)
def test_given_an_empty_window_when_evaluated_then_rho_is_infinite(
    text: str, wanted: float
) -> None:
    assert rho(text, [0.0, 0.0, 0.0]) == wanted


@pytest.mark.parametrize(
    ('text', 'wanted'),
    [
        ('(cte <= 1) until[3:3] (cte >= 5)', -5.0),
        ('eventually[3:3] ((cte <= 3) since (cte >= 5))', -1.0),
        ('eventually[3:3] ((cte <= 4) since (cte >= 5))', 0.0),
        ('eventually[3:3] (once[1:1] (cte >= 5))', 1.0),
        ('always[2:2] (cte * cte / 2 - 1 >= 0)', 17.0),
        ('always (sqrt(abs(cte)) <= max(1, cte - 4))', -1.0),
    ],
)
def test_given_pairs_and_arithmetic_when_evaluated_then_rho_is_as_defined(
    text: str, wanted: float
) -> None:
    assert rho(text, [0.0, 0.0, 6.0, 4.0]) == wanted


def test_given_margins_of_either_zero_when_evaluated_then_rho_is_plus_zero() -> None:
    value = rho('not (cte <= 1)', [1.0])
    assert (value, math.copysign(1.0, value)) == (0.0, 1.0)


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_given_a_value_that_is_not_finite_when_evaluated_then_it_raises(bad: float) -> None:
    with pytest.raises(UsageError, match=r"signal 'cte' is .* at sample 1"):
        rho('always(cte <= 1)', [0.5, bad, -8.0])


@pytest.mark.parametrize(
    'text',
    [
        '1 / cte <= 1',
        'sqrt(cte - 1) <= 1',
        '(cte + 8) * 1e308 * 100 <= 1',
        'min(0, (cte + 1e308) * 10 - (cte + 1e308) * 10) < 1',
    ],
)
def test_given_a_predicate_without_a_value_when_evaluated_then_it_raises(text: str) -> None:
    with pytest.raises(UsageError, match='has margin'):
        rho(text, [0.0])


@pytest.mark.parametrize(
    ('stamps', 'message'),
    [
        ([], 'no samples'),
        ([0, 0, 1], 'repeats at sample 1'),
        ([0, 2, 1], 'goes back at sample 2'),
        ([-1, 0, 1], 'before the start of the run'),
        ([0.0, 1.0, 2.0], 'integer nanoseconds'),
        ([0, 1], 'has shape'),
    ],
)
def test_given_bad_stamps_when_evaluated_then_it_raises(stamps: list[int], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        rho('always(cte <= 1)', [0.0, 0.0, 0.0], stamps)


def test_given_a_missing_signal_when_evaluated_then_it_raises() -> None:
    with pytest.raises(UsageError, match="'he' is missing; present: cte"):
        rho('always(he <= 1)', [0.0])


def test_given_a_bad_signal_that_is_not_read_when_evaluated_then_it_is_ignored() -> None:
    signals = {'cte': [0.5], 'he': [math.nan]}
    assert robustness(parse_formula('cte <= 1'), [0], signals) == 0.5


def test_given_a_formula_without_signals_when_evaluated_then_it_has_a_value() -> None:
    assert robustness(parse_formula('always(1 <= 3)'), [0, 1], {}) == 2.0
