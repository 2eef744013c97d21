"""Recordings from before the crossing could be taken away have it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from taxinet_ros.bag.message_values import SCENARIO_FIELDS, scenario_of
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.scenario import Scenario


def message(**changes):
    scene = Scenario()
    values = {name: getattr(scene, key) for key, name in SCENARIO_FIELDS.items()} | changes
    return SimpleNamespace(**values)


def test_given_a_message_without_the_field_then_there_is_a_crossing():
    old = message()
    del old.crossing
    assert scenario_of(old) == Scenario(crossing=True)
    assert scenario_of(message(crossing=False)) == Scenario(crossing=False)
    del old.shadows
    with pytest.raises(AttributeError):
        scenario_of(old)


def test_given_a_row_without_the_column_then_it_has_a_crossing_if_it_has_a_scene():
    rejected = RunRow(run_id='r', index=0, program='p', seed=0, perception='truth',
                      outcome=Outcome.REJECTED)
    for shadows, crossing in ((None, None), (False, True)):
        values = {**rejected.to_json(), 'shadows': shadows}
        del values['crossing']
        assert RunRow.from_json(values).crossing is crossing
    assert RunRow.from_json({**rejected.to_json(), 'crossing': False}).crossing is False
