"""What decides a verdict: as a campaign records it, and as messages and bags say it."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.errors import UsageError

WHOLE = Judging(
    specs=('phi_always', 'near=always(abs(cte) <= 2)'), stop_on=StopOn.DECIDED,
    bounds=('cte=-25:25',), rates=('cte=3', 'he=0.5'),
)


def test_given_the_facts_of_a_judging_when_read_back_then_it_judges_the_same():
    back = Judging.from_facts(json.loads(json.dumps(WHOLE.facts())))
    assert back.parsed_specs == WHOLE.parsed_specs
    assert (back.names, back.headline) == (('phi_always', 'near'), 'phi_always')
    assert (back.stop_on, back.bounds, back.rates) == (WHOLE.stop_on, WHOLE.bounds, WHOLE.rates)
    assert dict(back.assumptions.rates) == {'cte': 3.0, 'he': 0.5}
    assert dict(back.assumptions.bounds) == {'cte': (-25.0, 25.0)}


def test_given_records_and_messages_of_before_there_was_a_choice_then_runs_go_to_their_end():
    assert Judging.from_facts({'specs': {'a': 'cte > 0'}}) == Judging(specs=('a=cte > 0',))
    assert Judging.from_facts({}) == Judging(specs=())
    assert Judging.from_message(SimpleNamespace(specs=['a'])) == Judging(specs=('a',))
    whole = SimpleNamespace(
        specs=list(WHOLE.specs), stop_on='decided', bounds=list(WHOLE.bounds),
        rates=list(WHOLE.rates),
    )
    assert Judging.from_message(whole) == WHOLE


def test_given_an_unknown_rule_to_stop_then_it_is_refused_by_name():
    with pytest.raises(UsageError, match='stop_on sometimes: unknown; known: never, violated'):
        Judging.from_facts({'stop_on': 'sometimes'})
