"""Which clause decides, and when: against the definitions, whole runs and prefixes."""

from __future__ import annotations

import math

import mtl_reference as reference
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mtl_strategies import HORIZON, PLAIN_ATOMS, Trace, formulas, fuzz, random_traces, traces

import taxinet_ros as tx
from taxinet_ros.core.mtl import Monitor, Spec, ast, parse_spec
from taxinet_ros.core.mtl.explain import Explanation, explain
from taxinet_ros.errors import UsageError


def explained(formula: ast.Formula, run: Trace, *, whole: bool = True) -> Explanation:
    monitor = Monitor(Spec(name='random', formula=formula, text=str(formula)), HORIZON)
    for stamp, sample in zip(run.stamps, run.samples, strict=True):
        monitor.push(stamp, sample)
    if whole:
        monitor.push(HORIZON + 1, {})
    return explain(monitor)


def parts(formula: ast.Formula) -> list[ast.Formula]:
    """All subformulas in the order in which they are written, the whole first."""
    match formula:
        case ast.Compare():
            return [formula]
        case ast.Not(child) | ast.Temporal(_, _, child):
            return [formula, *parts(child)]
        case ast.Logic(_, left, right) | ast.TemporalPair(_, _, left, right):
            return [formula, *parts(left), *parts(right)]


Operand = tuple[ast.Formula, int, int]
"""A subformula, how many there are before it in its parent, and a sample."""


def table(node: ast.Formula, run: Trace) -> list[float]:
    return reference.robustness_table(node, run.stamps, run.samples)


def inside(interval: ast.Interval, row: int, run: Trace, sign: int) -> list[int]:
    deltas = [sign * (stamp - run.stamps[row]) for stamp in run.stamps]
    return [at for at, delta in enumerate(deltas) if reference.inside(interval, delta)]


def of_pair(node: ast.TemporalPair, row: int, run: Trace) -> list[Operand]:
    value, found = table(node, run)[row], []
    guards, goals = table(node.left, run), table(node.right, run)
    for j in inside(node.interval, row, run, -1 if node.op == 'since' else 1):
        before = reference.between(node.op, row, j)
        if min([goals[j], *(guards[k] for k in before)]) == value:
            found += [(k, 0) for k in before if guards[k] == value]
            found += [(j, 1)] if goals[j] == value else []
    if not found:
        return []
    at, second = min(found)
    return [(node.right, len(parts(node.left)), at) if second else (node.left, 0, at)]


def deciding(node: ast.Formula, row: int, run: Trace) -> list[Operand]:
    """The operand and the sample that decide, by trying all; none of a predicate."""
    value = table(node, run)[row]
    match node:
        case ast.Compare():
            return []
        case ast.Not(child):
            return [(child, 0, row)]
        case ast.Logic(op, left, right):
            first = (-1 if op == 'implies' else 1) * table(left, run)[row] == value
            return [(left, 0, row) if first else (right, len(parts(left)), row)]
        case ast.Temporal(op, interval, child):
            rows = inside(interval, row, run, -1 if op in ('once', 'historically') else 1)
            return [(child, 0, at) for at in rows if table(child, run)[at] == value][:1]
    return of_pair(node, row, run)


def deciding_path(formula: ast.Formula, run: Trace) -> list[tuple[int, int]]:
    """Number of each subformula that decides, and its sample."""
    node, number, row = formula, 0, 0
    path = [(0, 0)]
    while inner := deciding(node, row, run):
        node, skipped, row = inner[0]
        number += 1 + skipped
        path.append((number, row))
    return path


def check_whole(formula: ast.Formula, run: Trace) -> None:
    found = explained(formula, run)
    wanted = parts(formula)
    assert [clause.text for clause in found.clauses] == list(map(str, wanted))
    for clause, part in zip(found.clauses, wanted, strict=True):
        low, high = clause.columns
        assert str(formula)[low - 1:high] == clause.text
        pairs = list(zip(clause.lower, clause.upper, table(part, run), strict=True))
        assert all(lower == upper == rho for lower, upper, rho in pairs if not math.isnan(lower))
        assert not clause.decides or not math.isnan(clause.lower[clause.row])
    path = [(at, one.row) for at, one in enumerate(found.clauses) if one.decides]
    assert path == deciding_path(formula, run)
    # Only an empty window, which gives an infinite value, decides without any sample.
    assert (found.witness is None) == math.isinf(found.interval.lower)


