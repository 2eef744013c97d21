"""``taxinet experiment FILE --perception NETWORK``: the file's scenes, another network."""

from __future__ import annotations

from pathlib import Path

import pytest

from taxinet_ros.campaign.experiment import find_experiment, read_experiment, with_network
from taxinet_ros.errors import UsageError


def test_given_an_experiment_when_another_network_is_named_then_all_arms_have_it():
    experiment = read_experiment(find_experiment('shadows'))
    other = with_network(experiment, 'truth')
    assert {arm.perception for arm in experiment.arms} == {'original'}
    assert [arm.perception for arm in other.arms] == ['truth', 'truth']
    assert [arm.laid_over for arm in other.arms] == [arm.laid_over for arm in experiment.arms]


def test_given_arms_that_differ_in_their_network_then_the_option_is_refused(tmp_path: Path):
    path = tmp_path / 'nets.yaml'
    path.write_text('program: nominal\nruns: 2\narms:\n  a: {perception: truth}\n'
                    '  b: {perception: original}\n')
    with pytest.raises(UsageError, match='--perception truth: the arms of nets differ in their'):
        with_network(read_experiment(path), 'truth')


def test_given_no_such_network_then_it_is_refused():
    with pytest.raises(UsageError, match='lost'):
        with_network(read_experiment(find_experiment('shadows')), 'lost')
