"""Trouble and outcomes keep their meaning wherever they travel."""

import pickle

from taxinet_ros.core.errors import InfraError
from taxinet_ros.core.outcome import Outcome


def test_given_trouble_in_a_worker_process_then_it_arrives_with_kind_name_and_step():
    facts = ('sim', 'simulator', 7, 'not finite')
    error = pickle.loads(pickle.dumps(InfraError(*facts)))
    assert (error.kind, error.who, error.step, error.detail) == facts
    assert str(error) == 'sim: simulator at step 7: not finite'


def test_given_the_five_outcomes_then_only_pass_and_fail_carry_a_robustness():
    assert [outcome for outcome in Outcome if outcome.judged] == [Outcome.PASS, Outcome.FAIL]
    assert len(Outcome) == 5
