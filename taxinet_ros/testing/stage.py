"""Drive one node of a user's: play the simulator and all other nodes of a graph against it.

They are on a domain of their own, with their names and endpoints, so that the node cannot
distinguish them from a graph. What it does is judged by :mod:`taxinet_ros.testing.clauses`.
"""

from __future__ import annotations

import contextlib
import re
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from sensor_msgs.msg import Image
from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.bag.run.messages import error_cdr, observation_messages
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.pacing.stepped_run import subnormal
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.command_wrapper import CHILDREN_LEFT
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.messages.convert import header, scenario_message
from taxinet_ros.nodes.messages.step import StepMessage, step_reader
from taxinet_ros.nodes.running.domain import NAMELESS, heard_by, own_domain, require_discovery
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.node_main import spin_for
from taxinet_ros.testing.clauses import (
    CLAUSES,
    ENDPOINTS,
    ROLES,
    SCENE,
    UNUSABLE,
    Answer,
    End,
    Finding,
    Question,
    Role,
    Run,
    Seen,
    judge,
    poses,
)

_START_S = 30.0
"""Timeout for a node to appear [s], as for READY in the simulator."""
_READY_FACTOR = 3.0
_LOOK_S = 0.01
_MOMENT_S = 0.3
"""Time to watch for unexpected messages [s]."""
_ENDING_S = 5.0
_KEPT_S: Final = 60.0, 4.5
"""Grace periods of its wrapper after SIGINT and SIGTERM [s]."""
_TAIL_BYTES = 1 << 20


def check_node(
    command: list[str], role: str | None, *, log: Path, frames: int = 24, patience_s: float = 10.0,
) -> tuple[str, list[Finding]]:
    """Drive a node, and judge it.

    Args:
        command: starts the node.
        role: its role; None to detect it from the publishers of the node.
        log: file for the node's output.
        frames: number of messages per run.
        patience_s: timeout for an answer; three times as long for READY [s].

    Returns:
        Its role, and what was found of each clause.

    Raises:
        UsageError: the program does not exist.
    """
    require_discovery()
    with own_domain() as domain, NodeExecutor(domain) as spinning:
        stage = _Stage(spinning, patience_s, poses(frames))
        tried = [role] if role else ['perception', 'controller']
        for word in tried:
            # Its name depends on its role, so one that proves to be a controller starts again.
            node = ROLES[word].node
            words = [*command, '--ros-args', '-r', f'__node:={node}']
            process = NodeProcess.of_command(
                node, words, domain=domain, log=log, graces_s=_KEPT_S
            )
            try:
                seen = stage.find(process, ROLES[word])
                if word == tried[-1] or not stage.is_controller():
                    stage.drive()
                    break
            finally:
                process.end()
        return word, judge(seen, CLAUSES[word])


class _SilenceError(Exception):
    """A timeout expired, or the node has died."""


