"""Hypothesis strategies: random formulas and traces that meet at window edges.

``TAXINET_FUZZ=5`` multiplies the number of examples of the fuzz tests: of the 10,000 pairs of a
formula and a trace that every run judges against the definitions it makes 50,000.
"""

from __future__ import annotations

import os
import random
from dataclasses import dataclass

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from taxinet_ros.core.mtl import ast

FUZZ = int(os.environ.get('TAXINET_FUZZ', '1'))
HORIZON = 24
"""End of the random runs [ns]. Stamps and windows are small so that they coincide often."""


def fuzz(examples: int) -> settings:
    """Settings of a fuzz test: reproducible, and without a limit on the time of one example."""
    return settings(
        max_examples=examples * FUZZ,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )


VALUES = st.one_of(
    st.integers(-4, 4).map(float),
    st.floats(-1e3, 1e3, allow_nan=False, width=32),
)
NUMBERS = st.one_of(
    st.integers(0, 4).map(float),
    st.floats(0, 1e6, allow_nan=False).map(abs),
).map(ast.Number)
INTERVALS = st.one_of(
    st.just(ast.Interval()),
    st.builds(
        lambda low, width: ast.Interval(low, None if width is None else low + width),
        st.integers(0, 8),
        st.one_of(st.none(), st.integers(0, 10)),
    ),
)
PLAIN_ATOMS = st.builds(
    ast.Compare,
    st.sampled_from(['<=', '<', '>=', '>']),
    st.just(ast.Signal('cte')),
    NUMBERS,
)


@st.composite
def expressions(draw: st.DrawFn, depth: int = 2) -> ast.Expr:
    """Expressions that are finite for finite signals: no division by a signal, roots of |.|."""
    kind = draw(st.integers(0, 5 if depth else 1))
    if kind == 0:
        return draw(NUMBERS)
    if kind == 1:
        return ast.Signal(draw(st.sampled_from(['cte', 'he'])))
    child = draw(expressions(depth=depth - 1))
    if kind == 2:
        return ast.Negative(child)
    if kind == 3:
        other = draw(expressions(depth=depth - 1))
        return ast.Arithmetic(draw(st.sampled_from(['+', '-', '*'])), child, other)
    if kind == 4:
        return draw(
            st.sampled_from(
                [
                    ast.Function('abs', (child,)),
                    ast.Function('sqrt', (ast.Function('abs', (child,)),)),
                    ast.Arithmetic('/', child, ast.Number(3.0)),
                ]
            )
        )
    others = draw(st.lists(expressions(depth=depth - 1), min_size=1, max_size=2))
    return ast.Function(draw(st.sampled_from(['min', 'max'])), (child, *others))


ATOMS = st.one_of(
    PLAIN_ATOMS,
    st.builds(ast.Compare, st.sampled_from(['<=', '<', '>=', '>']), expressions(), expressions()),
)


@st.composite
def formulas(
    draw: st.DrawFn, depth: int = 3, past: bool = True, atoms: st.SearchStrategy = ATOMS
) -> ast.Formula:
    """Formulas up to a depth, of all operators or of all but the past ones."""
    kind = draw(st.integers(0, 5)) if depth else 0
    if kind == 0:
        return draw(atoms)
    child = draw(formulas(depth - 1, past, atoms))
    if kind == 1:
        return ast.Not(child)
    if kind in (2, 3):
        ops = ['always', 'eventually', *(['historically', 'once'] if past else [])]
        return ast.Temporal(draw(st.sampled_from(ops)), draw(INTERVALS), child)
    other = draw(formulas(depth - 1, past, atoms))
    if kind == 4:
        return ast.Logic(draw(st.sampled_from(['and', 'or', 'implies'])), child, other)
    ops = ['until', *(['since'] if past else [])]
    return ast.TemporalPair(draw(st.sampled_from(ops)), draw(INTERVALS), child, other)


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Samples of ``cte`` and ``he`` with stamps in [0, HORIZON]."""

    stamps: tuple[int, ...]
    samples: tuple[dict[str, float], ...]

    @property
    def columns(self) -> dict[str, list[float]]:
        return {name: [sample[name] for sample in self.samples] for name in ('cte', 'he')}


@st.composite
def traces(draw: st.DrawFn, least: int = 1, most: int = 12, low: int = 0) -> Trace:
    """Traces with irregular stamps from ``low`` on."""
    stamps = draw(st.sets(st.integers(low, HORIZON), min_size=least, max_size=most))
    samples = [{'cte': draw(VALUES), 'he': draw(VALUES)} for _ in stamps]
    return Trace(stamps=tuple(sorted(stamps)), samples=tuple(samples))


def random_traces(seed: int, count: int) -> list[Trace]:
    """As many traces of the same kind from a seed, which are made much faster."""
    rng = random.Random(seed)

    def value() -> float:
        return float(rng.randint(-4, 4)) if rng.random() < 0.5 else rng.uniform(-1e3, 1e3)

    runs = []
    for _ in range(count):
        stamps = sorted(rng.sample(range(HORIZON + 1), rng.randint(1, 12)))
        samples = tuple({'cte': value(), 'he': value()} for _ in stamps)
        runs.append(Trace(stamps=tuple(stamps), samples=samples))
    return runs
