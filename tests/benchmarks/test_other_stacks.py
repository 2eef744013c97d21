"""Where not every bit can be the same, the differences stay where benchmarks/RESULTS.md says."""

from __future__ import annotations

import numpy as np
import pytest
from other_stacks import compared, measure, traces

APART_M, APART_RAD = 1e-4, 1e-5
TRAJECTORY_M = 0.02


@pytest.mark.nightly
def test_given_torch_in_place_of_onnxruntime_then_answers_and_path_differ_within_the_tolerance():
    found = compared(traces('another process', 1, 1.0), measure('torch', 1, 1.0))
    assert found['frames'] == 11
    assert 0 < found['apart_cte_m'] < APART_M
    assert 0 < found['apart_he_rad'] < APART_RAD
    assert found['cte_m'] < TRAJECTORY_M
    assert found['verdicts'] == 0


def test_given_runs_that_differ_in_one_step_then_the_comparison_finds_it():
    one = {name: np.zeros((2, 3)) for name in ('x_m', 'cte_m', 'he_rad', 'est_cte_m', 'est_he_rad')}
    one |= {'rho': np.array([1.0, -1.0]), 'picture': np.ones((2, 3)), 'apart': np.zeros((1, 2))}
    other = {name: values.copy() for name, values in one.items()}
    other['cte_m'][1, 2] = -0.5
    other['picture'][1, 2] = 7
    other['rho'][0] = -0.25
    found = compared(one, other)
    assert (found['cte_m'], found['rho'], found['x_m']) == (0.5, 1.25, 0.0)
    assert (found['pictures'], found['first pictures'], found['verdicts']) == (1, 0, 1)
    assert compared(one, one)['verdicts'] == 0
