"""Repeat a recorded run: rerun its scenario in the whole graph, or replay its bag into one node.

For the node under test, the replay is indistinguishable from the graph: the player publishes on all
topics the node subscribes to, in lockstep, and replaces all its subscribers.
"""

from __future__ import annotations

import dataclasses
import functools
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from taxinet_msgs.msg import NodeStatus, Scenario

from taxinet_ros.bag.cdr.image import image_cdr
from taxinet_ros.bag.rewrite.frames import frame_messages
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.message_values import error_of
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.run.run_bag import bag_name
from taxinet_ros.bag.run.topics import CAMERA_FRAME
from taxinet_ros.bag.topics import type_hash
from taxinet_ros.core.assurance.switch import make_controller
from taxinet_ros.core.motion.controller import (
    STEERING,
    Controller,
    SteeringGains,
    UserController,
    gains_text,
)
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.pacing.step_collector import StepCollector
from taxinet_ros.core.perception.perception import Perception, UserPerception, make_perception
from taxinet_ros.core.scenario import Scenario as Scene
from taxinet_ros.core.types import TrackingError, step_stamp_ns
from taxinet_ros.core.user_code import given_sensors, node_command
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph
from taxinet_ros.nodes.interface import PARTICIPANTS, Topic
from taxinet_ros.nodes.messages.convert import scenario_message
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.node_main import spin_until
from taxinet_ros.registry import KMWH
from taxinet_ros.trials.requirements import DEFAULT_JUDGING

Step = tuple[int, Mapping[str, Sequence[bytes]]]
"""Number of a control step, and its serialised messages by topic of the table."""
_WATCH_PERIOD_S = 0.02
ANSWER_TIMEOUT_S = 30.0


class Player(Node):
    """Publishes the steps one by one, each after the previous one is answered.

    Attributes:
        answers: messages of the node under test by control step and topic.
        finished: done when the last step is answered; raises on failure.
    """

    def __init__(
        self, scenario: Scenario, steps: Iterator[Step], *, target: str, speaks: Sequence[Topic],
        answer: Topic, per_step: int, executor: Any, **node: Any,
    ) -> None:
        """Join the graph and wait for the node under test.

        Args:
            scenario: scenario of the run; only ``target`` takes part.
            steps: steps to play, drawn one at a time.
            target: name of the node under test.
            speaks: topics to publish.
            answer: topic of the node's answers.
            per_step: number of answers per step.
            executor: executor that spins this node.
            node: goes to :class:`rclpy.node.Node`.
        """
        # Nodes wait for each other by name, and this one acts as the simulator.
        super().__init__(interface.SIMULATOR, **node)
        self._scenario, self._steps, self._target = scenario, steps, target
        self._collector = StepCollector({answer.name: per_step})
        self.answers: dict[int, dict[str, list[Any]]] = {}
        self.finished = Future(executor=executor)
        self._seq, self._ready, self._asked = -1, False, False
        self._heard_at = time.monotonic()
        heard = [interface.TIMING] if target in interface.TIMING.subscribers else []
        self._speakers = {
            topic.name: self.create_publisher(topic.type, topic.name, topic.qos)
            for topic in (interface.SCENARIO, *heard, *speaks)
        }
        self._listeners = [
            self.create_subscription(
                topic.type, topic.name, self._callback(topic, answer), topic.qos
            )
            for topic in interface.TOPICS
            if target in topic.publishers
        ]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_WATCH_PERIOD_S, self._watch, clock=steady)

    def _callback(self, topic: Topic, answer: Topic) -> Callable[[Any], None]:
        """Callback of a topic; the node needs subscribers even on unused topics."""
        if topic is answer:
            return functools.partial(self._on_answer, topic.name)
        return self._on_status if topic is interface.NODE_STATUS else lambda message: None

    def _watch(self) -> None:
        if self.finished.done():
            return
        if self._seq < 0 and self._found():
            if not self._asked:
                self._asked = True
                self._speakers[interface.SCENARIO.name].publish(self._scenario)
            elif self._ready:
                self._next()
        if time.monotonic() - self._heard_at > ANSWER_TIMEOUT_S:
            kind = InfraKind.NOT_READY if self._seq < 0 else InfraKind.TIMEOUT
            self._fail(kind, f'silent for {ANSWER_TIMEOUT_S:g} s')

    def _found(self) -> bool:
        """Whether the node under test is matched on every topic that it hears in each run."""
        return all(
            publisher.get_subscription_count() for name, publisher in self._speakers.items()
            if name != interface.CAMERA2.name
        ) and all(heard.get_publisher_count() for heard in self._listeners)

    def _on_status(self, status: NodeStatus) -> None:
        if status.run_id != self._scenario.run_id or status.node != self._target:
            return
        if status.state == NodeStatus.READY:
            self._ready, self._heard_at = True, time.monotonic()
        elif status.state == NodeStatus.ERROR:
            self._fail(InfraKind.NODE_ERROR, status.detail)

    def _on_answer(self, topic: str, message: Any) -> None:
        for seq, messages in self._collector.add(topic, message.seq, message):
            self.answers[seq] = messages
            self._heard_at = time.monotonic()
            self._next()

    def _next(self) -> None:
        try:
            step = next(self._steps, None)
        except Exception as error:
            # For the caller of the replay, not for the executor.
            self.finished.set_exception(error)
            return
        if step is None:
            if not self.finished.done():
                self.finished.set_result(None)
            return
        self._seq, messages = step
        for topic, serialised in messages.items():
            for cdr in serialised:
                self._speakers[topic].publish(cdr)

    def _fail(self, kind: str, detail: str) -> None:
        if not self.finished.done():
            self.finished.set_exception(InfraError(kind, self._target, self._seq, detail))


