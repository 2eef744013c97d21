"""Tightest parameters: direction by brute force, known answers, refusals."""

from __future__ import annotations

import contextlib
import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from mtl_strategies import NUMBERS, formulas, fuzz, random_traces

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.mine import parse_template
from taxinet_ros.errors import UsageError

TENTH = 100_000_000
A = ast.Signal('A')
WITH_A = st.one_of(
    st.builds(ast.Compare, st.sampled_from(['<=', '>=']), st.just(ast.Signal('cte')), NUMBERS),
    *(
        st.builds(ast.Compare, st.sampled_from(['<=', '<', '>=', '>']),
                  st.sampled_from([ast.Signal('cte'), ast.Signal('he')]), st.just(right))
        for right in (A, ast.Negative(A), ast.Arithmetic('*', ast.Number(2.0), A),
                      ast.Function('min', (A, ast.Signal('he'))), ast.Function('abs', (A,)))
    ),
)


@pytest.mark.nightly
@given(formulas(2, atoms=WITH_A), st.integers(0, 2**32 - 1))
@fuzz(300)
def test_given_a_parameter_when_its_direction_is_read_off_then_robustness_goes_that_way(
    formula: ast.Formula, seed: int
) -> None:
    template = None
    with contextlib.suppress(UsageError):
        template = parse_template(str(formula), TENTH)
    assume(template is not None)
    (parameter,) = template.parameters
    sign = 1 if parameter.rises else -1
    for run in random_traces(seed, 3):
        rho = [
            sign * template.robustness({'A': value}, run.stamps, run.columns)
            for value in (-900.0, -3.0, 0.0, 0.5, 2.0, 900.0)
        ]
        assert rho == sorted(rho)
        tight = template.tightest(parameter, {}, run.stamps, run.columns)
        if math.isfinite(tight):
            looser, tighter = (tight + step * sign * 1e-6 * max(1, abs(tight)) for step in (1, -1))
            assert template.robustness({'A': tight}, run.stamps, run.columns) > 0
            assert template.robustness({'A': looser}, run.stamps, run.columns) > 0
            assert template.robustness({'A': tighter}, run.stamps, run.columns) <= 0


WINDOWS = [
    *(f'{op}[{window}](cte <= 0)' for op in ('always', 'eventually')
      for window in ('T:2', '0.5:T')),
    *(f'eventually[2:2]({op}[{window}](cte <= 0))' for op in ('historically', 'once')
      for window in ('T:2', '0.5:T')),
    *(f'({left}) until[{window}] (he >= 0)' for left in ('cte <= 2',) for window in ('T:2', '0:T')),
    *(f'always((cte <= 2) since[{window}] (he >= -2))' for window in ('T:2', '0:T')),
    *(f'not (always[{window}](cte <= 0))' for window in ('T:2', '0.5:T')),
]


@pytest.mark.parametrize('text', WINDOWS)
def test_given_a_window_when_its_parameter_is_mined_then_it_is_the_tightest_of_all(text) -> None:
    template = parse_template(text, TENTH)
    (parameter,) = template.parameters
    decided = set()
    for run in random_traces(7, 60):
        stamps = [TENTH * stamp for stamp in run.stamps]
        if stamps[0] or stamps[-1] < 20 * TENTH:
            continue
        times_s = parameter.times_s(stamps[-1])
        first, last = 0.5 if '0.5:T' in text else 0.0, 2.0 if 'T:2' in text else stamps[-1] / 1e9
        assert sorted(times_s) == pytest.approx(np.arange(first, last + 0.05, 0.1))
        rho = [template.robustness({'T': time_s}, stamps, run.columns) for time_s in times_s]
        assert all(one <= other for one, other in itertools.pairwise(rho)), 'tightest first'
        holds = [at for at, value in enumerate(rho) if value > 0]
        tight = template.tightest(parameter, {}, stamps, run.columns)
        decided.add(math.isfinite(tight))
        if math.isfinite(tight):
            assert tight == times_s[holds[0]]
        else:
            assert not holds or math.isinf(rho[holds[0]])
    assert decided


def test_given_known_traces_when_mined_then_the_values_are_the_known_ones() -> None:
    stamps = [TENTH * step for step in range(31)]
    cte = {'cte': [3.0 - 0.1 * step for step in range(31)], 'he': [0.0] * 31}
    template = parse_template('always[T:3](abs(cte) <= A)', TENTH)
    time, number = template.parameters
    assert (time.name, time.rises, number.name, number.rises) == ('T', True, 'A', True)
    assert template.tightest(number, {'T': 1.0}, stamps, cte) == pytest.approx(2.0)
    assert template.tightest(time, {'A': 1.05}, stamps, cte) == pytest.approx(2.0)
    assert template.tightest(time, {'A': -1.0}, stamps, cte) == math.inf
    far = parse_template('always(cte >= B)', TENTH)
    assert far.parameters[0].rises is False
    assert far.tightest(far.parameters[0], {}, stamps, cte) == pytest.approx(0.0, abs=1e-8)
    vacuous = parse_template('always[0.05:0.06](cte <= A)', TENTH)
    assert vacuous.tightest(vacuous.parameters[0], {}, stamps, cte) == math.inf


@pytest.mark.parametrize(('text', 'said'), [
    ('always(abs(cte) <= 1)', '0 parameters'),
    ('always(cte <= A and he <= B and x >= C)', '3 parameters'),
    ('always(cte <= A and cte >= A)', 'column 15: robustness is not monotone in A'),
    ('always(cte * A <= 3)', 'not monotone in A'),
    ('always(abs(A) <= 3)', 'not monotone in A'),
    ('(cte <= 1) unless[0:T] (he <= 1)', 'not monotone in T'),
    ('always[T:20](cte <= T)', 'a number and a time'),
    ('always[T:V](cte <= 1)', 'both ends of a window'),
    ('always[0:T ms](cte <= 1)', "'T' has a unit"),
    ('always[0:T](ctee <= 1)', 'mine: always[0:0.000007919](ctee <= 1): column 23: expected a sig'),
    ('always(cte <= A', "expected ')'"),
])
def test_given_a_formula_that_cannot_be_mined_then_it_is_refused_by_name(text, said) -> None:
    with pytest.raises(UsageError) as refused:
        parse_template(text, TENTH)
    assert said in str(refused.value)
