"""Bounds and rates as users write them."""

from __future__ import annotations

import math

import pytest

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import (
    Assumptions,
    Monitor,
    parse_assumptions,
    parse_bounds,
    parse_rates,
    parse_spec,
)


def test_given_bounds_when_read_then_the_monitor_takes_them() -> None:
    bounds = parse_bounds(['cte=-25:25', ' he = -0.5 : 5e-1', 'x=0:inf'])
    assert bounds == {'cte': (-25.0, 25.0), 'he': (-0.5, 0.5), 'x': (0.0, math.inf)}
    monitor = Monitor(parse_spec('phi_always'), 1, bounds=bounds)
    assert monitor.push(0, {'cte': 0.0}).lower == -23.5


def test_given_rates_when_read_then_the_monitor_takes_them() -> None:
    rates = parse_rates(['cte=3', 'he= 0'])
    assert rates == {'cte': 3.0, 'he': 0.0}
    monitor = Monitor(parse_spec('phi_always'), 10**9, rates=rates)
    assert monitor.push(0, {'cte': 0.0}).lower == pytest.approx(-1.5, abs=1e-4)
    assert parse_bounds([]) == parse_rates([]) == {}


@pytest.mark.parametrize(
    ('texts', 'message'),
    [
        (['cte'], "bound 'cte': expected SIGNAL=..., e.g. cte=-25:25"),
        (['lateral=0:1'], "unknown signal 'lateral'; known: cte"),
        (['cte=0:1', 'cte=0:2'], 'cte has one already'),
        (['cte=25'], r'expected LOW:HIGH with LOW <= HIGH \[m\], e.g. cte=-25:25'),
        (['cte=2:1'], 'expected LOW:HIGH'),
        (['cte=a:b'], 'expected LOW:HIGH'),
        (['cte=nan:1'], 'expected LOW:HIGH'),
        (['cte=inf:inf'], 'expected LOW:HIGH'),
        (['he=0:1:2'], r'\[rad\], e.g. he='),
    ],
)
def test_given_bad_bounds_when_read_then_one_line_says_why(texts: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        parse_bounds(texts)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    ('texts', 'message'),
    [
        (['cte'], "rate 'cte': expected SIGNAL=..., e.g. cte=3"),
        (['cte=-1'], r'expected a number >= 0 \[m per s\], e.g. cte=3'),
        (['cte=inf'], 'expected a number'),
        (['cte=fast'], 'expected a number'),
        (['cte=1', 'cte=1'], 'cte has one already'),
        (['up=1'], "unknown signal 'up'"),
    ],
)
def test_given_bad_rates_when_read_then_one_line_says_why(texts: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_rates(texts)


def test_given_signals_of_another_robot_then_those_are_known_and_ours_are_not():
    found = parse_assumptions(['depth=0:40'], ['depth=2', 'yaw=0.5'], signals=['depth', 'yaw'])
    assert found == Assumptions(bounds={'depth': (0, 40)}, rates={'depth': 2, 'yaw': 0.5})
    assert found.about({'yaw'}) == Assumptions(rates={'yaw': 0.5})
    with pytest.raises(UsageError) as caught:
        parse_assumptions(['cte=0:1'], [], signals=['depth', 'yaw'])
    assert str(caught.value) == "bound 'cte=0:1': unknown signal 'cte'; known: depth, yaw"
    with pytest.raises(UsageError, match=r'rate .yaw=-1.: expected a number >= 0, e\.g\. yaw=3'):
        parse_assumptions([], ['yaw=-1'], signals=['depth', 'yaw'])
