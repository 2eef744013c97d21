"""What a sample costs, counted in executed lines of the monitor: no clock, no machine."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import pytest

from taxinet_ros.core.mtl import Monitor, parse_formula, parse_spec, robustness
from taxinet_ros.errors import UsageError

pytestmark = pytest.mark.nightly

STEP = 100_000_000
WAVES: dict[str, Callable[[int], float]] = {
    'swings in': lambda i: 6 * math.exp(-i / 40) * math.cos(i / 15),
    'leaves': lambda i: 0.05 * i,
    'comes': lambda i: 50.0 - 0.05 * i,
    'swings': lambda i: 3 * math.cos(i / 15),
}


def lines(call: Callable[[], object]) -> int:
    """Number of lines that the monitor executes during a call."""
    count = 0

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal count
        if '/core/mtl/' not in frame.f_code.co_filename:
            return None
        count += event == 'line'
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
    return count


def online_cost(text: str, samples: int, wave: Callable[[int], float]) -> float:
    monitor = Monitor(parse_spec(text), samples * STEP, max_gap_ns=2 * STEP)

    def follow() -> None:
        for i in range(samples + 1):
            monitor.push(i * STEP, {'cte': wave(i)})

    total = lines(follow)
    assert monitor.reading.final
    return total / samples


@pytest.mark.parametrize('wave', WAVES)
@pytest.mark.parametrize(
    'text',
    [
        'always[0:{}](abs(cte) <= 1.5)',
        'eventually[0:{}](always(abs(cte) <= 1.5))',
        'eventually[0:{}](abs(cte) <= 1.5)',
    ],
)
def test_given_a_longer_window_or_run_when_monitored_then_a_sample_costs_the_same(
    text: str, wave: str
) -> None:
    costs = [
        online_cost(text.format(window_s), samples, WAVES[wave])
        for window_s, samples in ((10, 400), (10, 1600), (40, 1600), (150, 1600))
    ]
    assert 20 < max(costs) < 200
    assert max(costs) < 2 * costs[0]


@pytest.mark.parametrize('window', ['', '[0:10]', '[0:100]', '[3:100]'])
def test_given_a_longer_trace_when_evaluated_then_the_cost_is_linear(window: str) -> None:
    formula = parse_formula(f'eventually[0:10](always{window}(abs(cte) <= 1.5))')

    def cost(samples: int) -> int:
        stamps = [i * STEP for i in range(samples)]
        values = {'cte': [WAVES['swings'](i) for i in range(samples)]}
        robustness(formula, stamps[:2], {'cte': values['cte'][:2]})
        return lines(lambda: robustness(formula, stamps, values))

    assert cost(4000) < 4.5 * cost(1000)


@pytest.mark.parametrize(
    'text',
    [
        'always(eventually[0:5](cte < 0))',
        'eventually(always[0:5](cte < 0))',
        'always(cte < 0 implies eventually[0:5](cte > 1))',
        'eventually[0:5](always(eventually[0:2](cte < 0)))',
    ],
)
@pytest.mark.parametrize('wave', WAVES)
def test_t12_given_a_window_in_an_endless_one_when_the_run_is_longer_then_a_sample_costs_the_same(
    text: str, wave: str
) -> None:
    short, long = (online_cost(text, samples, WAVES[wave]) for samples in (200, 1600))
    assert long < 1.6 * short


@pytest.mark.parametrize(('word', 'deep'), [('until', 16), ('since', 16), ('release', 8)])
def test_t12_given_nested_bounded_pairs_when_one_level_is_added_then_the_cost_adds_too(
    word: str, deep: int
) -> None:
    def cost(depth: int) -> float:
        text = 'cte < 0'
        for _ in range(depth):
            text = f'({text}) {word}[0:3] (cte < 1)'
        return online_cost(f'eventually[0:1]({text})', 60, WAVES['swings'])

    # Twice as much at each level would be 16 times as much, or 4,096 times.
    assert cost(deep) < 8 * cost(4)


def test_t12_given_nested_bounded_pairs_when_evaluated_offline_then_the_cost_adds_too() -> None:
    def cost(depth: int) -> int:
        text = 'cte < 0'
        for _ in range(depth):
            text = f'({text}) until[1:3] (cte < 1)'
        formula = parse_formula(text)
        stamps = [i * STEP for i in range(60)]
        return lines(lambda: robustness(formula, stamps, {'cte': [0.0] * 60}))

    assert cost(16) < 5 * cost(4)


def test_t12_given_pairs_that_would_double_at_each_level_when_read_then_they_are_refused() -> None:
    text = 'cte < 0'
    for level in range(20):
        text = f'({text}) until[{level + 1}.{level}:100] (cte < 1)'
    with pytest.raises(UsageError, match='more than 1,000 parts, each level twice as many'):
        parse_spec(text)
