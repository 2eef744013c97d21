"""Time moves on only when everybody who must has answered, in whatever order answers arrive."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.pacing.lockstep import WINDOW, Lockstep, reports_progress

CHAIN = ('perception', 'steering_controller')
FOLLOWERS = ('mtl_monitor', 'recorder')
EVERYBODY = (*CHAIN, *FOLLOWERS)


def lockstep(last_seq: int = 300, participants: tuple[str, ...] = EVERYBODY) -> Lockstep:
    return Lockstep(
        participants=participants, chain=CHAIN, followers=FOLLOWERS, last_seq=last_seq
    )


def answered(protocol: Lockstep, seq: int) -> None:
    protocol.begin(seq)
    for node in CHAIN:
        assert protocol.answer(node, seq)


@pytest.fixture
def ready() -> Lockstep:
    protocol = lockstep()
    for node in EVERYBODY:
        protocol.ready(node)
    return protocol


@given(st.permutations(EVERYBODY))
def test_given_nodes_in_any_order_when_all_are_ready_then_only_the_last_completes_it(order):
    protocol = lockstep()
    assert [protocol.ready(node) for node in order] == [False, False, False, True]
    assert protocol.all_ready
    assert not protocol.ready(order[0]), 'a repeated report changes nothing'


def test_given_a_node_that_is_not_ready_then_it_is_named():
    protocol = lockstep()
    for node in CHAIN:
        protocol.ready(node)
    assert protocol.missing() == ['mtl_monitor', 'recorder']


def test_given_no_command_then_time_stands_still_and_the_first_silent_node_is_named(ready):
    ready.begin(0)
    assert not ready.may_advance
    assert ready.missing() == ['perception']
    ready.answer('perception', 0)
    assert ready.missing() == ['steering_controller']
    ready.answer('steering_controller', 0)
    assert ready.missing() == []
    assert ready.may_advance


def test_given_stale_repeated_or_unasked_answers_then_they_are_refused(ready):
    answered(ready, 0)
    ready.begin(1)
    assert not ready.answer('perception', 0), 'stale'
    assert not ready.answer('perception', 2), 'of a frame never shown'
    assert ready.answer('perception', 1)
    assert not ready.answer('perception', 1), 'repeated'


def test_given_a_recorder_that_lags_then_time_stops_before_its_queue_can_overflow(ready):
    steps = 0
    for seq in range(50):
        answered(ready, seq)
        ready.progress('mtl_monitor', seq)
        if not ready.may_advance:
            break
        steps += 1
    assert steps == WINDOW - 1
    assert ready.missing() == ['recorder']
    ready.progress('recorder', 3)
    assert ready.may_advance


def test_given_no_recorder_in_the_graph_then_nobody_waits_for_one():
    protocol = lockstep(participants=(*CHAIN, 'mtl_monitor'))
    for node in (*CHAIN, 'mtl_monitor'):
        protocol.ready(node)
    for seq in range(30):
        answered(protocol, seq)
        protocol.progress('mtl_monitor', seq)
        assert protocol.may_advance


def test_given_the_last_frame_then_the_run_is_complete_only_when_followers_have_seen_it():
    protocol = lockstep(last_seq=2)
    for node in EVERYBODY:
        protocol.ready(node)
    for seq in range(3):
        answered(protocol, seq)
    assert not protocol.complete
    assert protocol.missing() == ['mtl_monitor', 'recorder']
    protocol.progress('mtl_monitor', 2)
    protocol.progress('recorder', 2)
    assert protocol.complete
    assert not protocol.may_advance


@given(st.integers(0, 500), st.integers(0, 500))
def test_given_any_length_then_progress_is_reported_within_the_window_and_at_the_end(seq, last):
    if seq <= last - WINDOW:
        assert any(reports_progress(k, last) for k in range(seq, seq + WINDOW))
    assert reports_progress(last, last)
