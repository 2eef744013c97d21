"""Distributions that cannot be drawn are refused with their line; tails of normals are exact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from taxinet_ros.scenes.search_space import Law

TOP = 'import numpy\nmodel runway_world\nego = new Plane at (0, 400)\n'
BAD_WEIGHTS = 'ValueError: the weights are {}; they have to be numbers of 0 or more, and one of'


@pytest.mark.one_in(4)
@pytest.mark.parametrize(('choice', 'message'), [
    ('VerifaiRange(0, 4, weights=[1, -0.5, 1])', BAD_WEIGHTS.format('[1, -0.5, 1]')),
    ('VerifaiRange(0, 4, weights=[0, 0])', BAD_WEIGHTS.format('[0, 0]')),
    ('VerifaiRange(0, 4, weights=[1, float("nan")])', BAD_WEIGHTS.format('[1, nan]')),
    ('VerifaiRange(0, 4, weights=[1, float("inf")])', BAD_WEIGHTS.format('[1, inf]')),
    ('VerifaiRange(0, 4, weights=[])', BAD_WEIGHTS.format('[]')),
    ('VerifaiRange(0, 4, weights=numpy.array([1, -2]))', BAD_WEIGHTS.format('[1, -2]')),
    ('VerifaiRange(0, 4, weights=[1, Range(0, 1)])', BAD_WEIGHTS.format('[1, Range(0.0, 1.0)]')),
    ('VerifaiRange(0, 1, weights=5)',
     'ValueError: the weights are 5; they have to be a list of numbers'),
    ('DiscreteRange(0, 1, weights=5)', 'ValueError: the weights are 5; they have to be a list'),
    ('DiscreteRange(0, 2, weights=(1, -1, 3))', BAD_WEIGHTS.format('[1, -1, 3]')),
    ('DiscreteRange(0, 2, weights=(0, 0, 0))', BAD_WEIGHTS.format('[0, 0, 0]')),
    ('DiscreteRange(0, 2, weights=())', BAD_WEIGHTS.format('[]')),
    ('VerifaiDiscreteRange(0, 1, weights=numpy.array([1, -2]))', BAD_WEIGHTS.format('[1, -2]')),
    ('Options({1: float("nan"), 2: 1})', BAD_WEIGHTS.format('[nan, 1]')),
    ('VerifaiRange(0, Range(3, 4), weights=[1, 2])',
     'ValueError: the ends of a VerifaiRange with weights are random'),
    ('DiscreteRange(3, 1)', 'ValueError: a DiscreteRange from 3 to 1 has no whole number'),
    ('DiscreteRange(Range(5, 6), 3)', 'ValueError: a DiscreteRange from 5 to 3 has no'),
    ('Range(0, float("inf"))', 'ValueError: the high end of a Range is inf; it has to be a finite'),
    ('Normal(float("nan"), 1)', 'ValueError: the mean of a Normal is nan'),
    ('Normal(1, float("inf"))', 'ValueError: the standard deviation of a Normal is inf'),
    ('TruncatedNormal(2, 1, float("nan"), 4)', 'ValueError: the low end of a TruncatedNormal is'),
    ('TruncatedNormal(100, 20, 290, 400)',
     'ValueError: a TruncatedNormal from 290 to 400 lies more than 5 standard deviations of 20'),
    ('TruncatedNormal(100, 20, -400, -90)', 'ValueError: a TruncatedNormal from -400 to -90 lies'),
    ('TruncatedNormal(2, 0, 1, 4)', 'ValueError: a TruncatedNormal from 1 to 4 lies more than'),
])
def test_a_distribution_that_cannot_be_drawn_is_refused_with_its_line_when_it_is_made(
    refused: Any, choice: str, message: str,
) -> None:
    refused(f'{TOP}param rain = {choice}\n', 4, message)


@pytest.mark.parametrize(('choice', 'values'), [
    ('Options({1: 0, 5: 1, 7: 2})', {5, 7}),
    ('DiscreteRange(0, 3, weights=numpy.array([0, 1, 0, 2]))', {1, 3}),
    ('VerifaiDiscreteRange(0, 3, weights=numpy.array([0, 1, 0, 2]))', {1, 3}),
    ('Normal(2, 0)', {2}),
])
def test_weights_and_deviations_of_zero_are_drawn_as_they_say(
    client: Any, compiled: Any, choice: str, values: set[float],
) -> None:
    assert 'error' not in compiled(f'{TOP}param rain = {choice}')
    drawn = [client.ask(op='scene', index=index)['values'] for index in range(12)]
    placed = [client.ask(op='scene', index=0, point=[u])['values'] for u in (0.0, 0.3, 0.5, 0.99)]
    for scenes in (drawn, placed):
        assert {scene['rain_percent'] for scene in scenes} == values


@pytest.mark.parametrize(('mean', 'stddev', 'low', 'high'), [
    (100, 20, 190, 400), *(pytest.param(*case, marks=pytest.mark.nightly) for case in [
        (100, 20, -400, 10), (0, 1, 2, float('inf')), (50, 1, -1000, 49),
    ]),
])
def test_a_truncated_normal_is_that_of_scipy_in_run_and_falsify(
    client: Any, write: Any, mean: float, stddev: float, low: float, high: float,
) -> None:
    right = truncnorm((low - mean) / stddev, (high - mean) / stddev, mean, stddev)
    shares = [0.001, 0.1, 0.5, 0.9, 0.999]
    law = Law(kind='TruncatedNormal', mean=mean, stddev=stddev, low=low,
              high=None if high == float('inf') else high)
    assert law.values(shares) == pytest.approx(right.ppf(shares), rel=1e-6)
    for given in (mean, f'Range({mean}, {mean})'):
        text = f'{TOP}param slope = TruncatedNormal({given}, {stddev}, {low}, float("{high}"))'
        assert client.ask(op='compile', program=str(write(text)))['named'] == []
        points = [[share] * (1 if given is mean else 2) for share in shares]
        placed = [client.ask(op='scene', index=0, point=point)['values']['slope_percent']
                  for point in points]
        assert placed == pytest.approx(right.ppf(shares), rel=1e-6)
        drawn = [client.ask(op='scene', index=index)['values']['slope_percent']
                 for index in range(80)]
        assert kstest(right.cdf(drawn), 'uniform').pvalue > 1e-3
        assert np.ptp(drawn) > 0


def test_a_truncated_normal_that_chance_puts_too_far_out_is_refused_when_it_is_drawn(
    client: Any, compiled: Any,
) -> None:
    assert 'error' not in compiled(f'{TOP}param rain = TruncatedNormal(Range(0, 1), 1, 30, 40)\n')
    for point in ({}, {'point': [0.5, 0.5]}):
        error = client.ask(op='scene', index=0, **point)['error']
        assert 'lies more than 5 standard deviations of 1 from its mean 0.' in error['message']


def test_floor_division_by_one_gives_whole_numbers(client: Any, compiled: Any) -> None:
    assert 'error' not in compiled(TOP + 'param rain = Range(20, 90) // 1')
    values = [client.ask(op='scene', index=0, point=[u])['values'] for u in (0.0, 0.31, 0.99)]
    assert [scene['rain_percent'] for scene in values] == [20, 41, 89]
