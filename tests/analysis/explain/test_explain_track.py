"""Which moments of a run are looked into, and how they are put in words."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.analysis.explain.explain import error_words, misled_words
from taxinet_ros.analysis.explain.report import TEXT
from taxinet_ros.analysis.explain.track import APART_NS, Track, choose_rows
from taxinet_ros.analysis.report.text import sentences
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.types import NO_ESTIMATE, TrackingError

APART = APART_NS // CONTROL_PERIOD_NS


def track(error_m, *, cte_m=None, recorded=None, he_rad=None):
    """A run on the centreline, unless said otherwise, with these errors of the estimate."""
    error = np.asarray(error_m, float)
    zero = np.zeros(len(error))
    true = zero if cte_m is None else np.asarray(cte_m, float)
    heading = zero if he_rad is None else np.asarray(he_rad, float)
    return Track(
        seq=np.arange(len(error)), t_s=np.arange(len(error)) / 10, x_m=zero, cte_m=true,
        he_rad=heading, est_cte_m=true + error, est_he_rad=np.where(np.isnan(error), np.nan, 0.0),
        rec_cte_m=true + error if recorded is None else np.asarray(recorded, float),
        rec_he_rad=np.where(np.isnan(error), np.nan, 0.0), gains=SteeringGains(), states={},
        differs='',
    )


def test_given_errors_then_the_worst_that_are_a_second_apart_and_the_start_are_chosen():
    error = np.zeros(60)
    error[[20, 21, 29, 30, 45]] = 5.0, -6.0, 5.5, 4.0, 3.0
    assert choose_rows(track(error), 3) == (0, 21, 45)
    assert choose_rows(track(error), 4) == (0, 10, 21, 45)
    assert choose_rows(track(error), 1) == (21,)
    assert choose_rows(track(error), 2) == (0, 21)


def test_given_the_aircraft_off_the_runway_then_what_comes_after_is_not_chosen():
    error, cte_m = np.linspace(0, 6, 61), np.zeros(61)
    cte_m[40:42] = default_runway().half_width_m + 1
    run = track(error, cte_m=cte_m)
    assert run.steps_on_runway == 40
    assert choose_rows(run, 3) == (0, 29, 39)
    turned = np.zeros(61)
    turned[30:] = math.radians(50)
    assert max(choose_rows(track(error, he_rad=turned), 3)) == 29


def test_given_steps_without_an_answer_then_they_are_chosen_last():
    error = np.full(40, np.nan)
    error[25] = 1.0
    assert choose_rows(track(error), 1) == (25,)


@given(
    st.lists(st.floats(-9, 9, allow_nan=False), min_size=1, max_size=80), st.integers(1, 8),
)
def test_given_any_errors_then_rows_are_apart_and_start_with_the_first(errors, frames):
    rows = choose_rows(track(errors), frames)
    assert 1 <= len(rows) <= frames
    assert all(b - a >= APART for a, b in itertools.pairwise(rows))
    assert frames == 1 or rows[0] == 0


def test_given_estimates_of_now_then_the_change_from_the_recorded_ones_is_told():
    assert track([1.0, 2.0]).greatest_change == (0.0, 0.0)
    assert track([1.0, 2.0], recorded=[1.0, 2.5]).greatest_change == (0.5, 0.0)
    assert track([1.0, np.nan], recorded=[1.0, 2.5]).greatest_change[0] == math.inf


def test_given_errors_then_words_tell_the_side():
    assert error_words(TrackingError(cte_m=1.24, he_rad=math.radians(-3))) == (
        '1.2 m left, nose 3° right')
    assert error_words(TrackingError(cte_m=-0.01, he_rad=0.0)) == '0.0 m, nose 0°'
    assert error_words(NO_ESTIMATE) == 'no estimate'
    # Thought to be too far left, the aircraft is turned to the right.
    assert misled_words(math.radians(12)) == (
        'the estimate asks for a heading 12° too far right')
    assert misled_words(math.radians(-12)) == (
        'the estimate asks for a heading 12° too far left')
    assert misled_words(math.nan) == 'no estimate, so the aircraft brakes'


@pytest.mark.parametrize(('outcome', 'end'), [
    ('PASS', ', and the run passed.'),
    ('FAIL', ': the run failed, but the network is probably not the reason.'),
    ('', ': if the run failed, the network is probably not the reason.'),
])
def test_of_a_run_that_passed_it_is_not_asked_whether_it_failed(outcome, end):
    (said,) = sentences(TEXT, 'hardly', misled_deg=1.84, outcome=outcome)
    assert said.endswith(f'by 1.8° at most{end}')
