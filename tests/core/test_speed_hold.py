from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.speed_hold import SpeedGains, SpeedHold

GAINS = SpeedGains(lever_per_mps=0.5, lever_per_m=0.1, brake_per_lever=2.0, rolling_lever=0.1)


def test_given_the_wanted_speed_when_updated_then_the_lever_stays_in_balance() -> None:
    hold = SpeedHold(GAINS)

    assert [hold.update(5.0, 5.0, 0.1) for _ in range(3)] == [(0.1, 0.0)] * 3


def test_given_too_little_speed_when_updated_then_the_lever_opens_and_goes_on_opening() -> None:
    hold = SpeedHold(GAINS)
    levers = [hold.update(5.0, 4.8, 0.1) for _ in range(20)]

    assert levers[0][0] > 0.19
    assert levers[-1][0] > levers[0][0]
    assert {brake for _, brake in levers} == {0.0}


def test_given_too_much_speed_when_updated_then_the_brakes_follow_the_closed_lever() -> None:
    lever, brake = SpeedHold(GAINS).update(5.0, 5.4, 0.1)

    assert lever == 0.0
    assert 0.0 < brake < 1.0


def test_given_a_stop_when_updated_then_the_brakes_are_full_and_the_integral_starts_again() -> None:
    hold = SpeedHold(GAINS)
    for _ in range(50):
        hold.update(5.0, 0.0, 0.1)

    assert hold.update(0.0, 4.0, 0.1) == (0.0, 1.0)
    assert hold.update(5.0, 5.0, 0.1) == SpeedHold(GAINS).update(5.0, 5.0, 0.1)


@given(speeds=st.lists(st.tuples(st.floats(0, 20), st.floats(-5, 30)), min_size=1, max_size=50))
def test_given_any_speeds_when_updated_then_lever_and_brake_are_in_range_and_exclusive(
    speeds: list[tuple[float, float]],
) -> None:
    hold = SpeedHold(GAINS)
    answers = [hold.update(wanted_mps, actual_mps, 0.1) for wanted_mps, actual_mps in speeds]

    assert len(answers) == len(speeds)
    assert all(0 <= lever <= 1 and 0 <= brake <= 1 for lever, brake in answers)
    assert all(lever == 0 or brake == 0 for lever, brake in answers)