def check_prefixes(formula: ast.Formula, run: Trace) -> None:
    for count in range(1, len(run.stamps) + 1):
        seen = Trace(stamps=run.stamps[:count], samples=run.samples[:count])
        found = explained(formula, seen, whole=False)
        prefix = reference.Prefix(
            stamps=seen.stamps, values=seen.columns['cte'], horizon=HORIZON
        )
        for clause, part in zip(found.clauses, parts(formula), strict=True):
            pairs = zip(clause.lower, clause.upper, reference.rosi(part, prefix)[0], strict=True)
            assert all(
                (lower, upper) == pair for lower, upper, pair in pairs if not math.isnan(lower)
            )
        assert (found.clauses[0].lower[0], found.clauses[0].upper[0]) == found.interval
        assert found.interval.decided == found.clauses[0].decides
        if found.witness is not None:
            rho = found.interval.nearest_to_zero
            assert abs(found.witness.lower[found.witness.row]) == abs(rho or 0.0)


def test_given_a_known_run_when_explained_then_text_columns_and_earliest_sample_are_right() -> None:
    trace = pd.DataFrame({
        't_s': [0, 1, 2, 3], 'a': [5.0, 2.0, 2.0, 9.0], 'b': [4.0, 3.0, 9.0, 3.0],
    })
    found = tx.robustness('always((a >= 1) and (b >= 2.5))', trace, explain=True)
    assert str(found).splitlines() == [
        'rho +0.500    0.0 s  always((a >= 1) and (b >= 2.5))',
        'rho +0.500    1.0 s    (a >= 1) and (b >= 2.5)',
        'rho +1.000    1.0 s      a >= 1',
        'rho +0.500    1.0 s      b >= 2.5  <- decides',
    ]
    assert found.witness is not None
    assert (found.witness.text, found.witness.columns, found.witness_s) == ('b >= 2.5', (22, 29), 1)
    assert found.clauses[3].lower == (1.5, 0.5, 6.5, 0.5)
    empty = tx.robustness('eventually[8:9](a >= 1)', trace, explain=True)
    assert (empty.interval, empty.witness) == ((-math.inf, -math.inf), None)


def test_given_a_run_in_progress_when_explained_then_open_parts_are_intervals() -> None:
    spec = parse_spec('eventually[0:2](always(abs(cte) <= 1)) and always(abs(he) <= 1)')
    monitor = Monitor(spec, 30)
    with pytest.raises(UsageError, match='no sample yet'):
        explain(monitor)
    for stamp, he in enumerate((0.0, 0.5, 3.0, 2.0)):
        monitor.push(stamp, {'cte': 0.0, 'he': he})
    found = explain(monitor)
    assert found.interval == (-math.inf, -2.0)
    assert found.witness is not None
    assert (found.witness.text, found.stamps_ns[found.witness.row]) == ('abs(he) <= 1', 2)
    assert found.clauses[1].interval == (-math.inf, 1.0), 'eventually is still open'


@given(formulas(), st.integers(0, 2**32 - 1))
@fuzz(150)
def test_given_any_run_when_explained_then_parts_and_sample_are_those_of_the_definition(
    formula: ast.Formula, seed: int
) -> None:
    for run in random_traces(seed, 4):
        check_whole(formula, run)


@given(formulas(past=False, atoms=PLAIN_ATOMS), traces(most=8))
@fuzz(100)
def test_given_any_prefix_when_explained_then_intervals_are_those_of_the_definition(
    formula: ast.Formula, run: Trace
) -> None:
    check_prefixes(formula, run)


@pytest.mark.nightly
@given(formulas(), st.integers(0, 2**32 - 1))
@fuzz(2_000)
def test_given_thousands_of_formulas_when_explained_then_they_equal_the_definition(
    formula: ast.Formula, seed: int
) -> None:
    for run in random_traces(seed, 2):
        check_whole(formula, run)


@pytest.mark.nightly
@given(formulas(past=False, atoms=PLAIN_ATOMS), traces(most=8))
@fuzz(1_000)
def test_given_thousands_of_prefixes_when_explained_then_they_equal_the_definition(
    formula: ast.Formula, run: Trace
) -> None:
    check_prefixes(formula, run)
