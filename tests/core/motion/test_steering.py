from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.motion.controller import GAIN_RANGES, STOP, SteeringGains, steer
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.errors import UsageError

GAINS = SteeringGains()
metres = st.floats(-50, 50)
angles = st.floats(-math.pi, math.pi)


def command(cte_m: float, he_deg: float, gains: SteeringGains = GAINS) -> TaxiCommand:
    return steer(TrackingError(cte_m=cte_m, he_rad=math.radians(he_deg)), gains)


@pytest.mark.parametrize(
    ('cte_m', 'he_deg', 'steering_deg'),
    [
        (0.0, 0.0, 0.0),
        (1.0, 0.0, -6.4),  # left of the centreline: turn right by 1.6 * 4
        (0.0, 5.0, -8.0),  # nose left: turn right by 1.6 * 5
        (2.0, -8.0, 0.0),  # on the wanted heading
        (-1.0, 0.0, 6.4),
        (8.0, -30.0, -3.2),  # wanted: -32 degrees
        (12.0, -30.0, -8.0),  # wanted: -35 degrees, the steepest
        (8.0, 30.0, -15.0),
        (-8.0, -30.0, 15.0),
    ],
)
def test_given_an_error_when_steering_then_the_cascade_answers(
    cte_m: float, he_deg: float, steering_deg: float
) -> None:
    answer = command(cte_m, he_deg)

    assert math.degrees(answer.steering_rad) == pytest.approx(steering_deg, abs=1e-9)
    assert answer.speed_mps == 5.0


@given(cte_m=metres, he_rad=angles)
def test_given_any_error_when_mirrored_then_the_answer_is_mirrored_and_in_range(
    cte_m: float, he_rad: float
) -> None:
    answer = steer(TrackingError(cte_m=cte_m, he_rad=he_rad), GAINS)
    mirrored = steer(TrackingError(cte_m=-cte_m, he_rad=-he_rad), GAINS)

    assert abs(answer.steering_rad) <= GAINS.max_steering_rad
    assert mirrored.steering_rad == -answer.steering_rad


@given(cte_m=metres, he_rad=angles, more_m=st.floats(0, 10), more_rad=st.floats(0, 1))
def test_given_a_larger_error_when_steering_then_it_steers_no_less_to_the_right(
    cte_m: float, he_rad: float, more_m: float, more_rad: float
) -> None:
    less = steer(TrackingError(cte_m=cte_m, he_rad=he_rad), GAINS)
    more = steer(TrackingError(cte_m=cte_m + more_m, he_rad=he_rad + more_rad), GAINS)

    assert more.steering_rad <= less.steering_rad


@pytest.mark.parametrize(
    'error',
    [
        TrackingError(cte_m=1.0, he_rad=0.1, valid=False),
        TrackingError(cte_m=math.nan, he_rad=0.1),
        TrackingError(cte_m=1.0, he_rad=math.nan),
        TrackingError(cte_m=math.inf, he_rad=0.1),
        TrackingError(cte_m=1.0, he_rad=-math.inf),
    ],
)
def test_given_an_unusable_estimate_when_steering_then_it_stops_straight(
    error: TrackingError,
) -> None:
    assert steer(error, GAINS) == STOP == TaxiCommand(steering_rad=0.0, speed_mps=0.0)


def test_given_other_gains_when_steering_then_each_of_them_counts() -> None:
    assert command(1.0, 0.0, SteeringGains(cte_gain_rad_per_m=0.0)).steering_rad == 0
    assert command(9.0, -10.0, SteeringGains(max_intercept_rad=math.radians(10))).steering_rad == (
        pytest.approx(0, abs=1e-12)
    )
    assert command(0.0, 5.0, SteeringGains(heading_gain=0.0)).steering_rad == 0
    assert command(9.0, 9.0, SteeringGains(max_steering_rad=0.1)).steering_rad == -0.1
    assert command(0.0, 0.0, SteeringGains(speed_mps=3.0)).speed_mps == 3.0


def test_given_the_table_of_ranges_when_compared_then_it_names_every_gain() -> None:
    assert list(GAIN_RANGES) == [field.name for field in dataclasses.fields(SteeringGains)]
    assert all(valid.low < valid.high and valid.description for valid in GAIN_RANGES.values())


@pytest.mark.parametrize('name', list(GAIN_RANGES))
@pytest.mark.parametrize('value', [math.nan, math.inf, -1e-6, 1e6])
def test_given_a_gain_out_of_range_when_constructed_then_one_line_says_so(
    name: str, value: float
) -> None:
    with pytest.raises(UsageError, match=rf'^steering: {name} is .*, outside .*$') as caught:
        SteeringGains(**{name: value})
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('name', list(GAIN_RANGES))
def test_given_the_ends_of_a_range_when_constructed_then_they_are_valid(name: str) -> None:
    low, high = GAIN_RANGES[name].low, GAIN_RANGES[name].high

    assert getattr(SteeringGains(**{name: low}), name) == low
    assert getattr(SteeringGains(**{name: high}), name) == high
