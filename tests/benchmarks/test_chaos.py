"""Short chaos leaves nothing broken."""

from __future__ import annotations

import json

import chaos
import pytest
from chaos import FAULTS, NOT_RESUMED, RESUMED

pytestmark = pytest.mark.nightly

SEED = 4764
"""Its first trial is a falsification that is killed, resumed, and disturbed once more."""


@pytest.mark.ros
def test_given_short_chaos_then_nothing_is_broken(capsys):
    assert {*RESUMED, *NOT_RESUMED} == set(FAULTS), 'every fault is drawn'
    assert chaos.main(['--seed', str(SEED), '--trials', '1', '--json']) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report['trials'], report['found']) == (1, {})
    assert report['rows_compared'] == 8
    assert report['faults']['campaign killed'] == {'-9': 1}
    assert sum(times for ends in report['faults'].values() for times in ends.values()) >= 2
