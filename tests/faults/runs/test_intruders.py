"""Who has no part in a run and speaks in it: the run has no verdict, and names him."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from fault_runs import PARTICIPANTS, once, request, run, steps_in
from geometry_msgs.msg import TransformStamped
from rclpy.action import ActionServer
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from tampering import tamper
from taxinet_msgs.msg import NodeStatus, RunStatus, TaxiCommand, Timing, TrackingError, Verdict
from tf2_msgs.msg import TFMessage
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.nodes import interface, simulator
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import MTL_MONITOR, PERCEPTION, RECORDER, Topic
from taxinet_ros.nodes.lockstep import endpoints as speakers
from taxinet_ros.nodes.lockstep.participant import Participant
from taxinet_ros.nodes.messages.convert import death_notice, scenario_message, time_of
from taxinet_ros.nodes.recorder import Recorder
from taxinet_ros.nodes.running.leave import leave_graph

pytestmark = pytest.mark.ros

PEER = 'somebody_else'
STEP = 9


@contextlib.contextmanager
def peer(graph: Any, name: str = PEER) -> Iterator[Node]:
    """A node of another participant on the graph's domain, as another process has."""
    context = Context()
    rclpy.init(context=context, domain_id=graph.domain)
    node = Node(name, context=context)
    try:
        yield node
    finally:
        leave_graph(node)
        rclpy.try_shutdown(context=context)


def node_of(graph: Any, name: str) -> Any:
    return next(node for node in graph.nodes if node.get_name() == name)


def amid_the_run(graph: Any, act: Callable[[], object]) -> list[object]:
    """Have something done at a step, which waits for it; what came of it."""
    done: list[object] = []

    def how(step: int, message: Any) -> list[Any]:
        if step == STEP and not done:
            done.append(act())
        return [message]

    tamper(graph, interface.COMMAND, how)
    return done


every_topic = pytest.mark.parametrize(
    # Nobody needs to hear of pictures.
    'topic', [topic for topic in interface.TOPICS if topic is not interface.IMAGE],
    ids=lambda topic: topic.name.replace('/', '-'),
)


def ears(graph: Any, topic: Topic) -> list[Any]:
    """The subscriptions of the graph's nodes to a topic."""
    name = '/' + topic.name.lstrip('/')
    return [one for node in graph.nodes for one in node.subscriptions if one.topic_name == name]


def forged(topic: Topic, run_id: str = 'run') -> Any:
    """What somebody might say to have it his way."""
    return {
        interface.RUN_STATUS.name: RunStatus(
            run_id=run_id, state=RunStatus.ENDED, outcome='PASS', seq=3),
        interface.ESTIMATE.name: TrackingError(run_id=run_id, cross_track_error=9.0, valid=True),
        interface.COMMAND.name: TaxiCommand(run_id=run_id, steering_angle=0.5, speed=9.0),
        interface.TRUTH.name: TrackingError(run_id=run_id, valid=True),
        interface.CLOCK.name: Clock(clock=time_of(0)),
        interface.NODE_STATUS.name: NodeStatus(
            run_id=run_id, node=RECORDER, state=NodeStatus.DONE, detail='PASS', seq=3),
        interface.VERDICT.name: Verdict(run_id=run_id, complete=True, satisfied=True),
        interface.TIMING.name: Timing(
            run_id=run_id, seq=STEP, unestimated=list(range(STEP, STEP + 100))),
    }.get(topic.name, topic.type())


def speak(graph: Any, node: Node, topic: Topic) -> Any:
    """Publish one forged message on a topic, once everybody in the graph hears it."""
    heard = ears(graph, topic)
    before = [one.get_publisher_count() for one in heard]
    publisher = node.create_publisher(topic.type, topic.name, topic.qos)
    wait_for(lambda: publisher.get_subscription_count() >= len(heard) and all(
        one.get_publisher_count() > count for one, count in zip(heard, before, strict=True)
    ))
    publisher.publish(forged(topic))
    return publisher


def disturbed(out: Path, act: Callable[[Any], object], **changes: Any) -> RunResult:
    """A run of ten minutes in which somebody does something at a step."""
    options = GraphOptions(perception='truth', out=out, images='none', **changes)
    with composed_graph(options) as graph:
        done = amid_the_run(graph, functools.partial(act, graph))
        (result,) = run(graph, request())
    assert done
    return result