_ANSWERS = {
    interface.PERCEPTION: interface.ESTIMATE,
    interface.STEERING_CONTROLLER: interface.COMMAND,
    interface.MTL_MONITOR: interface.ROBUSTNESS,
}
TARGETS = tuple(_ANSWERS)
"""Nodes into which a run can be replayed."""
Columns = dict[str, NDArray[np.float64]]


def replay(
    recording: Recording, run: RecordedRun, *, target: str, perception: str,
    controller: str = STEERING,
) -> Columns:
    """Replay a recorded run into one node over its topics.

    Camera frames missing from the bag are rendered.

    Args:
        recording: recording of a run.
        run: facts of the run, possibly modified.
        target: one of :data:`TARGETS`.
        perception: word or file of the perception, if that is the target.
        controller: word of the controller, if that is the target.

    Returns:
        The node's answers, by the names of :attr:`.recording.Recording.columns`: ``seq`` and the
        columns of the target.

    Raises:
        UsageError: unknown target, or the bag's messages have another version.
        InfraError: the node failed or timed out.
        BagError: the bag cannot be read, or its frames cannot be rendered.
    """
    if target not in _ANSWERS:
        raise UsageError(f'into {target}: not a replay target; known: {", ".join(TARGETS)}')
    word = perception if target == interface.PERCEPTION else controller
    scene, part = run.request.scenario, _part(target, word)
    inputs, sensors = _inputs(target, part), _sensors(scene, target, word, part)
    present = {interface.SENSORS[name] for name in scene.sensor_set.names}
    played = (*inputs, *(topic for topic in sensors if topic in present))
    answer = _ANSWERS[target]
    _check_types(recording, played)
    request = dataclasses.replace(run.request, participants=(target,))
    options = GraphOptions(
        perception=perception, out=Path(), controller=controller,
        gains=run.gains if controller == STEERING else {},
    )
    kind, parameters = options.nodes()[target]
    per_step = len(request.judging.specs) if answer.recorded == interface.PER_SPEC else 1
    with own_domain() as domain, NodeExecutor(domain) as spinning:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        spinning.add(kind(context=spinning.context, parameter_overrides=overrides))
        player = Player(
            scenario_message(request), _steps(recording, inputs, played), target=target,
            speaks=(*inputs, *sensors), answer=answer, per_step=per_step,
            executor=spinning.executor, context=spinning.context,
        )
        spinning.add(player)
        spin_until(spinning.executor, player.finished)
        return _columns(answer, player.answers)


def play_pictures(
    word: str, pictures: Iterable[NDArray[np.uint8]], scene: Scene
) -> list[TrackingError]:
    """Play pictures into a perception node in lockstep: the next one when its answer has come.

    Args:
        word: ``cmd:COMMAND`` that starts the node, in any language.
        pictures: (H, W, 3) uint8 RGB each, of the scene's camera.
        scene: names camera and aircraft.

    Returns:
        Its answers, in order.

    Raises:
        UsageError: the program does not exist.
        InfraError: the node failed or timed out.
    """
    request = RunRequest(
        run_id='recording', index=0, program='', seed=0, scenario=scene,
        judging=DEFAULT_JUDGING, participants=(interface.PERCEPTION,),
    )
    steps = (
        (seq, {interface.IMAGE.name: [
            image_cdr(one, step_stamp_ns(seq, scene.period_ns), CAMERA_FRAME)]})
        for seq, one in enumerate(pictures)
    )
    words = node_command(word, interface.PERCEPTION) or []
    with (
        own_domain() as domain, NodeExecutor(domain) as spinning,
        tempfile.NamedTemporaryFile(prefix='taxinet-', suffix='.log') as log,
    ):
        node = NodeProcess.of_command(
            interface.PERCEPTION, words, domain=domain, log=Path(log.name))
        try:
            player = Player(
                scenario_message(request), steps, target=interface.PERCEPTION,
                speaks=(interface.IMAGE,), answer=interface.ESTIMATE, per_step=1,
                executor=spinning.executor, context=spinning.context,
            )
            spinning.add(player)
            spin_until(spinning.executor, player.finished)
        finally:
            node.end()
    return [error_of(player.answers[seq][interface.ESTIMATE.name][0])
            for seq in sorted(player.answers)]


def _part(target: str, word: str) -> Perception | Controller | None:
    """What the node runs; None of the monitor.

    Raises:
        UsageError: see :func:`make_perception` and :func:`make_controller`.
    """
    if target == interface.PERCEPTION:
        return make_perception(word)
    if target == interface.STEERING_CONTROLLER:
        return make_controller(word, SteeringGains())
    return None


