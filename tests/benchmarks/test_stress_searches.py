"""Searches for likely failures: equal steps, and figures by system and search."""

from __future__ import annotations

import json

import numpy as np
import pytest
import stress


def test_given_a_tree_then_it_has_as_many_steps_as_whole_paths_and_finds_failures() -> None:
    system = stress.SYSTEMS['integrator']
    paths = stress._tree(system, 1)
    assert len(paths) > system.runs  # a fork is shorter than a path
    assert {len(path) for path, _ in paths} == {system.steps}
    assert all(rho == system.rho(path) for path, rho in paths[:20])


@pytest.mark.nightly
def test_given_words_then_each_search_has_a_line_whose_ends_are_in_order(capsys) -> None:
    assert stress.main(['integrator', 'random', 'tree', '--repeats', '6', '--json']) == 0
    lines = json.loads(capsys.readouterr().out)['searches']
    assert [(one['system'], one['sampler']) for one in lines] == [
        ('integrator', 'random'), ('integrator', 'tree')]
    for one in lines:
        low, middle, high = (value or float('inf') for value in one['sigma'])
        assert stress.SYSTEMS['integrator'].least <= low <= middle <= high
    assert lines[1]['found'] == 1


def test_given_the_plant_undisturbed_then_it_stays_within_its_limit() -> None:
    system = stress.SYSTEMS['taxi']
    still = np.zeros(system.steps)
    assert 0 < system.rho(still) <= stress.LIMIT_M
    assert system.rho(still + 5) <= 0