def assert_bag_has_no_verdict(bag: Path, who: str) -> None:
    """It is closed, says who broke the run, and holds what was recorded before."""
    assert read_info(bag).complete
    facts = open_recording(bag).facts
    assert facts is not None
    assert (facts.outcome, facts.who) == (Outcome.INFRA_ERROR, who)
    steps = steps_in(bag)
    assert steps == list(range(len(steps)))
    assert len(steps) >= STEP


@every_topic
def test_f4_given_a_peer_that_speaks_amid_a_run_then_it_ends_without_a_verdict_and_names_him(
    topic, tmp_path
):
    with contextlib.ExitStack() as stack:
        result = disturbed(
            tmp_path, lambda graph: speak(graph, stack.enter_context(peer(graph)), topic)
        )
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert result.who == PEER
    assert topic.name in result.detail
    assert result.rho == {}
    assert_bag_has_no_verdict(tmp_path / 'run', PEER)


@every_topic
def test_f4_given_a_peer_that_comes_speaks_once_and_goes_then_the_run_has_no_verdict(
    topic, tmp_path
):
    def come_and_go(graph: Any) -> None:
        with peer(graph) as node:
            speak(graph, node, topic)

    result = disturbed(tmp_path, come_and_go)
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert result.who in (PEER, speakers.UNKNOWN)
    assert_bag_has_no_verdict(tmp_path / 'run', result.who)


def test_f4_given_timing_in_a_lockstep_run_then_it_excuses_nothing_whoever_sent_it(tmp_path):
    def say(graph: Any) -> bool:
        node_of(graph, interface.SIMULATOR)._say(interface.TIMING, forged(interface.TIMING))
        return True

    result = disturbed(tmp_path, say)
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert result.detail == 'timing was published in a lockstep run'
    assert result.rho == {}


@pytest.mark.parametrize('name', [PEER, interface.PERCEPTION])
def test_f4_given_a_second_publisher_from_the_start_then_no_run_begins_and_it_is_named(
    name, tmp_path
):
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timeouts={'ready_timeout': 1.0},
    )
    with composed_graph(options) as graph, peer(graph, name) as node:
        publisher = speak(graph, node, interface.ESTIMATE)
        (result,) = run(graph, request(duration=1.0))
        node.destroy_publisher(publisher)
        (after,) = run(graph, request('after', duration=1.0))
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert (result.who, result.rho) == (name, {})
    assert steps_in(tmp_path / 'run') == []
    assert after.outcome.judged, 'he is gone, and is held against nobody'


def test_ros21_given_others_who_speak_of_frames_then_the_run_goes_on_and_its_bag_is_the_same(
    tmp_path
):
    """The topics of tf2 are everybody's."""
    heard: list[TFMessage] = []

    def speak_of_frames(graph: Any, stack: contextlib.ExitStack) -> None:
        node = stack.enter_context(peer(graph))
        lie = TransformStamped(child_frame_id=interface.BASE_FRAME)
        lie.header.frame_id = interface.MAP_FRAME
        moving = node.create_subscription(TFMessage, 'tf', heard.append, interface.TF.qos)
        for topic in interface.TRANSFORMS:
            publisher = node.create_publisher(topic.type, topic.name, topic.qos)
            publisher.publish(TFMessage(transforms=[lie]))
        wait_for(lambda: moving.get_publisher_count() == 2)

    bags = []
    for folder, act in ((tmp_path / 'alone', None), (tmp_path / 'shared', speak_of_frames)):
        options = GraphOptions(perception='truth', out=folder, images='none')
        with composed_graph(options) as graph, contextlib.ExitStack() as stack:
            if act is not None:
                done = amid_the_run(graph, functools.partial(act, graph, stack))
            (result,) = run(graph, request(duration=2.0))
            assert result.outcome.judged, result
        bags.append((folder / 'run' / 'run_0.mcap').read_bytes())
    assert done
    assert bags[0] == bags[1]


def test_f4_given_onlookers_that_come_and_go_then_not_a_byte_changes(tmp_path):
    def look_on(graph: Any) -> None:
        for _ in range(2):
            with peer(graph) as node:
                for topic in (*interface.TOPICS, *interface.TRANSFORMS):
                    node.create_subscription(topic.type, topic.name, lambda _: None, topic.qos)
                wait_for(lambda: node.count_publishers('run_status') == 1)

    bags = []
    for folder, act in ((tmp_path / 'alone', lambda _: None), (tmp_path / 'seen', look_on)):
        with composed_graph(GraphOptions(perception='truth', out=folder, images='none')) as graph:
            amid_the_run(graph, functools.partial(act, graph))
            (result,) = run(graph, request(duration=2.0))
        assert result.outcome.judged, result
        bags.append((folder / 'run' / 'run_0.mcap').read_bytes())
    assert bags[0] == bags[1]