def _sensors(
    scene: Scene, target: str, word: str, part: Perception | Controller | None
) -> tuple[Topic, ...]:
    """Topics of the sensors that the node listens to.

    Raises:
        UsageError: it is a function that asks for some, and the run has none.
    """
    if part is None or not part.needs_sensors:
        return ()
    there = scene.sensor_set.present or scene.hold_lines
    if not there and isinstance(part, UserPerception | UserController):
        given_sensors(None, f'into {target}: {word}')
    return tuple(
        topic for name, topic in interface.SENSORS.items()
        if topic is not interface.CAMERA2 or name in scene.sensor_set.names
    )


def _inputs(target: str, part: Perception | Controller | None) -> tuple[Topic, ...]:
    """Input topics of a node in every step."""
    looks = target != interface.PERCEPTION or part is None or part.needs_image
    unused = interface.TRUTH if looks else interface.IMAGE
    return tuple(
        topic for topic in interface.TOPICS
        if target in topic.subscribers and topic.recorded == interface.PER_STEP
        and not (target == interface.PERCEPTION and topic is unused)
    )


def _check_types(recording: Recording, inputs: tuple[Topic, ...]) -> None:
    bag, recorded = recording.path, {topic.name: topic for topic in recording.topics}
    for topic in inputs:
        found = recorded.get(bag_name(topic))
        if found is None and topic not in (interface.IMAGE, interface.CAMERA2):
            raise UsageError(f'{bag}: no topic {bag_name(topic)}, so there is nothing to replay')
        if found is not None and found.type_hash != type_hash(topic.type_name):
            raise UsageError(
                f'{bag}: {topic.type_name} on {found.name} has another version than the installed '
                'one; re-record the run with taxinet run --from'
            )


def _steps(
    recording: Recording, inputs: tuple[Topic, ...], played: tuple[Topic, ...]
) -> Iterator[Step]:
    """Yield what is played in every step that has all inputs; missing frames are rendered."""
    names = {bag_name(topic): topic.name for topic in played}
    if not {interface.IMAGE, interface.CAMERA2}.isdisjoint(played):
        messages = frame_messages(recording, names)
    else:
        messages = (
            (message.stamp_ns // recording.period_ns, message.topic.name, message.cdr)
            for message in recording.whole_messages(names.__contains__)
        )
    for seq, group in groupby(messages, lambda message: message[0]):
        step: dict[str, list[bytes]] = {}
        for _, name, cdr in group:
            step.setdefault(names[name], []).append(cdr)
        if all(topic.name in step for topic in inputs):  # a failed run may end with part of a step
            yield seq, step


def _columns(answer: Topic, answers: dict[int, dict[str, list[Any]]]) -> Columns:
    rows = []
    for seq, messages in sorted(answers.items()):
        row = {'seq': float(seq)}
        for message in messages[answer.name]:
            row.update(_numbers(message))
        rows.append(row)
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def _numbers(message: Any) -> dict[str, float]:
    """Values of one answer, named as in a trace; none for an unusable estimate."""
    if isinstance(message, interface.ESTIMATE.type):
        seen = error_of(message)
        return {'est_cte_m': seen.cte_m, 'est_he_rad': seen.he_rad} if seen.usable else {}
    if isinstance(message, interface.COMMAND.type):
        return {'steering_rad': message.steering_angle, 'speed_cmd_mps': message.speed}
    return RobustnessInterval.of_message(message).by_column(message.spec)


def rerun(
    runs: Sequence[tuple[RecordedRun, str, str]], out: Path, *, images: str, processes: bool = False
) -> dict[str, RunResult]:
    """Rerun recorded runs, each in a graph like its original one.

    Args:
        runs: recorded runs, each with the words of perception and controller to use.
        out: folder for the new bags, one folder per run with the same name.
        images: as in :class:`.graph.GraphOptions`.
        processes: run every node in its own process.

    Returns:
        Results by name of the run.
    """
    results: dict[str, RunResult] = {}
    out.mkdir(parents=True, exist_ok=True)  # programs of the user log into it

    def keep(request: RunRequest, result: RunResult) -> bool:
        results[request.run_id] = result
        return result.outcome.judged

    def kind(run: tuple[RecordedRun, str, str]) -> tuple[str, ...]:
        return run[1], run[2], gains_text(run[0].gains), run[0].timing.words, run[0].world

    for (perception, controller, *_), group in groupby(sorted(runs, key=kind), kind):
        alike = [run for run, *_ in group]
        options = GraphOptions(
            perception=perception, out=out, images=images, controller=controller,
            gains=alike[0].gains if controller == STEERING else {}, timing=alike[0].timing,
            world=alike[0].world or KMWH, world_sha256=alike[0].world_fingerprint,
        )
        requests = [
            dataclasses.replace(run.request, participants=PARTICIPANTS) for run in alike
        ]
        opened = process_graph(options, out / 'logs') if processes else composed_graph(options)
        with opened as graph:
            graph.run(requests, keep)
    return results
