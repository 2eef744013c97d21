"""Drive a single user node through the lockstep protocol.

The kit simulates the simulator and all other participants on a private domain, with their names,
endpoints and a scenario, so that the node cannot distinguish it from a graph. The node's behaviour
is stored in a :class:`~taxinet_ros.nodes.node_check.record.Record`, which is evaluated elsewhere.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from sensor_msgs.msg import Image
from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.bag.run.messages import error_cdr, observation_messages
from taxinet_ros.core import topics
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState, TrackingError
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.command_wrapper import CHILDREN_LEFT
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep.endpoints import NAMELESS, heard_by
from taxinet_ros.nodes.messages.convert import header, scenario_message
from taxinet_ros.nodes.messages.step import (
    StepMessage,
    step_reader,
)
from taxinet_ros.nodes.node_check.clauses import Status, judge
from taxinet_ros.nodes.node_check.record import (
    ROLES,
    SIDES,
    Answer,
    End,
    Ending,
    Question,
    Record,
    Role,
    Run,
)
from taxinet_ros.nodes.running.domain import own_domain, require_discovery
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.node_main import spin_for

START_S: Final = 30.0
"""Timeout for a node to appear [s], as for READY in the simulator."""

_AWAITED_S = 300.0
"""Timeout for a node started by the user [s]."""

_READY_FACTOR = 3.0
_LOOK_S = 0.01
_MOMENT_S = 0.3
"""Time to watch for unexpected messages [s]."""

_ENDING_S: Final = 5.0
"""Time limit for a node to end [s]."""

_KEPT_S: Final = 60.0, 4.5
"""Grace periods of its wrapper after SIGINT and SIGTERM [s]."""

_TAIL_BYTES = 1 << 20
_TRACEBACK = 'Traceback (most recent call last)'
_SCENE = Scenario(distance_m=1000.0, time_of_day_s=10 * 3600.0, duration_s=60.0)


Starter = Callable[[Role, int, Path], NodeProcess]
"""Starts the node process of a role in a domain, with a log file."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """Options of a check.

    Attributes:
        start: starts the node's process; None if the user starts it.
        role: its role; None to detect it from the publishers of the node started.
        domain: ROS domain; None for a free one.
        frames: number of messages per run.
        patience_s: timeout for an answer; three times as long for READY [s].
        log: file for the node's output.
    """

    start: Starter | None
    role: str | None
    domain: int | None
    frames: int
    patience_s: float
    log: Path


def check_node(options: CheckOptions, say: Callable[[str], None]) -> Record:
    """Drive a node.

    Args:
        options: options of the check.
        say: called with a line on what is awaited.

    Raises:
        UsageError: the program does not exist, or the role cannot be detected.
    """
    require_discovery()
    with own_domain(options.domain) as domain:
        role = ROLES[options.role or 'perception']
        if options.start is None:
            say(f'waiting for your node on ROS domain {domain} (ROS_DOMAIN_ID={domain})')
        with _stage(options, role, domain) as stage:
            stage.find()
            seems = ROLES[options.role] if options.role else stage.looks_like()
            if seems is role:
                return stage.drive()
        with _stage(options, seems, domain) as stage:
            stage.find()
            return stage.drive()


@contextlib.contextmanager
def _stage(options: CheckOptions, role: Role, domain: int) -> Iterator[Stage]:
    with NodeExecutor(domain) as spinning:
        stage = Stage(options, role, domain, spinning)
        try:
            yield stage
        finally:
            stage.close()


class SilenceError(Exception):
    """A timeout expired, or the node has died."""


class Stage:
    """The graph without the checked node, and a record of that node's behaviour."""

    def __init__(
        self, options: CheckOptions, role: Role, domain: int, spinning: NodeExecutor
    ) -> None:
        """Create all nodes except the checked one, and start that one.

        To test readiness, the publisher of its input and a subscriber of its answers are created
        later.
        """
        self._options, self._role, self._executor = options, role, spinning.executor
        self._record = Record(
            role=role, ours=options.start is not None, patience_s=options.patience_s,
        )
        self._change = Future()
        self._run: Run | None = None
        self._publishers: dict[str, Publisher] = {}
        self._nodes = {
            name: Node(
                name, context=spinning.context, enable_rosout=False,
                start_parameter_services=False,
            ) for name in (interface.SIMULATOR, *interface.PARTICIPANTS) if name != role.node
        }
        for node in self._nodes.values():
            spinning.add(node)
        self._late_ear = (interface.MTL_MONITOR, role.answers)
        for topic in interface.TOPICS:
            for name, node in self._nodes.items():
                if name in topic.publishers and topic not in role.hears:
                    self._speak(name, topic)
                if name in topic.listeners(list(self._nodes)) \
                        and (name, topic) != self._late_ear:
                    self._listen(node, name, topic)
        self._states = _places(options.frames)
        self._camera = Camera(_SCENE) if role.word == 'perception' else None
        self._pictures: dict[int, Any] = {}
        self._process = options.start(role, domain, options.log) if options.start else None

    def close(self) -> None:
        """End the node if it was started here."""
        if self._process is not None:
            self._process.end()

    # The rest of the graph ---------------------------------------------------------------------

    def _speak(self, name: str, topic: Topic) -> None:
        publisher = self._nodes[name].create_publisher(topic.type, topic.name, topic.qos)
        self._publishers.setdefault(topic.name, publisher)

    def _listen(self, node: Node, name: str, topic: Topic) -> None:
        read = step_reader(topic)

        def hear(message: Any) -> None:
            if name == interface.SIMULATOR and topic is interface.NODE_STATUS:
                self._on_status(message)
            elif name == interface.SIMULATOR and topic is self._role.answers:
                self._on_answer(read(message))

        raw = topic is not interface.NODE_STATUS
        node.create_subscription(topic.type, topic.name, hear, topic.qos, raw=raw)

    def _on_status(self, status: NodeStatus) -> None:
        run = self._run
        if run is None:
            return
        if status.state == NodeStatus.READY and status.run_id == run.run_id:
            run.ready.append(status)
        elif status.state == NodeStatus.READY and not any(
            status.run_id == one.run_id for one in self._record.runs
        ):
            run.others.append(status.run_id)
        elif status.state == NodeStatus.ERROR and status.run_id == run.run_id:
            run.errors.append(status.detail)
        self._changed()

    def _on_answer(self, said: StepMessage) -> None:
        run = self._run
        if run is None:
            return
        asked = self._asked_by(run, said)
        if asked is None:
            run.unasked += 1
            return
        asked.answers.append(Answer(
            seq=said.seq, stamp_ns=said.stamp_ns, run_id=said.run_id, value=said.value,
            after_s=time.monotonic() - asked.asked_s,
        ))
        self._changed()

    def _asked_by(self, run: Run, said: StepMessage) -> Question | None:
        """The question an answer refers to: a slow answer may arrive in the next run."""
        def meant(one: Question) -> bool:
            return (one.seq, one.stamp_ns) == (said.seq, said.stamp_ns)

        earlier = [
            one for past in self._record.runs if past is not run and past.run_id == said.run_id
            for one in past.questions if meant(one) and not one.answers
        ]
        # An answer that matches no question can only refer to the newest one.
        found = earlier or [one for one in run.questions if meant(one)] or run.questions
        return found[-1] if found else None

    def _changed(self) -> None:
        if not self._change.done():
            self._change.set_result(None)

    def _until(self, condition: Callable[[], object], within_s: float) -> bool:
        """Spin until a condition holds, with a timeout.

        A second is counted as a hundred checks by this process, so that the node gets more time on
        a busy machine.
        """
        for _ in range(max(1, round(within_s / _LOOK_S))):
            if condition():
                return True
            if self._process is not None and self._process.dead:
                return bool(condition())
            self._change = Future()
            spin_for(self._executor, self._change, _LOOK_S)
        return bool(condition())

    def _watch(self, within_s: float = _MOMENT_S) -> None:
        self._until(lambda: False, within_s)

    def _dead(self) -> bool:
        if self._process is None:
            return False
        if self._process.dead and not self._record.died:
            self._record.died = self._process.how_it_ended()
            self._record.died_in = self._run.kind if self._run else ''
        return self._process.dead

    # Finding it --------------------------------------------------------------------------------

    def find(self) -> None:
        """Wait for the node's endpoints and record them."""
        if self._until(self._theirs, START_S if self._process is not None else _AWAITED_S):
            self._until(self._whole, _READY_FACTOR * self._options.patience_s)
            self._watch(2 * _MOMENT_S)  # its other endpoints
        self._dead()
        self._survey()

    def looks_like(self) -> Role:
        """Role of the node by its publishers; the current one if ambiguous."""
        spoken = {end.topic.name for end in self._record.ends if end.publishes}
        fitting = [role for role in ROLES.values() if role.answers.name in spoken]
        return fitting[0] if len(fitting) == 1 else self._role

    def _theirs(self) -> list[tuple[str, str]]:
        """Names and namespaces of nodes outside the kit."""
        watcher = self._nodes[interface.SIMULATOR]
        found = Counter(
            (name, space) for name, space in watcher.get_node_names_and_namespaces()
            if not name.startswith('_')
        )
        # Not by name alone: a user's node may have the name of a kit node.
        return list((found - Counter((name, '/') for name in self._nodes)).elements())

    def _whole(self) -> bool:
        """Whether the node has all endpoints of some role, whatever its name."""
        self._survey()
        ends = {(end.topic.name, end.publishes) for end in self._record.ends}
        needed = {(interface.NODE_STATUS.name, True), (interface.SCENARIO.name, False)}
        # Only once: remains of a killed process disappear later.
        named = [name for name, _ in self._theirs()].count(self._role.node) == 1
        return named and needed <= ends and any(
            (role.answers.name, True) in ends
            and any((topic.name, False) in ends for topic in role.hears)
            for role in ROLES.values()
        )

    def _survey(self) -> None:
        watcher = self._nodes[interface.SIMULATOR]
        ends = []
        for topic in interface.TOPICS:
            for found, publishes in (
                (watcher.get_publishers_info_by_topic(topic.name), True),
                (watcher.get_subscriptions_info_by_topic(topic.name), False),
            ):
                ends += [
                    End(
                        node=one.node_name, topic=topic, publishes=publishes,
                        type_name=one.topic_type, qos=one.qos_profile,
                    ) for one in found
                    if one.node_name not in (NAMELESS, *self._nodes)
                ]
        self._record.ends = ends
        theirs = self._theirs()
        if theirs:
            self._record.nodes = sorted(f'{space.rstrip("/")}/{name}' for name, space in theirs)

    # Driving it --------------------------------------------------------------------------------

    def drive(self) -> Record:
        """Run all tests that are not blocked by a violation."""
        with contextlib.suppress(SilenceError):
            if not self._fits():
                return self._record
            self._first()
            self._asked('second')
            self._survey()
            self._strange()
        if self._process is not None and not self._dead():
            given_up = self._record.runs[-1].given_up
            self._end('SIGINT')
            if not given_up:
                self._begin_again()
        return self._record

    def _fits(self) -> bool:
        """Whether its endpoints allow a run to start."""
        found = {one.clause.name: one.status for one in judge(self._record)}
        return not self._dead() and all(
            found[name] is Status.PASS for name in ('starts', 'name', 'topics', 'qos')
        )

    def _begin_again(self) -> None:
        """Start a fresh process without state of the previous one."""
        assert self._process is not None
        self._run = None
        self._process.start()
        with contextlib.suppress(SilenceError):
            self._asked('fresh', START_S)
        if not self._dead():
            self._end('SIGTERM')

    def _first(self) -> None:
        """The first run: test for READY before all endpoints are matched."""
        run = self._begin('first')
        name, topic = self._late_ear
        self._watch()
        self._note_early(run, f'{name} hearing {topic.name}')
        self._listen(self._nodes[name], name, topic)
        self._watch()
        self._note_early(run, f'anybody publishing {self._role.hears[0].name}')
        for heard in self._role.hears:
            for speaker in heard.publishers:
                self._speak(speaker, heard)
        self._await_ready(run, _READY_FACTOR * self._options.patience_s)
        self._ask_all(run)

    def _note_early(self, run: Run, who: str) -> None:
        if run.ready and not run.early:
            run.early = who

    def _matched(self) -> bool:
        """Whether messages to the node would reach it now."""
        return not self._unmatched()

    def _unmatched(self) -> list[str]:
        """Topics on which the node would miss messages sent now."""
        heard = {end.topic.name for end in self._record.ends if not end.publishes}
        return [
            topic.name for topic in self._role.hears if topic.name in heard and not heard_by(
                self._nodes[topic.publishers[0]], self._publishers[topic.name], [self._role.node]
            )
        ]

    def _asked(self, kind: str, within_s: float = 0.0) -> None:
        """An ordinary run."""
        run = self._begin(kind)
        self._await_ready(run, max(within_s, _READY_FACTOR * self._options.patience_s))
        self._ask_all(run)

    def _strange(self) -> None:
        """Malformed images, each in a separate run; or invalid estimates."""
        if self._role.word == 'controller':
            run = self._begin('strange')
            self._await_ready(run, _READY_FACTOR * self._options.patience_s)
            for seq, (kind, estimate) in enumerate(_UNUSABLE.items()):
                self._ask(run, Question(seq=seq, truth=self._truth(seq), kind=kind), estimate)
            self._finish()
        elif any(end.topic is interface.IMAGE and not end.publishes for end in self._record.ends):
            for kind, change in _STRANGE.items():
                run = self._begin('strange')
                self._await_ready(run, _READY_FACTOR * self._options.patience_s)
                question = Question(seq=0, truth=self._truth(0), kind=kind)
                self._show(run, question, _image(change, self._picture(0)))
                self._finish()
        run = self._begin('after')
        self._await_ready(run, _READY_FACTOR * self._options.patience_s)
        self._ask(run, Question(seq=0, truth=self._truth(0)))
        self._finish()

    # One run -----------------------------------------------------------------------------------

    def _begin(self, kind: str) -> Run:
        run_id = f'check-{len(self._record.runs):05d}-{kind}'
        self._run = run = Run(run_id=run_id, kind=kind)
        self._record.runs.append(run)
        self._say(interface.SCENARIO, scenario_message(RunRequest(
            run_id=run_id, index=len(self._record.runs) - 1, program='check-node', seed=0,
            scenario=_SCENE, judging=Judging(specs=('phi_always',)),
            participants=interface.PARTICIPANTS,
        )))
        self._say(interface.RUN_STATUS, _run_status(run, RunStatus.PREPARING))
        return run

    def _await_ready(self, run: Run, within_s: float) -> None:
        begun_s = time.monotonic()
        self._until(lambda: run.ready or run.errors or self._dead(), within_s)
        run.ready_s = time.monotonic() - begun_s
        if not run.ready:
            self._abandon(run)
        # As the simulator does.
        if not self._until(lambda: self._matched() or self._dead(), within_s):
            run.unmatched = tuple(self._unmatched())
            self._abandon(run)
        self._say(interface.RUN_STATUS, _run_status(run, RunStatus.RUNNING))

    def _ask_all(self, run: Run) -> None:
        for seq in range(len(self._states)):
            self._ask(run, Question(seq=seq, truth=self._truth(seq)))
        self._finish()

    def _ask(self, run: Run, question: Question, estimate: TrackingError | None = None) -> None:
        """Send a message and wait for its answer."""
        self._put(run, question, estimate=estimate)
        self._until(
            lambda: question.answers or run.errors or self._dead(), self._options.patience_s
        )
        if not question.answers:
            question.missed = True
            self._abandon(run)

    def _show(self, run: Run, question: Question, image: Image) -> None:
        """Send an image that needs no answer, and wait for a possible one."""
        self._put(run, question, image=image)
        self._until(lambda: question.answers or run.errors or self._dead(), _MOMENT_S)
        if self._dead():
            self._abandon(run)

    def _abandon(self, run: Run) -> None:
        run.given_up = not self._dead()
        if not run.given_up or run.errors:
            self._say(interface.RUN_STATUS, _run_status(run, RunStatus.ENDED))
        raise SilenceError

    def _finish(self) -> None:
        run = self._run
        assert run is not None
        self._say(interface.RUN_STATUS, _run_status(run, RunStatus.ENDED))
        self._watch(_MOMENT_S / 3)  # The duplicate.
        if self._dead():
            raise SilenceError

    def _put(
        self, run: Run, question: Question, *, estimate: TrackingError | None = None,
        image: Image | None = None,
    ) -> None:
        """Publish the simulator's and perception's messages of a control step."""
        seq, stamp_ns = question.seq, question.stamp_ns
        run.questions.append(question)
        picture = None if image is not None or self._camera is None else self._picture(seq)
        state = self._states[seq % len(self._states)]
        now = Observation(seq=seq, stamp_ns=stamp_ns, state=state, image=picture)
        question.asked_s = time.monotonic()
        for topic, message in observation_messages(now, run.run_id):
            self._say(topic, message)
        if image is not None:
            image.header = header(stamp_ns, interface.CAMERA_FRAME)
            self._say(interface.IMAGE, image)
        if interface.ESTIMATE in self._role.hears:
            said = question.truth if estimate is None else estimate
            self._say(interface.ESTIMATE, error_cdr(said, run.run_id, seq, stamp_ns))

    def _say(self, topic: topics.Topic, message: Any) -> None:
        self._publishers[topic.name].publish(message)

    def _truth(self, seq: int) -> TrackingError:
        return self._states[seq % len(self._states)].tracking_error

    def _picture(self, seq: int) -> Any:
        seq %= len(self._states)
        if seq not in self._pictures:
            assert self._camera is not None
            self._pictures[seq] = self._camera.render(self._states[seq], seq * CONTROL_PERIOD_NS)
        return self._pictures[seq]

    # Its process -------------------------------------------------------------------------------

    def _end(self, name: str) -> None:
        """Request the process to end, and record how it does."""
        assert self._process is not None
        self._run = None
        process, printed = self._process, self._options.log.stat().st_size
        begun_s = time.monotonic()
        process.send(signal.Signals[name])
        self._until(lambda: process.dead, _ENDING_S)
        after_s: float | None = time.monotonic() - begun_s
        if not process.dead or process.code == -signal.SIGKILL:
            after_s = None
        process.end()
        with self._options.log.open('rb') as log:
            log.seek(max(printed, self._options.log.stat().st_size - _TAIL_BYTES))
            said = log.read(_TAIL_BYTES).decode(errors='replace')
        left = [line for line in said.splitlines() if line.startswith(CHILDREN_LEFT)]
        self._record.endings[name] = Ending(
            after_s=after_s, traceback=_TRACEBACK in said,
            left=left[-1].removeprefix(CHILDREN_LEFT) if left and after_s is not None else '',
        )


