"""Errors and lengths of sequential tests, simulated at known rates, beside their exact values.

Each repetition is a campaign of independent runs with a known share of failures, followed run by
run as ``gate --sequential`` does. The fixed number beside it is that of the shortest campaign that
is judged once and passes the design as often.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from common import Progress, leave, make_table, options, run_study

import numpy as np
from rich.console import Console

from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.trials.sample_size import plan_with_power
from taxinet_ros.trials.sequential import (
    MIN_SATISFACTION,
    Decision,
    SequentialTest,
    decision,
    operating,
    sequential_test,
)

CASES = ((0.86, 0.95), (0.9, 0.99), (0.99, 0.999))
"""Threshold and design, as shares of satisfied runs."""
_MOST_RUNS = 6
"""Runs at which a test is given up, in those of the fixed campaign."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Simulated:
    """One test at one true rate; shares are of the repetitions.

    Attributes:
        test: the test, as after ``--until``.
        satisfied: true share of satisfied runs.
        role: what this share is: ``design``, ``threshold`` and so on.
        most: runs at which it is given up.
        passes, fails, below_design, open: share of each end.
        exact_passes: exact probability of a pass.
        mean_runs, exact_mean_runs: average number of runs, and its exact value.
        fixed_runs: runs of the fixed campaign with the same errors.
    """

    test: str
    satisfied: float
    role: str
    most: int
    passes: float
    fails: float
    below_design: float
    open: float
    exact_passes: float
    mean_runs: float
    exact_mean_runs: float
    fixed_runs: int


def measure_sequential(
    repeats: int, progress: Progress, *, cases: Sequence[tuple[float, float]] = CASES,
) -> dict[str, Any]:
    """Simulate every test at several true rates.

    Args:
        repeats: campaigns for each test and rate.
        progress: called with the number of lines done and their total.
        cases: threshold and design of each pair of tests.
    """
    lines = []
    tests = [
        (threshold, design, sequential_test(MIN_SATISFACTION, threshold, own, 0.95))
        for threshold, design in cases for own in (design, None)
    ]
    for number, (threshold, design, test) in enumerate(tests):
        limit, good = 1 - threshold, 1 - design
        fixed = plan_with_power(limit, test.confidence, good, test.confidence).runs
        truths = {'better': good / 2, 'design': good, 'threshold': limit, 'worse': 2 * limit}
        for place, (role, truth) in enumerate(truths.items()):
            lines.append(_simulated(test, role, truth, fixed, repeats, seed=10 * number + place))
            progress(len(lines), 4 * len(tests))
    return {
        'machine': machine_facts(), 'repeats': repeats, 'sequential': [asdict(one) for one in lines]
    }


def _simulated(
    test: SequentialTest, role: str, truth: float, fixed: int, repeats: int, *, seed: int
) -> Simulated:
    most = _MOST_RUNS * fixed
    random = np.random.default_rng(seed)
    ends: dict[Decision | None, int] = dict.fromkeys((*Decision, None), 0)
    runs = 0
    for _ in range(repeats):
        bad = np.cumsum(random.random(most) < truth)
        found, number = _first(test, bad)
        ends[found] += 1
        runs += number
    exact = operating(test, truth, most)
    return Simulated(
        test=str(test), satisfied=round(1 - truth, 12), role=role, most=most,
        passes=ends[Decision.PASS] / repeats, fails=ends[Decision.FAIL] / repeats,
        below_design=ends[Decision.BELOW_DESIGN] / repeats, open=ends[None] / repeats,
        exact_passes=exact.passes, mean_runs=runs / repeats, exact_mean_runs=exact.mean_runs,
        fixed_runs=fixed,
    )


def _first(test: SequentialTest, bad: Any) -> tuple[Decision | None, int]:
    """First decision on cumulated bad runs, and after how many."""
    for number, count in enumerate(bad.tolist(), 1):
        if (found := decision(test, count, number)) is not None:
            return found, number
    return None, len(bad)


def show(found: dict[str, Any], console: Console) -> None:
    """Print a table of the figures."""
    console.print(f'{found["repeats"]} campaigns for each line')
    table = make_table(('test',), (
        'satisfied', 'PASS', 'exact', 'FAIL', 'not design', 'open', 'runs', 'exact', 'fixed',
    ))
    last = ''
    for one in found['sequential']:
        table.add_row(
            '' if one['test'] == last else one['test'].removeprefix('min-satisfaction='),
            f'{100 * one["satisfied"]:.5g} %',
            *(f'{100 * one[name]:.1f} %' for name in (
                'passes', 'exact_passes', 'fails', 'below_design', 'open')),
            *(f'{one[name]:,.0f}' for name in ('mean_runs', 'exact_mean_runs', 'fixed_runs')),
        )
        last = one['test']
    console.print(table)
    console.print(
        'test: --until min-satisfaction=…; satisfied: the true share; not design: ended as not as '
        'good as the design; open: no decision within six times the fixed number; runs: on '
        'average; fixed: runs of a campaign judged once that errs as seldom', style='dim',
        soft_wrap=True,
    )


def main(words: Sequence[str] | None = None) -> int:
    """Simulate and print."""
    given = options(__doc__, repeats=40).parse_args(words)
    return run_study(partial(measure_sequential, given.repeats), show, as_json=given.json)


if __name__ == '__main__':
    leave(main)
