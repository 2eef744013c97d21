"""Random formulas on random traces: offline against the definitions, online against offline."""

from __future__ import annotations

import itertools
import struct

import mtl_reference as reference
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mtl_strategies import ATOMS, HORIZON, PLAIN_ATOMS, Trace, formulas, fuzz, random_traces, traces

from taxinet_ros.core.mtl import Monitor, Reading, Spec, ast, parse_formula, robustness

pytestmark = pytest.mark.nightly

TRACES_PER_FORMULA = 10
FORMULAS = 1_000
"""Ten thousand pairs in every run of the tests."""


def bits(value: float) -> bytes:
    return struct.pack('<d', value)


def spec_of(formula: ast.Formula) -> Spec:
    return Spec(name='random', formula=formula, text=str(formula))


def follow(monitor: Monitor, trace: Trace) -> list[Reading]:
    return [
        monitor.push(stamp, sample)
        for stamp, sample in zip(trace.stamps, trace.samples, strict=True)
    ]


@given(formulas())
@fuzz(300)
def test_given_any_formula_when_printed_and_parsed_then_it_is_the_same(
    formula: ast.Formula,
) -> None:
    assert parse_formula(str(formula)) == formula


@given(formulas(), st.integers(0, 2**32 - 1))
@fuzz(FORMULAS)
def test_given_any_formula_and_traces_when_evaluated_then_it_equals_the_definition(
    formula: ast.Formula, seed: int
) -> None:
    runs = random_traces(seed, TRACES_PER_FORMULA)
    found = [robustness(formula, run.stamps, run.columns) for run in runs]
    wanted = [reference.robustness_table(formula, run.stamps, run.samples)[0] for run in runs]
    assert found == wanted


@given(formulas(), st.integers(0, 2**32 - 1))
@fuzz(600)
def test_given_any_run_when_monitored_then_the_interval_tightens_onto_the_offline_value(
    formula: ast.Formula, seed: int
) -> None:
    for run in random_traces(seed, 4):
        monitor = Monitor(spec_of(formula), HORIZON)
        readings = follow(monitor, run)
        readings.append(monitor.push(HORIZON + 1, {}))
        assert [r.samples for r in readings[:-1]] == list(range(1, len(run.stamps) + 1))
        for before, after in itertools.pairwise(readings):
            assert before.lower <= after.lower <= after.upper <= before.upper
        rho = robustness(formula, run.stamps, run.columns)
        last = readings[-1]
        assert (last.final, last.valid) == (True, True)
        assert bits(last.lower) == bits(last.upper) == bits(rho)


@given(
    formulas(),
    traces(most=6),
    st.lists(traces(least=0, most=6), min_size=4, max_size=4),
    st.booleans(),
)
@fuzz(400)
def test_given_any_prefix_when_completed_at_random_then_rho_is_in_the_interval(
    formula: ast.Formula, prefix: Trace, rests: list[Trace], bounded: bool
) -> None:
    limits = {'cte': (-1e3, 1e3), 'he': (-1e3, 1e3)} if bounded else None
    reading = follow(Monitor(spec_of(formula), HORIZON, bounds=limits), prefix)[-1]
    for rest in rests:
        whole = _joined(prefix, rest)
        rho = robustness(formula, whole.stamps, whole.columns)
        assert reading.lower <= rho <= reading.upper


@given(formulas(past=False, atoms=PLAIN_ATOMS), traces())
@fuzz(500)
def test_given_future_operators_when_monitored_then_the_interval_is_the_tightest(
    formula: ast.Formula, run: Trace
) -> None:
    monitor = Monitor(spec_of(formula), HORIZON)
    for count, reading in enumerate(follow(monitor, run), start=1):
        prefix = reference.Prefix(
            stamps=run.stamps[:count], values=run.columns['cte'][:count], horizon=HORIZON
        )
        seen, _ = reference.rosi(formula, prefix)
        assert (reading.lower, reading.upper) == seen[0]


LIMITS = {'bounds': {'cte': (-5.0, 5.0)}, 'rates': {'cte': 1e9, 'he': 0.0}}
"""One per nanosecond, the step of the stamps."""


@st.composite
def kept_runs(draw: st.DrawFn) -> Trace:
    """Runs that keep to the limits."""
    run = draw(traces(least=2))
    steps = draw(st.lists(st.floats(-1, 1), min_size=12, max_size=12))
    samples = [{'cte': 0.0, 'he': run.samples[0]['he']}]
    for (before, after), step in zip(itertools.pairwise(run.stamps), steps, strict=False):
        moved = samples[-1]['cte'] + step * (after - before)
        samples.append({'cte': max(-5.0, min(moved, 5.0)), 'he': samples[0]['he']})
    return Trace(stamps=run.stamps, samples=tuple(samples))


@given(
    formulas(atoms=st.one_of(PLAIN_ATOMS, ATOMS)),
    kept_runs(),
    st.sampled_from([['bounds'], ['rates'], ['bounds', 'rates']]),
)
@fuzz(500)
def test_given_vouched_limits_when_kept_then_the_interval_tightens_and_holds_rho(
    formula: ast.Formula, run: Trace, kinds: list[str]
) -> None:
    monitor = Monitor(spec_of(formula), HORIZON, **{kind: LIMITS[kind] for kind in kinds})
    # The run itself is a completion that keeps to the limits, of each of its prefixes.
    readings = [*follow(monitor, run), monitor.push(HORIZON + 1, {})]
    rho = robustness(formula, run.stamps, run.columns)
    for before, after in itertools.pairwise(readings):
        assert before.lower <= after.lower <= rho <= after.upper <= before.upper
    assert (readings[-1].final, readings[-1].trusted) == (True, True)
    assert bits(readings[-1].lower) == bits(readings[-1].upper) == bits(rho)


@given(formulas(), traces(least=2), traces(least=1), st.integers(0, 4))
@fuzz(300)
def test_given_limits_when_broken_then_the_rest_is_as_if_nothing_had_been_vouched_for(
    formula: ast.Formula, run: Trace, rest: Trace, place: int
) -> None:
    run = _joined(run, rest)
    wild = place % len(run.stamps)
    samples = [{'cte': 0.0, 'he': 1.0} for _ in run.stamps]
    samples[wild:] = run.samples[wild:]
    samples[wild] = {'cte': 6.0, 'he': -7.0}
    run = Trace(stamps=run.stamps, samples=tuple(samples))
    plain = follow(Monitor(spec_of(formula), HORIZON), run)
    reads = 'cte' in str(formula)
    guarded = follow(Monitor(spec_of(formula), HORIZON, **LIMITS), run)
    assert [r.trusted for r in guarded[:wild]] == [True] * wild
    if reads:
        assert not any(r.trusted for r in guarded[wild:])
        assert [r._replace(trusted=True) for r in guarded[wild:]] == plain[wild:]


def _joined(prefix: Trace, rest: Trace) -> Trace:
    later = [
        (stamp, sample)
        for stamp, sample in zip(rest.stamps, rest.samples, strict=True)
        if stamp > prefix.stamps[-1]
    ]
    return Trace(
        stamps=prefix.stamps + tuple(stamp for stamp, _ in later),
        samples=prefix.samples + tuple(sample for _, sample in later),
    )