def _run_status(run: Run, state: int) -> RunStatus:
    outcome = Outcome.INTERRUPTED if state == RunStatus.ENDED else ''
    return RunStatus(header=header(0), run_id=run.run_id, state=state, outcome=outcome)


def _places(count: int) -> list[AircraftState]:
    """Aircraft poses step by step: first :data:`SIDES`, then across the runway."""
    begin = Aircraft(_SCENE).state
    places = list(SIDES)[:count]
    for step in range(count - len(places)):
        turn = 2 * math.pi * step / max(count - len(SIDES), 1)
        places.append((5 * math.sin(turn), 0.15 * math.sin(2 * turn + 0.5)))
    return [
        dataclasses.replace(begin, x_m=begin.x_m + 0.5 * step, y_m=cte_m, yaw_rad=he_rad)
        for step, (cte_m, he_rad) in enumerate(places)
    ]


_UNUSABLE: Final = {
    'valid=false': TrackingError(cte_m=0.0, he_rad=0.0, valid=False),
    'NaN': TrackingError(cte_m=math.nan, he_rad=math.nan),
    'infinite': TrackingError(cte_m=math.inf, he_rad=0.0),
}


def _image(change: Callable[[Image, Any], None], pixels: Any) -> Image:
    height, width, _ = pixels.shape
    image = Image(
        height=height, width=width, encoding='rgb8', step=3 * width, data=pixels.tobytes()
    )
    change(image, pixels)
    return image


def _empty(image: Image, pixels: Any) -> None:
    image.height = image.width = image.step = 0
    image.data = b''


def _cut(image: Image, pixels: Any) -> None:
    image.data = pixels.tobytes()[:pixels.size // 3]


def _grey(image: Image, pixels: Any) -> None:
    grey = np.ascontiguousarray(pixels[:, :, 0])
    image.encoding, image.step, image.data = 'mono8', grey.shape[1], grey.tobytes()


_STRANGE: Final = {'empty': _empty, 'cut off': _cut, 'mono8': _grey}


def command_starter(words: list[str]) -> Starter:
    """Starter of a user's command, as in the graph."""
    def start(role: Role, domain: int, log: Path) -> NodeProcess:
        command = [*words, '--ros-args', '-r', f'__node:={role.node}']
        return NodeProcess.of_command(
            role.node, command, domain=domain, log=log, graces_s=_KEPT_S
        )

    return start
