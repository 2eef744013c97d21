"""A run as a state machine: a frame for each command, silence is named, and one ending."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from taxinet_ros.core.pacing.free_run import FreeRun
from taxinet_ros.core.pacing.lockstep import Lockstep
from taxinet_ros.core.pacing.stepped_run import Ending, SteppedRun
from taxinet_ros.core.topics import (
    CHAIN,
    FOLLOWERS,
    MTL_MONITOR,
    PARTICIPANTS,
    PERCEPTION,
    RECORDER,
    STEERING_CONTROLLER,
)
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError

STEP_NS = 100_000_000
ERROR = TrackingError(cte_m=1.0, he_rad=0.1)
GO, LATER = (TaxiCommand(steering_rad=0.1, speed_mps=speed) for speed in (5.0, 6.0))
PASSED = SimpleNamespace(complete=True, stopped_early=False, satisfied=True)


class Graph:
    """What a run does on its graph, and what it finds there."""

    def __init__(self, last_seq: int = 2, factor: float | None = None) -> None:
        self.now_s, self.frame = 0.0, -1
        self.said: list[Any] = []
        self.commands: list[TaxiCommand] = []
        self.finished: list[Ending] = []
        self.foreign: tuple[str, str] | None = None
        self.deaf: list[str] = []
        roles: dict[str, Any] = {
            'participants': PARTICIPANTS, 'chain': CHAIN, 'followers': FOLLOWERS,
            'last_seq': last_seq,
        }
        self.run = SteppedRun(
            self, Lockstep(**roles) if factor is None else FreeRun(**roles, factor=factor),
            participants=PARTICIPANTS, first=GO, late=lambda seq, command: command,
            answer_timeout_s=10.0, ready_timeout_s=30.0, clock=lambda: self.now_s,
        )

    def advance(self, command: TaxiCommand) -> None:
        self.commands.append(command)

    def observe(self) -> SimpleNamespace:
        self.frame += 1
        return SimpleNamespace(seq=self.frame)

    def publish(self, frame: SimpleNamespace) -> None:
        self.said.append(frame.seq)

    def settle(self, unestimated: list[int], uncommanded: list[int]) -> None:
        self.said.append((unestimated, uncommanded))

    def start(self) -> None:
        self.said.append('start')

    def announce(self, ending: Ending) -> None:
        self.said.append(ending.outcome)

    def finish(self, ending: Ending) -> None:
        self.finished.append(ending)

    def held(self) -> None:
        self.said.append('held')

    def unmatched(self) -> list[str]:
        return self.deaf

    def intruder(self) -> tuple[str, str] | None:
        return self.foreign

    def why_not_ready(self) -> tuple[str, str, str]:
        return 'not_ready', ', '.join(self.run.lockstep.missing()), 'is not there'

    def why_silent(self, who: str) -> str:
        return 'does not publish' if who == STEERING_CONTROLLER else ''

    # What nodes do

    def get_ready(self) -> None:
        for name in PARTICIPANTS:
            self.run.ready(name)

    def answer(self, seq: int, command: TaxiCommand = GO) -> None:
        self.run.estimate(seq, seq * STEP_NS, ERROR)
        self.run.command(seq, seq * STEP_NS, command)

    def follow(self, seq: int) -> None:
        for name in FOLLOWERS:
            self.run.progress(name, seq, seq * STEP_NS)

    def drive(self, last_seq: int = 2) -> None:
        self.get_ready()
        for seq in range(last_seq + 1):
            self.answer(seq)
        self.follow(last_seq)


@pytest.fixture
def graph() -> Graph:
    return Graph()


def test_given_all_answers_then_each_command_moves_the_world_once_and_the_bag_ends_the_run(graph):
    graph.drive()
    assert graph.commands == [GO, GO]
    assert graph.finished == []
    graph.run.judged(PASSED)
    assert graph.said == ['start', 0, 1, 2, Outcome.PASS]
    assert graph.finished == [], 'the bag is not closed yet'
    graph.run.recorded('PASS', 2)
    graph.run.recorded('PASS', 2)
    assert graph.finished == [Ending(Outcome.PASS, 2)]


def test_given_a_command_before_its_estimate_or_twice_then_it_counts_once(graph):
    graph.get_ready()
    graph.run.command(0, 0, GO)
    graph.run.estimate(0, 0, ERROR)
    graph.run.command(0, 0, LATER)
    assert (graph.said, graph.commands) == (['start', 0, 1], [GO])


def test_given_ends_that_have_not_found_each_other_then_the_first_frame_waits(graph):
    graph.deaf = ['taxi_command']
    graph.get_ready()
    graph.run.watch()
    assert graph.said == []
    graph.deaf = []
    graph.run.watch()
    assert graph.said == ['start', 0]


def test_given_a_node_that_is_not_ready_in_time_then_it_is_named(graph):
    for name in PARTICIPANTS[:-1]:
        graph.run.ready(name)
    assert graph.run.awaited(2.0) == [PARTICIPANTS[-1]]
    graph.now_s = 30.1
    graph.run.watch()
    assert graph.run.ending == Ending(
        Outcome.INFRA_ERROR, 0, 'not_ready', PARTICIPANTS[-1],
        'not ready within 30 s: is not there',
    )


def test_given_silence_then_the_first_node_of_the_chain_is_named_with_the_reason(graph):
    graph.get_ready()
    graph.run.estimate(0, 0, ERROR)
    assert graph.run.awaited(2.0) == [STEERING_CONTROLLER]
    graph.now_s = 9.9
    graph.run.watch()
    assert graph.run.ending is None
    graph.now_s = 10.1
    graph.run.watch()
    assert graph.run.ending[2:] == (
        'timeout', STEERING_CONTROLLER, 'silent for 10 s: it does not publish')
    # A recorder that does not close its bag is lost; the first cause remains.
    graph.now_s = 21.0
    graph.run.watch()
    assert [ending.who for ending in graph.finished] == [STEERING_CONTROLLER]


@pytest.mark.parametrize(('command', 'words'), [
    (TaxiCommand(steering_rad=math.nan, speed_mps=5.0), 'commanded nan rad at 5 m/s'),
    (TaxiCommand(steering_rad=0.0, speed_mps=-1.0), 'commanded 0 rad at -1 m/s'),
])
def test_given_a_command_that_is_none_then_it_is_an_error_of_the_controller(graph, command, words):
    graph.get_ready()
    with pytest.raises(InfraError, match=words):
        graph.run.command(0, 0, command)


@pytest.mark.parametrize(('seq', 'stamp_ns', 'words'), [
    (1, STEP_NS, 'answered frame 1, which is not out yet'),
    (0, 7, 'its answer to frame 0 is stamped 7e-09 s'),
    (0, STEP_NS, 'its answer to frame 0 is stamped 0.1 s'),
])
def test_given_an_answer_to_no_frame_then_its_node_is_charged(graph, seq, stamp_ns, words):
    graph.get_ready()
    with pytest.raises(InfraError, match=words):
        graph.run.estimate(seq, stamp_ns, ERROR)
    graph.run.estimate(0, 0, ERROR)
    graph.run.command(seq, stamp_ns, GO)
    graph.now_s = 1.1
    graph.run.watch()
    assert graph.run.ending[2:] == ('protocol', STEERING_CONTROLLER, words)


def test_given_a_follower_that_is_ahead_of_time_then_it_is_charged(graph):
    graph.get_ready()
    with pytest.raises(InfraError, match='has come to frame 5, which is not out yet'):
        graph.run.progress(MTL_MONITOR, 5, 0)


def test_given_a_wrong_command_that_repeats_the_estimate_then_the_perception_is_charged(graph):
    graph.get_ready()
    graph.run.command(1, STEP_NS, GO)
    with pytest.raises(InfraError, match='perception at step 0: answered frame 1'):
        graph.run.estimate(1, STEP_NS, ERROR)
    # Without such evidence the controller is.
    graph.now_s = 1.1
    graph.run.watch()
    assert graph.run.ending[2:4] == ('protocol', STEERING_CONTROLLER)


@pytest.mark.parametrize(('outcome', 'seq', 'words'), [
    ('FAIL', 2, 'closed its bag as FAIL at step 2'),
    ('PASS', 1, 'closed its bag as PASS at step 1'),
])
def test_given_a_bag_that_is_not_what_the_run_was_then_the_run_has_no_verdict(
    graph, outcome, seq, words
):
    graph.drive()
    graph.run.judged(PASSED)
    graph.run.recorded(outcome, seq)
    assert graph.finished == [Ending(Outcome.INFRA_ERROR, 2, 'bag', RECORDER, words)]


def test_given_a_foreign_publisher_then_the_verdict_is_withheld_and_an_error_is_its(graph):
    graph.foreign = 'somebody', 'publishes taxi_command'
    graph.drive()
    graph.run.judged(PASSED)
    assert graph.run.ending[2:] == ('intruder', 'somebody', 'publishes taxi_command')
    other = Graph()
    other.foreign = graph.foreign
    other.get_ready()
    other.run.fail('protocol', PERCEPTION, 'answered nonsense')
    assert other.run.ending[2:4] == ('intruder', 'somebody')
    third = Graph()
    third.foreign = graph.foreign
    third.get_ready()
    third.run.fail('died', PERCEPTION, 'killed')
    assert third.run.ending[2:4] == ('died', PERCEPTION), 'one started again is nobody foreign'


def test_given_a_cancel_then_the_run_ends_between_two_steps_or_after_a_second(graph):
    graph.get_ready()
    graph.run.cancel()
    graph.run.watch()
    assert graph.run.ending is None, 'the answers to the current frame are awaited'
    graph.answer(0)
    assert graph.run.ending == Ending(Outcome.INTERRUPTED, 0)
    assert graph.commands == []
    other = Graph()
    other.get_ready()
    other.run.cancel()
    other.now_s = 1.1
    other.run.watch()
    assert other.run.ending == Ending(Outcome.INTERRUPTED, 0)


def test_given_a_monitor_that_stops_the_run_then_its_last_step_is_the_current_one(graph):
    graph.get_ready()
    graph.answer(0)
    graph.answer(1)
    early = SimpleNamespace(complete=False, stopped_early=True, satisfied=False)
    graph.run.estimate(2, 2 * STEP_NS, ERROR)
    graph.run.judged(early)
    graph.follow(2)
    assert graph.run.ending is None, 'the last frame has no command yet'
    graph.run.command(2, 2 * STEP_NS, GO)
    assert graph.run.ending == Ending(Outcome.FAIL, 2)


def test_given_a_pause_then_the_answers_count_and_the_next_frame_waits(graph):
    graph.get_ready()
    graph.run.allow(0)
    graph.answer(0)
    graph.run.command(0, 0, LATER)
    assert (graph.said, graph.commands) == (['start', 0, 'held'], [])
    graph.now_s = 3600.0
    graph.run.watch()
    assert graph.run.ending is None, 'nobody is charged with a pause'
    assert graph.run.awaited(2.0) == []
    graph.run.allow(None)
    assert graph.commands == [GO]
    graph.answer(1)
    assert graph.said == ['start', 0, 'held', 1, 2]
    graph.now_s += 10.1
    graph.run.watch()
    assert graph.run.ending[2:4] == ('timeout', PERCEPTION), 'silence counts from the pause on'


def test_given_a_pause_when_steps_are_allowed_then_so_many_are_taken_and_it_holds_again():
    graph = Graph(last_seq=4)
    graph.get_ready()
    graph.answer(0)
    graph.run.allow(0)
    assert graph.said == ['start', 0, 1], 'the answers to the frame are still to come'
    graph.run.allow(2)
    for seq in (1, 2, 3):
        graph.answer(seq)
    assert graph.said == ['start', 0, 1, 2, 3, 'held']
    graph.run.allow(1)
    graph.answer(4)
    graph.follow(4)
    graph.run.judged(PASSED)
    assert graph.run.ending == Ending(Outcome.PASS, 4), 'after the last step nothing is held'
    assert graph.commands == [GO] * 4


def test_given_a_pause_before_the_first_frame_then_it_comes_and_the_second_waits(graph):
    graph.run.allow(0)
    graph.get_ready()
    graph.answer(0)
    assert graph.said == ['start', 0, 'held']


def test_given_a_pause_when_a_node_is_silent_then_it_is_named_and_a_cancel_ends_the_run(graph):
    graph.run.allow(0)
    graph.get_ready()
    graph.run.estimate(0, 0, ERROR)
    graph.now_s = 10.1
    graph.run.watch()
    assert graph.run.ending[2:4] == ('timeout', STEERING_CONTROLLER)
    other = Graph()
    other.run.allow(0)
    other.get_ready()
    other.answer(0)
    other.run.cancel()
    other.run.watch()
    assert (other.run.ending, other.commands) == (Ending(Outcome.INTERRUPTED, 0), [])


def test_given_a_recorder_lost_after_the_verdict_then_there_is_none(graph):
    graph.drive()
    graph.run.judged(PASSED)
    assert graph.run.awaited(2.0) == [RECORDER]
    graph.run.fail('died', RECORDER, 'killed')
    assert graph.finished == [Ending(Outcome.INFRA_ERROR, 2, 'died', RECORDER, 'killed')]
    graph.run.fail('node_error', MTL_MONITOR, 'too late')
    assert len(graph.finished) == 1


def test_given_a_free_run_then_frames_come_by_the_clock_and_the_newest_command_holds():
    graph = Graph(factor=1.0)
    graph.get_ready()
    assert graph.said == ['start', 0, ([], [])]
    graph.answer(0, LATER)
    graph.follow(0)
    graph.run.tick()
    assert graph.frame == 0, 'it is not due yet'
    for _ in range(40):
        graph.now_s += 0.05
        graph.follow(graph.frame)
        graph.run.tick()
    assert graph.commands == [GO, LATER], 'an answer holds from the frame after it'
    assert tuple(
        sorted(frame for said in graph.said if isinstance(said, tuple) for frame in said[part])
        for part in (0, 1)
    ) == ([1, 2], [1, 2])
    graph.run.judged(PASSED)
    assert graph.run.ending == Ending(Outcome.PASS, 2)
