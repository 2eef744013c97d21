"""Which of several requirements is looked into, and what is said of the others."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.mtl import RobustnessInterval, exact_intervals
from taxinet_ros.core.verdict.examined import decisive, examine, examine_runs
from taxinet_ros.errors import UsageError


@pytest.mark.parametrize(('violated', 'asked', 'spec', 'chosen', 'also'), [
    ({'a': 0}, None, 'a', '', ''),
    ({'a': 6}, None, 'a', '', ''),
    ({'a': 0, 'b': 0}, None, 'a', '', ''),
    ({'a': 1, 'b': 0}, None, 'a', '', ''),
    ({'a': 1, 'b': 6, 'c': 2}, None, 'a', '',
     'Runs also violate b (6 of 6), c (2 of 6); look into that by: why --spec b or why --spec c'),
    ({'a': 0, 'b': 6}, None, 'b', 'no run violates a; looked into: b, violated by 6 of 6 runs',
     ''),
    ({'a': 0, 'b': 1, 'c': 2, 'd': 2}, None, 'c',
     'no run violates a; looked into: c, violated by 2 of 6 runs',
     'Runs also violate b (1 of 6), d (2 of 6); look into that by: why --spec b or why --spec d'),
    ({'a': 0, 'b': 3}, 'a', 'a', '',
     'Runs violate b (3 of 6); look into that by: why --spec b'),
    ({'a': 4, 'b': 3}, 'b', 'b', '',
     'Runs also violate a (4 of 6); look into that by: why --spec a'),
])
def test_the_one_asked_for_else_a_violated_headline_else_the_one_most_runs_violate(
    violated, asked, spec, chosen, also
):
    found = examine(violated, 6, asked=asked)
    assert (found.spec, found.failed) == (spec, violated[spec])
    assert (found.chosen, found.also('why')) == (chosen, also)


def test_one_run_is_told_without_numbers():
    found = examine_runs(['a', 'b', 'c'], [exact_intervals({'a': 1.0, 'b': -1.0, 'c': -3.0})])
    assert found.chosen == 'the run does not violate a; looked into: b'
    assert found.also('why') == 'The run also violates c; look into that by: why --spec c'


def test_what_is_not_decided_or_not_evaluated_is_not_violated():
    undecided = {'a': RobustnessInterval(-math.inf, 2.0), 'b': RobustnessInterval(-1.0, 0.0)}
    found = examine_runs(['a', 'b', 'c'], [undecided, {}])
    assert (found.spec, dict(found.violated), found.judged) == ('b', {'a': 0, 'b': 1, 'c': 0}, 2)


def test_a_requirement_by_which_no_run_was_judged_is_refused():
    with pytest.raises(UsageError, match=r'spec c: not judged in bags/e; known: a, b'):
        examine({'a': 0, 'b': 1}, 1, asked='c', where='bags/e')


@given(st.lists(st.sampled_from([-1.0, 0.0, 1.0]), min_size=1, max_size=4))
def test_of_one_run_what_it_is_shown_by_is_what_is_looked_into(rhos):
    run = exact_intervals({f'r{number}': rho for number, rho in enumerate(rhos)})
    assert decisive(run) == examine_runs(list(run), [run]).spec