class _Stage:
    """The graph without the checked node, and what that node does."""

    _seen: Seen
    _process: NodeProcess
    _run: Run | None = None
    _given_up = False

    def __init__(self, spinning: NodeExecutor, patience_s: float, states: list[Any]) -> None:
        self._spinning, self._patience_s, self._states = spinning, patience_s, states
        self._questions: list[tuple[Question, Any]] = []
        self._change = Future()
        self._nodes: dict[str, Node] = {}
        self._publishers: dict[str, Publisher] = {}
        self._watcher = self._join('taxinet_check_node')

    # Finding it --------------------------------------------------------------------------------

    def find(self, process: NodeProcess, role: Role) -> Seen:
        """Wait for the node's endpoints."""
        self._process, self._seen = process, Seen(role=role, frames=len(self._states))
        if self._until(self._strangers, _START_S):
            self._until(self._complete, _READY_FACTOR * self._patience_s)
            self._watch(2 * _MOMENT_S)  # its other endpoints
        self._dead()
        self._survey()
        return self._seen

    def is_controller(self) -> bool:
        """Whether it publishes commands, and no estimates."""
        spoken = {end.topic.name for end in self._seen.ends if end.publishes}
        return interface.COMMAND.name in spoken and interface.ESTIMATE.name not in spoken

    def _strangers(self) -> list[str]:
        """Absolute names of nodes outside the kit."""
        found = Counter(
            f'{space.rstrip("/")}/{name}'
            for name, space in self._watcher.get_node_names_and_namespaces()
            if not name.startswith('_')
        )
        # Not by name alone: a user's node may have the name of a kit node.
        return sorted((found - Counter(f'/{name}' for name in self._nodes)).elements())

    def _complete(self) -> bool:
        """Whether the node has all endpoints of some role, whatever its name."""
        ends = {(end.topic.name, end.publishes) for end in self._survey()}
        needed = {(interface.NODE_STATUS.name, True), (interface.SCENARIO.name, False)}
        # Only once: remains of a killed process disappear later.
        named = self._strangers().count(f'/{self._seen.role.node}') == 1
        return named and needed <= ends and any(
            (role.answers.name, True) in ends
            and any((topic.name, False) in ends for topic in role.hears)
            for role in ROLES.values()
        )

    def _survey(self) -> list[End]:
        self._seen.ends = [
            End(topic, publishes, one)
            for topic in interface.TOPICS
            for publishes, found in (
                (True, self._watcher.get_publishers_info_by_topic(topic.name)),
                (False, self._watcher.get_subscriptions_info_by_topic(topic.name)),
            )
            for one in found if one.node_name not in (NAMELESS, *self._nodes)
        ]
        self._seen.names = self._strangers() or self._seen.names
        return self._seen.ends

    # The rest of the graph ---------------------------------------------------------------------

    def _set_up(self) -> None:
        """Create all nodes but the checked one; its input and a listener come in :meth:`_first`."""
        role = self._seen.role
        for name in {interface.SIMULATOR, *interface.PARTICIPANTS} - {role.node}:
            self._join(name)
        for topic in interface.TOPICS:
            for name in self._nodes:
                if name in topic.publishers and not self._is_input(topic):
                    self._speak(name, topic)
                if name in topic.listeners([*self._nodes]) and not (
                    name == interface.MTL_MONITOR and topic.name == role.answers.name
                ):
                    self._listen(name, topic)
        camera = Camera(SCENE) if role.word == 'perception' else None
        for seq, state in enumerate(self._states):
            question = Question(seq=seq, truth=state.tracking_error)
            given = camera.render(state, question.stamp_ns) if camera else question.truth
            self._questions.append((question, given))

    def _is_input(self, topic: Topic) -> bool:
        return topic.name in [one.name for one in self._seen.role.hears]

    def _join(self, name: str) -> Node:
        node = self._nodes[name] = Node(
            name, context=self._spinning.context, enable_rosout=False,
            start_parameter_services=False,
        )
        self._spinning.add(node)
        return node

    def _speak(self, name: str, topic: Topic) -> None:
        publisher = self._nodes[name].create_publisher(topic.type, topic.name, topic.qos)
        self._publishers.setdefault(topic.name, publisher)

    def _listen(self, name: str, topic: Topic) -> None:
        read = step_reader(topic)

        def hear(message: Any) -> None:
            if name == interface.SIMULATOR and self._run is not None:
                if topic is interface.NODE_STATUS:
                    self._on_status(self._run, message)
                elif topic.name == self._seen.role.answers.name:
                    self._on_answer(self._run, read(message))
                if not self._change.done():
                    self._change.set_result(None)

        self._nodes[name].create_subscription(
            topic.type, topic.name, hear, topic.qos, raw=topic is not interface.NODE_STATUS
        )

    def _on_status(self, run: Run, status: NodeStatus) -> None:
        ours = status.run_id == run.run_id
        if status.state == NodeStatus.READY and ours:
            run.ready.append(status)
        elif status.state == NodeStatus.READY and not any(
            status.run_id == one.run_id for one in self._seen.runs
        ):
            run.other = status.run_id
        elif status.state == NodeStatus.ERROR and ours:
            run.error = run.error or status.detail or 'no detail'

    def _on_answer(self, run: Run, said: StepMessage) -> None:
        meant = [
            one for one in run.questions if (one.seq, one.stamp_ns) == (said.seq, said.stamp_ns)
        ]
        if not run.questions:
            run.unasked = True
            return
        # One that matches no question can only refer to the newest.
        question = (meant or run.questions)[-1]
        question.answers.append(Answer(
            said.value, said.run_id, said.seq, said.stamp_ns, time.monotonic() - question.asked_s,
            subnormal(said.value),
        ))

    def _until(self, condition: Callable[[], object], within_s: float) -> bool:
        """Spin until a condition holds, with a timeout.

        A second is counted as a hundred checks by this process, so that the node gets more time on
        a busy machine.
        """
        for _ in range(max(1, round(within_s / _LOOK_S))):
            if condition() or self._process.dead:
                break
            self._change = Future()
            spin_for(self._spinning.executor, self._change, _LOOK_S)
        return bool(condition())

    def _watch(self, within_s: float = _MOMENT_S) -> None:
        self._until(lambda: False, within_s)

    def _dead(self) -> bool:
        if self._process.dead and not self._seen.died:
            self._seen.died = self._process.how_it_ended()
            self._seen.died_in = self._run.kind if self._run else ''
        return self._process.dead

    # Driving it --------------------------------------------------------------------------------

    def drive(self) -> None:
        """Make all runs that are not blocked by a violation, and end the process in both ways."""
        if any(one.broken for one in judge(self._seen, ENDPOINTS)):
            return
        self._set_up()
        with contextlib.suppress(_SilenceError):
            self._first()
            self._make('second', self._questions)
            self._survey()
            if self._seen.role.word == 'controller':
                self._make('strange', [
                    (Question(seq=seq, truth=one, kind=kind), one)
                    for seq, (kind, one) in enumerate(UNUSABLE.items())
                ])
            elif interface.IMAGE.name in self._seen.heard:
                [question, picture], *_ = self._questions
                for kind, change in _STRANGE.items():
                    strange = Question(seq=0, truth=question.truth, kind=kind)
                    self._make('strange', [(strange, change(picture))])
            self._make('after', self._questions[:1])
        if self._dead():
            return
        self._end(signal.SIGINT)
        if not self._given_up:
            self._process.start()  # without state of the previous one
            with contextlib.suppress(_SilenceError):
                self._make('fresh', self._questions)
            if not self._dead():
                self._end(signal.SIGTERM)

    def _first(self) -> None:
        """The first run: test for READY before all endpoints are matched."""
        run = self._begin('first')
        role = self._seen.role
        self._watch()
        early = f'READY without {interface.MTL_MONITOR} hearing {role.answers.name}' \
            if run.ready else ''
        for topic in interface.TOPICS:
            if topic.name == role.answers.name:
                self._listen(interface.MTL_MONITOR, topic)
        self._watch()
        if run.ready:
            early = early or f'READY without anybody publishing {role.hears[0].name}'
        for topic in filter(self._is_input, interface.TOPICS):
            for speaker in topic.publishers:
                self._speak(speaker, topic)
        self._go_through(run, self._questions)
        self._seen.early = early

    def _make(self, kind: str, asked: Iterable[tuple[Question, Any]]) -> None:
        self._go_through(self._begin(kind), asked)

    def _begin(self, kind: str) -> Run:
        count = len(self._seen.runs)
        self._run = run = Run(run_id=f'check-{count:05d}-{kind}', kind=kind)
        self._seen.runs.append(run)
        self._say(interface.SCENARIO, scenario_message(RunRequest(
            run_id=run.run_id, index=count, program='check-node', seed=0, scenario=SCENE,
            judging=Judging(specs=('phi_always',)), participants=interface.PARTICIPANTS,
        )))
        self._say_status(run, RunStatus.PREPARING)
        return run

    def _go_through(self, run: Run, asked: Iterable[tuple[Question, Any]]) -> None:
        """Wait for READY, and ask.

        Raises:
            _SilenceError: the node is silent, or dead.
        """
        within_s = max(_READY_FACTOR * self._patience_s, _START_S * (run.kind == 'fresh'))
        self._until(lambda: run.ready or run.error or self._dead(), within_s)
        self._go_on_if(run, run.ready)
        # As the simulator does.
        if not self._until(lambda: not self._unmatched() or self._dead(), within_s):
            self._seen.unmatched = f'subscription of {", ".join(self._unmatched())} never matched'
            self._go_on_if(run, False)
        self._say_status(run, RunStatus.RUNNING)
        for template, given in asked:
            question = Question(seq=template.seq, truth=template.truth, kind=template.kind)
            self._ask(run, question, given)
        self._say_status(run, RunStatus.ENDED)
        self._watch(_MOMENT_S / 3)  # a second answer
        self._go_on_if(run, True)

    def _go_on_if(self, run: Run, fine: object) -> None:
        if self._dead():
            raise _SilenceError
        if not fine:
            self._given_up = True
            self._say_status(run, RunStatus.ENDED)
            raise _SilenceError

    def _unmatched(self) -> list[str]:
        """Topics on which the node would miss messages sent now."""
        role = self._seen.role
        return [
            topic.name for topic in role.hears if topic.name in self._seen.heard and not heard_by(
                self._nodes[topic.publishers[0]], self._publishers[topic.name], [role.node]
            )
        ]

    def _ask(self, run: Run, question: Question, given: Any) -> None:
        """Publish the messages of a control step, and wait for the answer.

        Args:
            run: the run.
            question: what is asked.
            given: a frame, or an image that is none, which need not be answered; or an estimate.
        """
        seq, stamp_ns = question.seq, question.stamp_ns
        run.questions.append(question)
        frame = given if isinstance(given, np.ndarray) else None
        now = Observation(seq=seq, stamp_ns=stamp_ns, state=self._states[seq], image=frame)
        question.asked_s = time.monotonic()
        for topic, message in observation_messages(now, now.image, run.run_id):
            self._say(topic, message)
        patience_s = self._patience_s
        if isinstance(given, Image):
            given.header = header(stamp_ns, interface.CAMERA_FRAME)
            self._say(interface.IMAGE, given)
            slowest_s = max((one.took_s for _, _, one in self._seen.answered()), default=0.0)
            patience_s = min(patience_s, _MOMENT_S + 4 * slowest_s)  # it would mix with the next
        elif frame is None:
            self._say(interface.ESTIMATE, error_cdr(given, run.run_id, seq, stamp_ns))
        self._until(lambda: question.answers or run.error or self._dead(), patience_s)
        if not (question.answers or question.kind or self._dead()):
            self._seen.silence = f'frame {seq} of run {run.kind}: ' + (
                f'ERROR: {run.error}' if run.error else f'none in {patience_s:g} s')
        self._go_on_if(run, question.answers or isinstance(given, Image))

    def _say_status(self, run: Run, state: int) -> None:
        outcome = Outcome.INTERRUPTED if state == RunStatus.ENDED else ''
        self._say(interface.RUN_STATUS, RunStatus(
            header=header(0), run_id=run.run_id, state=state, outcome=outcome,
        ))

    def _say(self, topic: Any, message: Any) -> None:
        self._publishers[topic.name].publish(message)

    def _end(self, number: signal.Signals) -> None:
        """Ask the process to end, and record how it does."""
        self._run, process, file = None, self._process, self._process.log
        printed, begun_s = file.stat().st_size, time.monotonic()
        process.send(number)
        self._until(lambda: process.dead, _ENDING_S)
        after_s = time.monotonic() - begun_s
        in_time = process.dead and process.code != -signal.SIGKILL
        process.end()
        with file.open('rb') as log:
            log.seek(max(printed, file.stat().st_size - _TAIL_BYTES))
            said = log.read(_TAIL_BYTES).decode(errors='replace')
        left = [line for line in said.splitlines() if line.startswith(CHILDREN_LEFT)]
        wrong = [
            *([] if in_time else ['had to be killed']),
            *(['a traceback'] if shows_traceback(said) else []),
            *([f'leaves {left[-1].removeprefix(CHILDREN_LEFT)}'] if left and in_time else []),
        ]
        self._seen.endings.append((number.name, ', '.join(wrong), after_s))


def shows_traceback(printed: str) -> bool:
    """Whether a process that was to end printed a traceback of its own making.

    A signal between two lines of rclpy's spin is none: there it raises RCLError instead of
    ExternalShutdownException, in one ending of a hundred.
    """
    of_rclpy = len(re.findall(r'^rclpy\S*RCLError: .*context is not valid', printed, re.MULTILINE))
    return printed.count('Traceback (most recent call last)') > of_rclpy


def _image(pixels: Any, encoding: str = 'rgb8', share: int = 1) -> Image:
    """An image of these pixels, of which only a share comes."""
    return Image(
        height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
        step=pixels[:1].nbytes, data=pixels.tobytes()[:pixels.nbytes // share],
    )


_STRANGE: Final[dict[str, Callable[[Any], Image]]] = {
    'empty': lambda pixels: _image(pixels[:0, :0]),
    'cut off': lambda pixels: _image(pixels, share=3),
    'mono8': lambda pixels: _image(pixels[:, :, 0], 'mono8'),
}