@pytest.mark.parametrize('stays', [True, False])
def test_f4_given_a_peer_that_is_noticed_by_nobody_meanwhile_then_the_verdict_is_withheld(
    stays, tmp_path, monkeypatch
):
    """What DDS tells may be heard late: it is asked once more before anything is judged."""
    heard = speakers.HeardSpeakers.__init__
    monkeypatch.setattr(simulator, '_WATCH_PERIOD_S', 1e6)
    monkeypatch.setattr(
        speakers.HeardSpeakers, '__init__',
        lambda *args, on_match, **more: heard(*args, on_match=lambda: None, **more),
    )
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with composed_graph(options) as graph, contextlib.ExitStack() as stack:
        def come() -> object:
            node = stack.enter_context(peer(graph))
            speak(graph, node, interface.ROBUSTNESS)
            if not stays:
                stack.close()
                wait_for(lambda: ears(graph, interface.ROBUSTNESS)[0].get_publisher_count() == 1)
            return True

        came = amid_the_run(graph, come)
        (result,) = run(graph, request(duration=5.0))
    assert came
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder')
    assert result.who == (PEER if stays else speakers.UNKNOWN)
    facts = open_recording(tmp_path / 'run').facts
    assert facts.outcome == Outcome.INFRA_ERROR
    assert steps_in(tmp_path / 'run') == list(range(51))


@pytest.mark.parametrize('who', [interface.SIMULATOR, interface.PERCEPTION])
def test_f4_given_a_forged_obituary_then_the_run_is_spoilt_and_has_no_verdict(who, tmp_path):
    def report_death(graph: Any) -> Any:
        node = stack.enter_context(peer(graph))
        topic = interface.OBITUARY
        publisher = node.create_publisher(topic.type, topic.name, topic.qos)
        wait_for(lambda: publisher.get_subscription_count() == 2)
        publisher.publish(death_notice('run', who, 'said so'))

    with contextlib.ExitStack() as stack:
        result = disturbed(tmp_path, report_death)
    assert (result.outcome, result.kind, result.who) == (Outcome.INFRA_ERROR, 'died', who)
    assert_bag_has_no_verdict(tmp_path / 'run', who)


@pytest.mark.parametrize(('done', 'words'), [
    ({'detail': 'PASS'}, 'closed its bag as PASS at step 10'),
    ({'seq': 7}, 'closed its bag as FAIL at step 7'),
])
def test_f4_given_a_bag_that_is_not_what_the_run_was_then_the_run_has_no_verdict(
    done, words, tmp_path, monkeypatch
):
    report = Participant.report
    monkeypatch.setattr(
        Participant, 'report', lambda self, state, **what: report(
            self, state, **(what | done if state == NodeStatus.DONE else what)),
    )
    with composed_graph(GraphOptions(perception='truth', out=tmp_path, images='none')) as graph:
        (result,) = run(graph, request(duration=1.0))
    assert (result.outcome, result.kind, result.who) == (Outcome.INFRA_ERROR, 'bag', RECORDER)
    assert result.detail == words


@pytest.mark.parametrize(('topic', 'result_is'), [
    (interface.TIMING, (Outcome.PASS, '', '')),
    (interface.NODE_STATUS, (Outcome.INFRA_ERROR, 'intruder', PEER)),
], ids=['where nothing counts any more', 'where the word on the bag is said'])
def test_f4_given_a_peer_that_comes_when_the_bag_is_closed_then_he_alone_is_named(
    topic, result_is, tmp_path, monkeypatch
):
    """The recorder has said its last word by then: nobody waits for another one, or charges it."""
    finish = Recorder._done
    with contextlib.ExitStack() as stack:
        def come_and_finish(self: Any) -> None:
            simulator_node = node_of(graph, interface.SIMULATOR)
            before = simulator_node.count_publishers(topic.name)
            node = stack.enter_context(peer(graph))
            stack.callback(node.destroy_publisher, node.create_publisher(
                topic.type, topic.name, topic.qos))
            wait_for(lambda: simulator_node.count_publishers(topic.name) > before)
            finish(self)

        monkeypatch.setattr(Recorder, '_done', come_and_finish)
        options = GraphOptions(
            perception='truth', out=tmp_path, images='none', timeouts={'answer_timeout': 1.0})
        graph = stack.enter_context(composed_graph(options))
        (result,) = run(graph, request(
            duration=1.0, judging=Judging(specs=('phi=always(abs(cte) <= 100)',))
        ))
    assert (result.outcome, result.kind, result.who) == result_is, result


