"""Quantiles over runs with their intervals, and the front of two parameters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from campaign_records import write_campaign

from taxinet_ros.core.mtl.mine import parse_template
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.past_runs.mining import Trace, mine, quantile, step_ns
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.record.row import RunRow

STAMPS = [100_000_000 * step for step in range(31)]


def test_given_twenty_runs_then_the_median_and_its_interval_are_those_of_order_statistics() -> None:
    values = [float(value) for value in range(1, 21)]
    found = quantile(values[::-1], 0.5, rises=True, anytime=False)
    # 6th and 15th of 20: David and Nagaraja, Order Statistics, section 7.1.
    assert (found.value, found.tighter, found.looser) == (10.0, 6.0, 15.0)
    falling = quantile([-value for value in values], 0.5, rises=False, anytime=False)
    assert (falling.value, falling.tighter, falling.looser) == (-10.0, -6.0, -15.0)
    later = quantile(values, 0.5, rises=True, anytime=True)
    assert later.tighter < found.tighter
    assert later.looser > found.looser
    assert quantile(values, 0.95, rises=True, anytime=False).looser == math.inf
    assert quantile([1.0, 2.0, math.inf], 0.9, rises=True, anytime=False).value == math.inf
    assert quantile([1.0], 0.5, rises=False, anytime=False).tighter == math.inf


def test_given_many_samples_then_the_interval_holds_the_true_quantile_as_often_as_it_says() -> None:
    chance = np.random.default_rng(3)
    inside = 0
    for _ in range(400):
        found = quantile(chance.exponential(size=60).tolist(), 0.8, rises=True, anytime=False)
        inside += found.tighter <= -math.log(0.2) <= found.looser
    assert 370 <= inside < 400


def test_given_two_parameters_then_the_front_is_the_known_one() -> None:
    # Run k comes down to k from 30 + k by 1 each tenth of a second.
    traces = [
        Trace(STAMPS, {'cte': [30.0 + k - step for step in range(31)]}) for k in range(1, 11)
    ]
    template = parse_template('always[T:3](cte <= A)', STAMPS[1])
    found = list(mine(template, traces, 0.8, anytime=False, points=4))
    assert [one.other for one in found] == [0.0, 1.0, 2.0, 3.0]
    assert [one.value for one in found] == pytest.approx([38.0, 28.0, 18.0, 8.0])
    # From 1 s on nothing is gained by looking later.
    flat = [Trace(STAMPS, {'cte': [9.0] * 10 + [2.0] * 21})] * 3
    assert [one.other for one in mine(template, flat, 0.5, anytime=False, points=31)] == [0.0, 1.0]
    with pytest.raises(UsageError, match='A and B are both numbers'):
        list(mine(parse_template('always(cte <= A and he <= B)', 1), traces, 0.8, anytime=False,
                  points=4))


def test_given_runs_of_other_control_rates_then_times_are_mined_in_their_steps(tmp_path) -> None:
    for rates_hz, step in (((10,), 0.1), ((20, 20), 0.05), ((8, 10), 0.025),
                           ((30, 10), 1 / 30)):
        rows = [
            RunRow(run_id=f'run-{index}', index=index, program='nominal', seed=0,
                   perception='truth', outcome=Outcome.INTERRUPTED,
                   **scenario_from_human({'control_rate_hz': rate_hz}).to_human())
            for index, rate_hz in enumerate(rates_hz)
        ]
        folder = tmp_path / str(step)
        folder.mkdir()
        write_campaign(folder, rows)
        found = step_ns(open_campaign(folder))
        assert found == int(1e9 * step)
    odd = parse_template('always[T:2](cte <= 1)', 1_000_000_000 // 30).parameters[0]
    assert sorted(odd.times_s(2_000_000_000)) == [
        seq * 1_000_000_000 // 30 / 1e9 for seq in range(61)]
    stamps = [50_000_000 * seq for seq in range(41)]
    (parameter,) = (template := parse_template('always[T:2](cte <= 1)', 50_000_000)).parameters
    late = {'cte': [9.0] * 7 + [0.0] * 34}
    assert template.tightest(parameter, {}, stamps, late) == pytest.approx(0.35)
