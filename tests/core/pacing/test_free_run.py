"""The bookkeeping of free runs: what holds when, what is settled, who is waited for."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.pacing.free_run import FreeRun, FreeRunAccount, Pace
from taxinet_ros.core.pacing.lockstep import WINDOW
from taxinet_ros.core.pacing.timing import free_timing, is_free, parse_timing
from taxinet_ros.errors import UsageError

EYES, WHEEL, JUDGE, TAPE = 'perception', 'steering_controller', 'mtl_monitor', 'recorder'


def free_run(last_seq: int = 20, factor: float = 1.0) -> FreeRun:
    """One whose nodes are ready."""
    run = FreeRun(participants=(EYES, WHEEL, JUDGE, TAPE), chain=(EYES, WHEEL),
                  followers=(JUDGE, TAPE), last_seq=last_seq, factor=factor)
    for node in (EYES, WHEEL, JUDGE, TAPE):
        run.ready(node)
    assert run.all_ready
    return run


def follow(run: FreeRun, finished: int) -> None:
    """Monitor and recorder have all that is out, and are done with the settled."""
    for node in (JUDGE, TAPE):
        run.progress(node, max(finished, 0), run.seq)


def test_r5_given_a_late_answer_then_it_holds_from_the_next_frame_on():
    run = free_run()
    for seq in range(6):
        run.begin(seq, seq * 0.1)
        if seq == 2:
            assert run.answer(EYES, 0, 0.25)
            assert run.answer(WHEEL, 0, 0.26)
    assert run.account.applied == [-1, -1, -1, 0, 0, 0]
    figures = run.account.figures()
    assert (figures['unanswered'], figures['late'], figures['frames']) == (5, 2, 6)
    assert figures['perception_wall_max_s'] == pytest.approx(0.25)
    assert figures['loop_simulated_median_s'] == pytest.approx(0.3)
    assert figures['factor'] == pytest.approx(1.0)


def test_r5_given_an_answer_to_an_older_frame_than_one_answered_then_it_has_no_effect():
    run = free_run()
    for seq in range(4):
        run.begin(seq, seq * 0.1)
    assert run.answer(WHEEL, 2, 0.31)
    assert not run.answer(WHEEL, 1, 0.32)
    assert not run.answer(WHEEL, 2, 0.33), 'the first answer counts'
    run.begin(4, 0.4)
    assert (run.account.applied[-1], run.account.stale) == (2, 1)


@given(st.data())
def test_r5_given_any_order_of_answers_then_every_frame_is_settled_once_and_what_came_is_kept(data):
    last = data.draw(st.integers(1, 25))
    run = free_run(last)
    lacking: dict[str, list[int]] = {EYES: [], WHEEL: []}
    settled: list[int] = []

    def settle() -> None:
        before = run.settled
        unestimated, uncommanded = run.settle()
        settled.extend(range(before + 1, run.settled + 1))
        lacking[EYES] += unestimated
        lacking[WHEEL] += uncommanded
        follow(run, run.settled)

    for seq in range(last + 1):
        run.begin(seq, seq * 0.1)
        settle()
        for frame in data.draw(st.lists(st.integers(0, seq), max_size=4)):
            node = data.draw(st.sampled_from([EYES, WHEEL]))
            run.answer(node, frame, seq * 0.1 + 0.05)
    run.closed = True
    for _ in range(2 * last + 9):
        settle()
    assert settled == list(range(last + 1))
    assert run.complete
    account = run.account
    assert lacking[WHEEL] == [s for s in settled if math.isnan(account.command_s[s])]
    assert set(lacking[EYES]) <= {s for s in settled if math.isnan(account.estimate_s[s])}
    assert set(lacking[EYES]) <= set(lacking[WHEEL]), 'a command is made from an estimate'
    # No command of the future holds, and none is followed by that of an older frame.
    assert all(held < seq for seq, held in enumerate(account.applied))
    assert account.applied == sorted(account.applied)
    words = account.to_words()
    assert FreeRunAccount.from_words(words).to_words() == words


def test_r5_given_followers_that_lag_then_there_is_no_room_for_another_frame():
    run = free_run(100)
    for seq in range(WINDOW):
        assert run.room
        run.begin(seq, seq * 0.1)
    assert not run.room
    run.progress(JUDGE, 0, 5)
    assert not run.room, 'the recorder still lags'
    run.progress(TAPE, 0, 5)
    assert run.room


def test_r5_given_a_node_that_is_silent_then_the_first_of_the_chain_is_named():
    run = free_run()
    run.begin(0, 100.0)
    assert run.silent(109.9, 10.0) == ''
    assert run.silent(110.1, 10.0) == EYES
    run.answer(EYES, 0, 105.0)
    run.progress(JUDGE, 0, 0, 105.0)
    run.progress(TAPE, 0, 0, 105.0)
    assert run.silent(110.1, 10.0) == WHEEL
    assert free_run().missing() == []


def test_r5_given_a_recorder_that_hangs_then_it_is_named_and_not_who_gets_no_frames_for_it():
    run = free_run(100)
    run.begin(0, 0.0)
    run.progress(TAPE, 0, 0, 0.01)
    for node in (EYES, WHEEL):
        run.answer(node, 0, 0.02)
    run.progress(JUDGE, 0, 0, 0.03)
    assert run.silent(60.0, 10.0) == TAPE


def test_r5_given_a_pace_then_what_is_late_is_counted_and_a_lost_step_is_not_caught_up():
    pace = Pace(2.0)
    pace.begin(0.0)
    assert not pace.due(0.049)
    assert pace.due(0.05)
    assert not pace.out(0.052), '4 % of a step'
    assert pace.due(0.1), 'and a little lateness is caught up'
    assert pace.out(0.25), 'three steps late'
    assert not pace.due(0.299)
    unlimited = Pace(0.0)
    unlimited.begin(7.0)
    assert unlimited.due(7.0)
    assert not unlimited.out(9.0), 'there is no pace to fall behind'


@pytest.mark.parametrize(('factor', 'words'), [
    ('1', 'free real_time_factor=1'), ('0.1', 'free real_time_factor=0.1'),
    ('max', 'free real_time_factor=max'), ('0', 'free real_time_factor=max'),
])
def test_r5_given_a_free_run_then_its_words_read_back(factor, words):
    timing = free_timing(factor)
    assert (timing.words, parse_timing(words)) == (words, timing)
    assert is_free(words)
    assert not is_free('latency perception=0.1')


@pytest.mark.parametrize('factor', ['0.05', '-1', '101', 'nan', 'fast', ''])
def test_r5_given_a_factor_that_cannot_be_then_one_line_says_so(factor):
    with pytest.raises(UsageError, match=r'^real_time_factor .*: needs to be within 0\.1\.\.100'):
        free_timing(factor)