def test_f4_given_a_second_server_of_the_action_then_its_answers_are_no_results(tmp_path):
    """He who answers for the simulator would decide what the table says."""
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', patience={'server_timeout': 1.0},
    )
    kind, name = interface.RUN_SCENARIO_TYPE, interface.RUN_SCENARIO
    with composed_graph(options) as graph, contextlib.ExitStack() as stack:
        def serve() -> bool:
            node = stack.enter_context(peer(graph))
            server = ActionServer(node, kind, name, lambda goal: kind.Result())
            stack.callback(server.destroy)
            looker = node_of(graph, interface.SIMULATOR)
            topic = f'rr/{name}/_action/get_resultReply'
            wait_for(lambda: PEER in {
                end.node_name for end in looker.get_publishers_info_by_topic(topic, no_mangle=True)
            })
            return True

        came = amid_the_run(graph, serve)
        amid, after = run(graph, request(duration=2.0), request('after', duration=2.0))
    assert came
    assert [result.outcome for result in (amid, after)] == [Outcome.INFRA_ERROR] * 2
    assert [(result.kind, result.who) for result in (amid, after)] == [('intruder', PEER)] * 2
    assert read_info(tmp_path / 'run').complete
    assert not (tmp_path / 'after').exists()


def scenario_of_somebody() -> Any:
    """One that every run satisfies, under the name of this one."""
    asked = scenario_message(request(duration=2.0))
    asked.specs = ['phi_eventually=always(abs(cte) <= 100)']
    return asked


FORGED_BEFORE = {
    'another scenario': (interface.SCENARIO, scenario_of_somebody),
    'another perception': (interface.NODE_STATUS, lambda: NodeStatus(
        run_id='run', node=PERCEPTION, state=NodeStatus.READY, implementation='truth',
        fingerprint='ab' * 32, listens=['ground_truth/tracking_error'],
    )),
    'an end': (interface.RUN_STATUS, lambda: RunStatus(
        run_id='run', state=RunStatus.ENDED, outcome='PASS', seq=20,
    )),
}


@pytest.mark.parametrize('what', FORGED_BEFORE)
@pytest.mark.parametrize('early', [False, True], ids=['while they get ready', 'before it is asked'])
def test_f4_given_a_peer_that_speaks_before_the_first_step_and_leaves_then_no_verdict_is_kept(
    what, early, tmp_path
):
    topic, message = FORGED_BEFORE[what]
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with composed_graph(options) as graph, peer(graph) as node:
        heard = ears(graph, topic)
        publisher = node.create_publisher(topic.type, topic.name, topic.qos)
        wait_for(lambda: publisher.get_subscription_count() >= len(heard))

        def say_and_leave() -> None:
            publisher.publish(message())
            publisher.wait_for_all_acked(Duration(seconds=60))
            node.destroy_publisher(publisher)

        if early:
            say_and_leave()
        monitor = next(one for one in graph.nodes if one.get_name() == MTL_MONITOR)
        waits = contextlib.nullcontext() if early else once(
            lambda: monitor.run_id == 'run', say_and_leave)
        with waits:
            (result,) = run(graph, request(duration=2.0))
    if early and what == 'an end':
        assert result.outcome.judged  # of a run that nobody was at yet, so nobody heard it
        assert open_recording(tmp_path / 'run').facts.outcome == result.outcome
        return
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert result.rho == {}


def test_f4_given_a_forged_ready_before_all_are_ready_then_the_bag_of_the_run_is_closed(tmp_path):
    """The recorder has not written how its bag begins by then, and one participant is lacking."""
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    _, another_perception = FORGED_BEFORE['another perception']
    with composed_graph(options) as graph, peer(graph) as node:
        heard = ears(graph, interface.NODE_STATUS)
        topic = interface.NODE_STATUS
        publisher = node.create_publisher(topic.type, topic.name, topic.qos)
        wait_for(lambda: publisher.get_subscription_count() >= len(heard))
        recorder = node_of(graph, RECORDER)
        publish = functools.partial(publisher.publish, another_perception())
        with once(lambda: recorder.run_id == 'run', publish):
            (result,) = run(graph, request(participants=(*PARTICIPANTS, 'nobody')))
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'intruder'), result
    assert open_recording(tmp_path / 'run').facts.outcome == Outcome.INFRA_ERROR
