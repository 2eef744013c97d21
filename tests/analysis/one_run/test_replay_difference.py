"""Recorded and replayed answers are held against each other step by step."""

import math
import warnings

import numpy as np
import pytest

from taxinet_ros.analysis.one_run.replay import difference, plot_replay, quantities

NAN, INF = math.nan, math.inf
SEQ = np.arange(5)


def compared(recorded, replayed, name='est_cte_m', seqs=SEQ):
    trace = {'seq': SEQ, 't_ns': SEQ * 10**8, name: np.array(recorded)}
    (quantity,) = quantities(trace, (name,))
    answers = {'seq': np.array(seqs, float), name: np.array(replayed, float)}
    return difference(quantity, trace, answers)


@pytest.mark.parametrize(
    ('recorded', 'replayed', 'equal', 'first', 'mean', 'greatest'),
    [
        ([1.0, 2, 3, 4, 5], [1.0, 2, 3, 4, 5], 5, None, 0.0, 0.0),
        ([1.0, 2, 3, 4, 5], [1.0, 2, 4, 4, 3], 3, 2, 0.6, 2.0),
        ([1.0, NAN, 3, 4, 5], [1.0, NAN, 3, 4, 5], 5, None, 0.0, 0.0),
        ([1.0, NAN, 3, 4, 5], [1.0, 2, 3, 4, 5], 4, 1, 0.0, INF),
        ([-INF, -INF, 1.0, 1, 1], [-INF, -INF, 1.0, 1, 1.5], 4, 4, 0.1, 0.5),
        ([-INF, -INF, 1.0, 1, 1], [-INF, INF, 1.0, 1, 1], 4, 1, 0.0, INF),
        ([0.0, 0, 0, 0, 0], [0.0, -0.0, 0, 0, 0], 4, 1, 0.0, 0.0),
    ],
)
def test_given_two_series_then_steps_and_distances_are_right(
    recorded, replayed, equal, first, mean, greatest
):
    found = compared(recorded, replayed)
    assert (found.equal_steps, found.first_seq, found.greatest) == (equal, first, greatest)
    assert found.mean == pytest.approx(mean)


def test_given_answers_missing_then_their_steps_differ():
    found = compared([1.0, 2, 3, 4, 5], [1.0, 2, 3], seqs=[0, 1, 2])
    assert (found.equal_steps, found.first_seq, found.greatest) == (3, 3, INF)


def test_given_radians_then_people_read_degrees():
    found = compared([0.0] * 5, [math.pi / 2] * 5, name='est_he_rad')
    assert (found.mean, found.greatest) == pytest.approx((90.0, 90.0))
    assert found.quantity.unit == 'deg'


def test_given_infinite_bounds_when_drawn_then_same_values_same_bytes(tmp_path):
    found = compared([-INF, -INF, 1.0, NAN, 1], [-INF, -INF, 1.0, 1, 1.5])
    trace = {'t_ns': SEQ * 10**8, 'cte_m': np.zeros(5)}
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        for name in ('a.png', 'b.png'):
            plot_replay(
                [found], trace, tmp_path / name, title='run', recorded='old', replayed='new'
            )
    assert (tmp_path / 'a.png').read_bytes() == (tmp_path / 'b.png').read_bytes()
