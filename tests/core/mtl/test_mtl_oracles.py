"""The same number from other people's monitors, on what their semantics and ours have in common.

Each is skipped where it is not installed; ``oracles.txt`` says how to install them.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mtl_strategies import fuzz

from taxinet_ros.core.mtl import ast, parse_formula, robustness

TICK = 125_000_000
"""An eighth of a second: exact in nanoseconds and in binary seconds."""

Samples = list[tuple[float, float]]

VALUES = st.one_of(st.integers(-4, 4).map(float), st.floats(-50, 50, width=32))
SAMPLES = st.lists(st.tuples(VALUES, VALUES), min_size=2, max_size=14)
CTE, HE = ast.Signal('cte'), ast.Signal('he')
EXPRESSIONS = st.sampled_from(
    [CTE, HE, ast.Function('abs', (CTE,)), ast.Arithmetic('-', CTE, HE)]
)
ATOMS = st.builds(
    ast.Compare,
    st.sampled_from(['<=', '<', '>=', '>']),
    EXPRESSIONS,
    st.integers(0, 4).map(lambda number: ast.Number(float(number))),
)


def windows(step_ns: int) -> st.SearchStrategy[ast.Interval]:
    bounded = st.builds(
        lambda low, width: ast.Interval(low * step_ns, (low + width) * step_ns),
        st.integers(0, 5),
        st.integers(0, 6),
    )
    return st.one_of(st.just(ast.Interval()), bounded)


def shared_formulas(step_ns: int, depth: int = 3) -> st.SearchStrategy[ast.Formula]:
    """Formulas of every operator, past ones included."""
    if not depth:
        return ATOMS
    part, window = shared_formulas(step_ns, depth - 1), windows(step_ns)
    unary = st.sampled_from(['always', 'eventually', 'historically', 'once'])
    logic = st.sampled_from(['and', 'or', 'implies'])
    return st.one_of(
        ATOMS,
        st.builds(ast.Not, part),
        st.builds(ast.Temporal, unary, window, part),
        st.builds(ast.Logic, logic, part, part),
        st.builds(ast.TemporalPair, st.sampled_from(['until', 'since']), window, part, part),
    )


def ours(formula: ast.Formula, stamps: list[int], samples: Samples) -> float:
    cte, he = zip(*samples, strict=True)
    return robustness(formula, stamps, {'cte': cte, 'he': he})


def grid(samples: Samples) -> list[int]:
    return [8 * TICK * index for index in range(len(samples))]


def rtamt_robustness(text: str, samples: Samples) -> float:
    """Of rtamt's discrete-time offline monitor, one sample a second."""
    rtamt = pytest.importorskip('rtamt')
    spec = rtamt.StlDiscreteTimeSpecification()
    spec.declare_var('cte', 'float')
    spec.declare_var('he', 'float')
    spec.set_sampling_period(1, 's', 0.1)
    spec.spec = text
    spec.parse()
    cte, he = map(list, zip(*samples, strict=True))
    return spec.evaluate({'time': list(range(len(samples))), 'cte': cte, 'he': he})[0][1]


def sentil_robustness(text: str, stamps: list[int], samples: Samples) -> float:
    """Of SENTIL's offline monitor, at irregular stamps."""
    sentil = pytest.importorskip('sentil')
    cte, he = map(list, zip(*samples, strict=True))
    trace = sentil.Trace([stamp / 1e9 for stamp in stamps], {'cte': cte, 'he': he})
    formula = sentil.parse(re.sub(r'\[([^:]*):([^]]*)\]', r'[\1, \2]', text))
    return sentil.Monitor(formula).robustness(trace)


@given(shared_formulas(8 * TICK), SAMPLES)
@fuzz(700)
def test_given_a_formula_when_rtamt_evaluates_it_then_rho_is_the_same(
    formula: ast.Formula, samples: Samples
) -> None:
    assert ours(formula, grid(samples), samples) == rtamt_robustness(str(formula), samples)


# It takes unless with a window only.
@pytest.mark.parametrize('window', ['[0:3]', '[2:5]'])
@given(samples=SAMPLES)
@fuzz(100)
def test_given_unless_when_rtamt_evaluates_it_then_rho_is_the_same(
    window: str, samples: Samples
) -> None:
    text = f'(abs(cte) <= 2) unless{window} (he >= 1)'
    assert ours(parse_formula(text), grid(samples), samples) == rtamt_robustness(text, samples)


@given(shared_formulas(TICK), SAMPLES, st.lists(st.integers(1, 4), min_size=13, max_size=13))
@fuzz(1_000)
def test_given_irregular_stamps_when_sentil_evaluates_then_rho_is_the_same(
    formula: ast.Formula, samples: Samples, steps: list[int]
) -> None:
    stamps = [TICK * sum(steps[:index]) for index in range(len(samples))]
    assert ours(formula, stamps, samples) == sentil_robustness(str(formula), stamps, samples)


def mtl_formula(text: str) -> Callable[..., float]:
    mtl = pytest.importorskip('mtl')
    if not hasattr(mtl, 'parse'):  # this folder has the same name, and lies on the path
        pytest.skip("could not import 'mtl'")
    return functools.cache(mtl.parse)(text)


@pytest.mark.parametrize(
    ('text', 'theirs'),
    [
        ('always near', 'G near'),
        ('eventually[0:9.999999999](always near)', 'F[0, 10] G near'),
        ('eventually[0:4.999999999](near and far)', 'F[0, 5] (near & far)'),
        ('always[0:4.999999999](near implies far)', 'G[0, 5] (near -> far)'),
        ('not (always near or eventually far)', '~(G near | F far)'),
    ],
)
@given(samples=st.lists(st.tuples(VALUES, VALUES), min_size=12, max_size=20))
@fuzz(60)
def test_given_half_open_windows_when_the_papers_tool_evaluates_then_rho_is_the_same(
    text: str, theirs: str, samples: Samples
) -> None:
    phi = mtl_formula(theirs)
    near = [(float(t), 1.5 - abs(cte)) for t, (cte, _) in enumerate(samples)]
    far = [(float(t), he - 1.0) for t, (_, he) in enumerate(samples)]
    formula = parse_formula(text, {'near': 'abs(cte) <= 1.5', 'far': 'he >= 1'})
    wanted = phi({'near': near, 'far': far}, quantitative=True)
    assert ours(formula, grid(samples), samples) == wanted
