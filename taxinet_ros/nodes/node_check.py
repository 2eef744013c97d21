"""Check one user node against the lockstep protocol, clause by clause.

The kit simulates the simulator and all other participants on a private domain, with their names,
endpoints and a scenario, so that the node cannot distinguish it from a graph. The clauses are data;
``docs/own_nodes.md`` lists the same, and a test compares both.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import math
import re
import signal
import statistics
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import Image
from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.bag.run.messages import error_cdr, observation_messages
from taxinet_ros.core import topics
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.pacing.stepped_run import subnormal
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand, TrackingError
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.command_wrapper import CHILDREN_LEFT
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.messages.convert import header, same_ready, scenario_message
from taxinet_ros.nodes.messages.step import StepMessage, step_reader
from taxinet_ros.nodes.running.domain import NAMELESS, heard_by, own_domain, require_discovery
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.node_main import spin_for

BOTH: Final = ('perception', 'controller')
"""The roles of a clause that applies to both."""


class Status(enum.StrEnum):
    """Result of a clause."""

    PASS = 'PASS'
    FAIL = 'FAIL'
    NOTE = 'note'
    NOT_TRIED = 'not tried'


@dataclass(frozen=True)
class Clause:
    """One requirement on a node.

    Attributes:
        name: short name.
        expected: the requirement in one line; ``{node}``, ``{answers}`` and ``{hears}`` are filled
            in.
        mend: how to fix a violation.
        roles: roles it applies to.
        informative: not a requirement; the observation is reported.
    """

    name: str
    expected: str
    mend: str = ''
    roles: tuple[str, ...] = BOTH
    informative: bool = False


CLAUSES: Final = (
    Clause('starts', 'the command starts, and a node of it joins the graph within 30 s',
           'run it by hand: its own output says why'),
    Clause('name', 'its node is called {node}, in no namespace',
           'hand the command line on: rclpy.init(), or rclcpp::init(argc, argv); '
           'a second node of yours with use_global_arguments=False'),
    Clause('topics', 'publishes {answers} and node_status, hears scenario and {hears}, with the '
           'types of the table; publishes nothing else of the graph',
           'relative names and messages, as in the table of the docs'),
    Clause('qos', 'scenario and node_status reliable, transient local; the rest reliable, its '
           'subscriptions volatile',
           'QoSProfile(depth=16), for those two with durability=TRANSIENT_LOCAL'),
    Clause('ready', 'a NodeStatus READY for each run, with the run_id of its Scenario, node, '
           'implementation, fingerprint (SHA-256 or empty), and listens (its topics)',
           'publish it on node_status at every Scenario, when the ends are matched'),
    Clause('waits', 'no READY before each end of the run is matched, in both directions',
           'count the subscriptions of your publisher, and the publishers of your input'),
    Clause('answers', 'one answer to each message, within the patience, and none unasked',
           'publish once from the callback of the input, without conditions'),
    Clause('step', 'the answer has the run_id of the run, and seq and header.stamp of the message '
           'answered',
           'copy the stamp; seq is the stamp in ns divided by 100,000,000; a controller copies it'),
    Clause('values', 'each field has the type of the message, numbers are finite, a speed is not '
           'below 0; or valid=false',
           'float(x) around each number, bool(x) around valid; say valid=false where you cannot '
           'tell; a controller brakes'),
    Clause('forgets', 'the same messages in a second run have the same answers',
           'begin each run as the first: reset filters and counters, seed random numbers, have a '
           'GPU compute in a fixed order'),
    Clause('bad_input', 'an image that is empty, cut off or of another encoding does not end the '
           'node: valid=false, no answer, or ERROR with a detail',
           'look at encoding, size and len(data) before you reshape', ('perception',)),
    Clause('bad_input', 'an estimate that is not valid, NaN or infinite has a finite command too',
           'brake: angle 0, speed 0', ('controller',)),
    Clause('lives', 'the node lives on from run to run', 'see its output'),
    Clause('ends', 'ends within 5 s of SIGINT and of SIGTERM, without a traceback, and leaves no '
           'process',
           'except (KeyboardInterrupt, ExternalShutdownException): pass, around spin; end the '
           'processes that it started, and wait for them'),
    Clause('time', 'how long an answer takes', informative=True),
    Clause('accuracy', 'estimates against the truth', roles=('perception',), informative=True),
    Clause('steering', 'to which side it steers, left positive; largest angle and speed',
           roles=('controller',), informative=True),
)
"""Clauses in order; those blocked by a broken one are not tried."""
_OF_NUMBERS: Final = ('forgets', 'bad_input', 'accuracy', 'steering')
"""Clauses that need valid numbers."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one clause; ``came`` is the observation in one line."""

    clause: Clause
    status: Status
    came: str
    expected: str


@dataclass(frozen=True, kw_only=True)
class Role:
    """One of the roles of a user's node.

    Attributes:
        word: word of the option, ``perception`` or ``controller``.
        node: the node's name.
        hears: input topics, one of which is used.
        answers: topic of its answers.
    """

    word: str
    node: str
    hears: tuple[Topic, ...]
    answers: Topic


ROLES: Final = {
    role.word: role for role in (
        Role(
            word='perception', node=interface.PERCEPTION,
            hears=(interface.IMAGE, interface.TRUTH), answers=interface.ESTIMATE,
        ),
        Role(
            word='controller', node=interface.STEERING_CONTROLLER,
            hears=(interface.ESTIMATE,), answers=interface.COMMAND,
        ),
    )
}


@dataclass(frozen=True, kw_only=True)
class End:
    """A publisher or a subscription of the node on a topic of the graph."""

    node: str
    topic: Topic
    publishes: bool
    type_name: str
    qos: Any

    def misfit(self) -> str:
        """Mismatch of its quality of service with the table; '' if none."""
        offers = 'offered' if self.publishes else 'asked for'
        if self.qos.reliability != ReliabilityPolicy.RELIABLE:
            return f'{self}: reliability {_word(self.qos.reliability)} {offers}, reliable needed'
        needed = self.topic.qos.durability
        latched = needed == DurabilityPolicy.TRANSIENT_LOCAL
        if self.qos.durability != needed and (latched or not self.publishes):
            return f'{self}: durability {_word(self.qos.durability)} {offers}, {_word(needed)} ' \
                'needed'
        return ''

    def __str__(self) -> str:
        return f'{"publisher" if self.publishes else "subscription"} of {self.topic.name}'


def _word(policy: Any) -> str:
    return str(policy.name).lower().replace('_', ' ')


@dataclass(kw_only=True)
class Question:
    """A message to be answered by the node; ``kind`` says what is wrong with it, or ''."""

    seq: int
    truth: TrackingError
    kind: str = ''
    asked_s: float = 0.0
    answers: list[StepMessage] = field(default_factory=list)

    @property
    def stamp_ns(self) -> int:
        """Simulated time of the step [ns]."""
        return self.seq * CONTROL_PERIOD_NS


@dataclass(kw_only=True)
class Run:
    """Behaviour of the node in one run.

    Attributes:
        run_id: run_id of its Scenario.
        kind: ``first``, ``second``, ``strange``, ``after`` or ``fresh``.
        ready: whether the node was ready for it.
        error: detail of its first ERROR, or ''.
        other: run_id of a READY for an unknown run, or ''.
        questions: questions in order.
    """

    run_id: str
    kind: str
    ready: bool = False
    error: str = ''
    other: str = ''
    questions: list[Question] = field(default_factory=list)

    def pairs(self) -> list[tuple[TrackingError, Any]]:
        """The truth of each answered question, and the value of its first answer."""
        return [(one.truth, one.answers[0].value) for one in self.questions if one.answers]


# Judgements of endpoints and values -------------------------------------------------------------


def topics_broken(role: Role, ends: Sequence[End]) -> list[str]:
    """What is wrong with the topics on which the endpoints of a node are."""
    own = [end for end in ends if end.node == role.node]
    spoken = Counter(end.topic.name for end in own if end.publishes)
    heard = {end.topic.name for end in own if not end.publishes}
    inputs = [topic.name for topic in role.hears]
    return [
        *(f'does not publish {topic.name}' for topic in (role.answers, interface.NODE_STATUS)
          if topic.name not in spoken),
        *([] if interface.SCENARIO.name in heard else ['does not hear scenario']),
        *([] if heard & {*inputs} else [f'does not hear {" or ".join(inputs)}']),
        *(f'publishes {name}'
          for name in sorted(spoken.keys() - {role.answers.name, interface.NODE_STATUS.name})),
        *(f'publishes {name} {times} times' for name, times in spoken.items() if times > 1),
        *(f'{end.node} publishes {end.topic.name}' for end in ends
          if end.publishes and end.node != role.node),
        *(f'{end} has {end.type_name}, not {end.topic.type_name}' for end in own
          if end.type_name != end.topic.type_name),
    ]


def bad_value(value: TrackingError | TaxiCommand) -> str:
    """What is wrong with the numbers of an answer; '' if nothing."""
    if words := subnormal(value):
        return words
    if isinstance(value, TrackingError):
        wrong = value.valid and not value.usable
        return f'{value.cte_m:g} m, {value.he_rad:g} rad, valid=true' if wrong else ''
    fits = math.isfinite(value.steering_rad) and 0 <= value.speed_mps < math.inf
    return '' if fits else f'{value.steering_rad:g} rad at {value.speed_mps:g} m/s'


def _wrong_step(run: Run, asked: Question, said: StepMessage) -> str:
    if said.run_id != run.run_id:
        return f'run_id {said.run_id!r}, not {run.run_id!r}'
    if said.seq != asked.seq:
        return f'seq {said.seq} to frame {asked.seq}'
    if said.stamp_ns == asked.stamp_ns:
        return ''
    return f'stamp {said.stamp_ns / NS_PER_S:g} s to frame {asked.seq}, of ' \
        f'{asked.stamp_ns / NS_PER_S:g}'


def difference(first: Run, other: Run) -> str:
    """The first answer in which two runs differ, or ''."""
    values = ([_comparable(value) for _, value in run.pairs()] for run in (first, other))
    for seq, pair in enumerate(zip(*values, strict=False)):
        if pair[0] != pair[1]:
            rounded = [_shown(value) for value in pair]
            exact = [_shown(value, digits=17) for value in pair]
            one, two = rounded if len(set(rounded)) == 2 else exact
            return f'frame {seq}: {one}, then {two}'
    return ''


def _comparable(value: TrackingError | TaxiCommand) -> tuple[Any, ...]:
    """Convert to a value that equals itself even with NaN."""
    if isinstance(value, TrackingError):
        return (repr(value.cte_m), repr(value.he_rad), value.valid) if value.valid else (False,)
    return repr(value.steering_rad), repr(value.speed_mps)


def _shown(values: tuple[Any, ...], digits: int = 6) -> str:
    numbers = [
        f'{float(one):.{digits}g}' if isinstance(one, str) else f'valid={one}' for one in values
    ]
    return f'({", ".join(numbers)})'


# Plausibility of its answers ---------------------------------------------------------------------

SIDES: Final = ((3.0, 0.0), (-3.0, 0.0), (0.0, 0.2), (0.0, -0.2))
"""First poses used for questions: cross-track error [m] and heading error [rad]."""
_DEGREES = 180.0 / math.pi
_STEERING_LIMIT_RAD, _SPEED_LIMIT_MPS = math.pi / 3, 10.0


def accuracy(pairs: Sequence[tuple[TrackingError, TrackingError]]) -> str:
    """Error of estimates against the truth, and the usual mistakes."""
    usable = [(true, said) for true, said in pairs if said.usable]
    if len(usable) < len(SIDES):
        return f'{len(usable)} usable estimates of {len(pairs)}'
    cte, he = (
        np.array([[getattr(true, name), getattr(said, name)] for true, said in usable])
        for name in ('cte_m', 'he_rad')
    )
    words = [
        f'CTE {_short(np.abs(cte[:, 1] - cte[:, 0]).mean())} m{_suspect("CTE", cte)}',
        f'HE {_short(np.degrees(np.abs(he[:, 1] - he[:, 0]).mean()))} deg{_suspect("HE", he)}',
    ]
    return f'mean absolute error of {len(usable)} frames: {", ".join(words)}'


def _short(error: float) -> str:
    return f'{error:.2f}' if error < 1e6 else f'{error:.3g}'


def _suspect(name: str, pairs: np.ndarray[Any, Any]) -> str:
    """Detect common mistakes from estimates against the truth."""
    true, said = pairs[:, 0], pairs[:, 1]
    if said.std() == 0 or true.std() == 0:
        return f' ({name} is always the same)'
    together = float(np.corrcoef(true, said)[0, 1])
    factor = float((true * said).sum() / (true * true).sum())
    if together < -0.8:
        return f' ({name} seems to have the wrong sign: left is positive)'
    if name == 'HE' and together > 0.8 and _DEGREES / 2 < factor < _DEGREES * 2:
        return ' (HE looks like degrees, not radians)'
    return ''


def steering(pairs: Sequence[tuple[TrackingError, TaxiCommand]]) -> str:
    """To which side commands steer from :data:`SIDES`, and the largest of all."""
    sides = pairs[:len(SIDES)]
    away = [
        f'{true.cte_m:g} m, {math.degrees(true.he_rad):.0f} deg' for true, command in sides
        if command.steering_rad * (true.cte_m + true.he_rad) > 0
    ]
    still = all(command.steering_rad == 0 for _, command in sides)
    side = f'steers AWAY from the centreline at {"; ".join(away)}' if away else \
        'it does not steer' if still else 'towards the line'
    angle = max(abs(command.steering_rad) for _, command in pairs)
    speed = max(command.speed_mps for _, command in pairs)
    return ''.join([
        f'3 m left of the line: {math.degrees(sides[0][1].steering_rad):.1f} deg; {side}',
        f'; at most {math.degrees(angle):.1f} deg, {speed:g} m/s',
        ': beyond any nose wheel; is it in radians?' if angle > _STEERING_LIMIT_RAD else '',
        ': faster than taxiing; is it in m/s?' if speed > _SPEED_LIMIT_MPS else '',
    ])


def answer_time(took_s: Sequence[float]) -> str:
    """Median and maximum of the times that answers took [s]."""
    median, worst = statistics.median(took_s), max(took_s)
    factor = CONTROL_PERIOD_NS / NS_PER_S / max(median, 1e-9)
    slow = '' if factor >= 1 else '; slower than real time'
    return f'median {median * 1e3:.1f} ms, max {worst * 1e3:.1f} ms of {len(took_s)}: at most ' \
        f'{factor:.3g} x real time{slow}'


# The check ---------------------------------------------------------------------------------------

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
_FIELD_REFUSED: Final = re.compile(r"The '\w+' field must be ")
_SCENE = Scenario(distance_m=1000.0, time_of_day_s=10 * 3600.0, duration_s=60.0)

Starter = Callable[[Role, int, Path], NodeProcess]
"""Starts the node process of a role in a domain, with a log file."""


@dataclass(frozen=True, kw_only=True)
class Report:
    """What was found of each clause that applies to a node's role, in order."""

    role: Role
    findings: Sequence[Finding]

    @property
    def broken(self) -> list[str]:
        """Names of the broken clauses."""
        return [one.clause.name for one in self.findings if one.status is Status.FAIL]


def check_node(
    start: Starter | None, role_name: str | None, say: Callable[[str], None], *,
    domain_id: int | None, frames: int, patience_s: float, log: Path,
) -> Report:
    """Drive a node, and judge it.

    Args:
        start: starts the node's process; None if the user starts it.
        role_name: its role; None to detect it from the publishers of the node started.
        say: called with a line on what is awaited.
        domain_id: ROS domain; None for a free one.
        frames: number of messages per run.
        patience_s: timeout for an answer; three times as long for READY [s].
        log: file for the node's output.

    Raises:
        UsageError: the program does not exist, or the role cannot be detected.
    """
    require_discovery()
    with own_domain(domain_id) as domain:
        role = ROLES[role_name or 'perception']
        if start is None:
            say(f'waiting for your node on ROS domain {domain} (ROS_DOMAIN_ID={domain})')
        known = role_name is not None
        while True:
            with (
                NodeExecutor(domain) as spinning,
                contextlib.closing(Stage(
                    start, role, domain, spinning, frames=frames, patience_s=patience_s, log=log,
                )) as stage,
            ):
                stage.find()
                seems = role if known else stage.looks_like()
                if seems is role:
                    return stage.drive()
            role, known = seems, True


class SilenceError(Exception):
    """A timeout expired, or the node has died."""


class Verdicts:
    """What is known of each clause of a role; the first violation of a clause counts."""

    def __init__(self, role: Role) -> None:
        """Nothing is known."""
        self._role = role
        self._broken: dict[str, str] = {}
        self._kept: dict[str, str] = {}
        self._untried: dict[str, str] = {}

    def judge(self, name: str, broken: str, came: str) -> None:
        """Record a violation if there is one, else what came."""
        if broken:
            self._broken.setdefault(name, broken)
        else:
            self._kept[name] = came

    def skip(self, name: str, why: str) -> None:
        """Record why a clause is not tried."""
        self._untried[name] = why

    def any_broken(self, *names: str) -> bool:
        """Whether one of these clauses is broken."""
        return bool(self._broken.keys() & {*names})

    def findings(self) -> list[Finding]:
        """Result of each clause."""
        role = self._role
        words = {
            'node': role.node, 'answers': role.answers.name,
            'hears': ' or '.join(topic.name for topic in role.hears),
        }
        if self.any_broken('values'):
            for name in _OF_NUMBERS:
                self._broken.pop(name, None)
                self._kept.pop(name, None)
        return [
            Finding(
                clause=clause, status=status, came=came, expected=clause.expected.format(**words),
            )
            for clause in CLAUSES if role.word in clause.roles
            for status, came in [self._of(clause)]
        ]

    def _of(self, clause: Clause) -> tuple[Status, str]:
        name = clause.name
        if name in self._broken:
            return Status.FAIL, self._broken[name]
        if name in self._kept:
            return Status.NOTE if clause.informative else Status.PASS, self._kept[name]
        first = f'fix {", ".join(self._broken)} first' if self._broken else 'not reached'
        return Status.NOT_TRIED, self._untried.get(name, first)


class Stage:
    """The graph without the checked node, and what that node does."""

    def __init__(
        self, start: Starter | None, role: Role, domain: int, spinning: NodeExecutor, *,
        frames: int, patience_s: float, log: Path,
    ) -> None:
        """Create all nodes except the checked one, and start that one, if it is started here.

        To test readiness, the publisher of its input and a subscriber of its answers are created
        later.
        """
        self._role, self._executor = role, spinning.executor
        self._patience_s, self._log = patience_s, log
        self._verdicts = Verdicts(role)
        self._change = Future()
        self._runs: list[Run] = []
        self._run: Run | None = None
        self._ready: list[NodeStatus] = []
        self._took_s: list[float] = []
        self._died, self._died_in, self._given_up = '', '', False
        self._names: list[str] = []
        self._ends: list[End] = []
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
        self._states = _places(frames)
        self._camera = Camera(_SCENE) if role.word == 'perception' else None
        self._pictures: dict[int, Any] = {}
        self._process = start(role, domain, log) if start else None

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
            run.ready = True
            self._ready.append(status)
        elif status.state == NodeStatus.READY and not any(
            status.run_id == one.run_id for one in self._runs
        ):
            run.other = status.run_id
        elif status.state == NodeStatus.ERROR and status.run_id == run.run_id:
            run.error = run.error or status.detail or 'no detail'
        self._changed()

    def _on_answer(self, said: StepMessage) -> None:
        run = self._run
        if run is None:
            return
        asked_in, asked = self._asked_by(run, said)
        if asked is None:
            self._verdicts.judge('answers', f'one before the first frame of run {run.kind}', '')
            return
        asked.answers.append(said)
        if not asked.kind:
            self._took_s.append(time.monotonic() - asked.asked_s)
            number, count = len(asked.answers), len(self._took_s)
            several = f'{number} to frame {asked.seq} of run {asked_in.kind}' if number > 1 else ''
            self._verdicts.judge('answers', several, f'{count} of {count}')
            self._verdicts.judge('step', _wrong_step(asked_in, asked, said), 'in each answer')
            self._verdicts.judge('values', bad_value(said.value), 'in each answer')
        self._changed()

    def _asked_by(self, run: Run, said: StepMessage) -> tuple[Run, Question | None]:
        """The question an answer refers to: a slow answer may arrive in the next run."""
        def meant(one: Question) -> bool:
            return (one.seq, one.stamp_ns) == (said.seq, said.stamp_ns)

        for past in self._runs:
            for one in past.questions:
                if past is not run and past.run_id == said.run_id and meant(one) \
                        and not one.answers:
                    return past, one
        # An answer that matches no question can only refer to the newest one.
        found = [one for one in run.questions if meant(one)] or run.questions
        return run, found[-1] if found else None

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
        if self._process.dead and not self._died:
            self._died = self._process.how_it_ended()
            self._died_in = self._run.kind if self._run else ''
        return self._process.dead

    # Finding it --------------------------------------------------------------------------------

    def find(self) -> None:
        """Wait for the node's endpoints and record them."""
        if self._until(self._theirs, START_S if self._process is not None else _AWAITED_S):
            self._until(self._whole, _READY_FACTOR * self._patience_s)
            self._watch(2 * _MOMENT_S)  # its other endpoints
        self._dead()
        self._survey()

    def looks_like(self) -> Role:
        """Role of the node by its publishers; the current one if ambiguous."""
        spoken = {end.topic.name for end in self._ends if end.publishes}
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
        ends = {(end.topic.name, end.publishes) for end in self._ends}
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
        self._ends = [
            End(
                node=one.node_name, topic=topic, publishes=publishes, type_name=one.topic_type,
                qos=one.qos_profile,
            )
            for topic in interface.TOPICS
            for found, publishes in (
                (watcher.get_publishers_info_by_topic(topic.name), True),
                (watcher.get_subscriptions_info_by_topic(topic.name), False),
            )
            for one in found if one.node_name not in (NAMELESS, *self._nodes)
        ]
        if theirs := self._theirs():
            self._names = sorted(f'{space.rstrip("/")}/{name}' for name, space in theirs)

    def _heard(self) -> set[str]:
        """Topics that the node subscribes to."""
        return {
            end.topic.name for end in self._ends
            if end.node == self._role.node and not end.publishes
        }

    def _judge_ends(self) -> None:
        shown, name = ', '.join(self._names), f'/{self._role.node}'
        self._verdicts.judge('starts', '' if self._names else self._died or 'no node came', shown)
        if not self._names:
            return
        others = {f'/{one}' for one in (interface.SIMULATOR, *interface.PARTICIPANTS)} - {name}
        count = self._names.count(name)
        wrong = [
            *([] if count else [f'found {shown}']),
            *([f'{count} nodes are called {name}'] if count > 1 else []),
            *(f'{one} is the name of another node of the graph'
              for one in sorted(others & {*self._names})),
        ]
        self._verdicts.judge('name', '; '.join(wrong), shown)
        own = [end for end in self._ends if end.node == self._role.node]
        if count:
            broken = '; '.join(topics_broken(self._role, self._ends))
            self._verdicts.judge('topics', broken, f'hears {", ".join(sorted(self._heard()))}')
        if own:
            misfits = [misfit for end in own if (misfit := end.misfit())]
            self._verdicts.judge('qos', '; '.join(misfits), f'{len(own)} ends')

    # Driving it --------------------------------------------------------------------------------

    def drive(self) -> Report:
        """Run all tests that are not blocked by a violation."""
        self._judge_ends()
        if self._died:
            self._verdicts.judge('starts', self._died, '')
        elif not self._verdicts.any_broken('starts', 'name', 'topics', 'qos'):
            with contextlib.suppress(SilenceError):
                self._first()
                self._run_through('second')
                self._survey()
                self._judge_ends()
                self._strange()
            if self._process is not None and not self._dead():
                self._end('SIGINT')
                if not self._given_up:
                    self._begin_again()
            self._judge_runs()
        return Report(role=self._role, findings=self._verdicts.findings())

    def _begin_again(self) -> None:
        """Start a fresh process without state of the previous one."""
        assert self._process is not None
        self._run = None
        self._process.start()
        with contextlib.suppress(SilenceError):
            self._run_through('fresh', START_S)
        if not self._dead():
            self._end('SIGTERM')

    def _first(self) -> None:
        """The first run: test for READY before all endpoints are matched."""
        run = self._begin('first')
        name, topic = self._late_ear
        self._watch()
        early = f'READY without {name} hearing {topic.name}' if run.ready else ''
        self._listen(self._nodes[name], name, topic)
        self._watch()
        if run.ready:
            early = early or f'READY without anybody publishing {self._role.hears[0].name}'
        for heard in self._role.hears:
            for speaker in heard.publishers:
                self._speak(speaker, heard)
        self._await_ready(run)
        self._verdicts.judge('waits', early, 'waits for both')
        self._ask_all(run)

    def _run_through(self, kind: str, within_s: float = 0.0) -> None:
        """An ordinary run."""
        run = self._begin(kind)
        self._await_ready(run, within_s)
        self._ask_all(run)

    def _strange(self) -> None:
        """Malformed images, each in a separate run; or invalid estimates."""
        if self._role.word == 'controller':
            run = self._begin('strange')
            self._await_ready(run)
            for seq, (kind, estimate) in enumerate(_UNUSABLE.items()):
                question = Question(seq=seq, truth=self._truth(seq), kind=kind)
                self._ask(run, question, estimate=estimate)
            self._finish()
        elif interface.IMAGE.name in self._heard():
            for kind, change in _STRANGE.items():
                run = self._begin('strange')
                self._await_ready(run)
                question = Question(seq=0, truth=self._truth(0), kind=kind)
                self._ask(run, question, image=_image(change, self._picture(0)))
                self._finish()
        else:
            self._verdicts.skip('bad_input', 'does not use images')
        run = self._begin('after')
        self._await_ready(run)
        self._ask(run, Question(seq=0, truth=self._truth(0)))
        self._finish()

    # One run -----------------------------------------------------------------------------------

    def _begin(self, kind: str) -> Run:
        run_id = f'check-{len(self._runs):05d}-{kind}'
        self._run = run = Run(run_id=run_id, kind=kind)
        self._runs.append(run)
        self._say(interface.SCENARIO, scenario_message(RunRequest(
            run_id=run_id, index=len(self._runs) - 1, program='check-node', seed=0,
            scenario=_SCENE, judging=Judging(specs=('phi_always',)),
            participants=interface.PARTICIPANTS,
        )))
        self._say(interface.RUN_STATUS, _run_status(run, RunStatus.PREPARING))
        return run

    def _await_ready(self, run: Run, within_s: float = 0.0) -> None:
        within_s = max(within_s, _READY_FACTOR * self._patience_s)
        self._until(lambda: run.ready or run.error or self._dead(), within_s)
        if not run.ready:
            self._abandon(run)
        # As the simulator does.
        if not self._until(lambda: not self._unmatched() or self._dead(), within_s):
            names = ', '.join(self._unmatched())
            self._verdicts.judge('qos', f'subscription of {names} was never matched', '')
            self._abandon(run)
        self._say(interface.RUN_STATUS, _run_status(run, RunStatus.RUNNING))

    def _unmatched(self) -> list[str]:
        """Topics on which the node would miss messages sent now."""
        return [
            topic.name for topic in self._role.hears
            if topic.name in self._heard() and not heard_by(
                self._nodes[topic.publishers[0]], self._publishers[topic.name], [self._role.node]
            )
        ]

    def _ask_all(self, run: Run) -> None:
        for seq in range(len(self._states)):
            self._ask(run, Question(seq=seq, truth=self._truth(seq)))
        self._finish()

    def _ask(
        self, run: Run, question: Question, *, estimate: TrackingError | None = None,
        image: Image | None = None,
    ) -> None:
        """Send a message and wait for its answer; a strange image need not be answered."""
        self._put(run, question, estimate=estimate, image=image)
        patience_s = self._patience_s if image is None else _MOMENT_S
        self._until(lambda: question.answers or run.error or self._dead(), patience_s)
        if self._dead() or not (question.answers or image):
            if not question.kind and not self._dead():
                words = f'frame {question.seq}: ERROR: {run.error}' if run.error else \
                    f'frame {question.seq} of run {run.kind}: none in {patience_s:g} s'
                self._verdicts.judge('answers', words, '')
            self._abandon(run)

    def _abandon(self, run: Run) -> None:
        self._given_up = not self._dead()
        if self._given_up:
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
        """Request the process to end, and judge how it does."""
        assert self._process is not None
        self._run = None
        process, printed = self._process, self._log.stat().st_size
        begun_s = time.monotonic()
        process.send(signal.Signals[name])
        self._until(lambda: process.dead, _ENDING_S)
        after_s = time.monotonic() - begun_s
        in_time = process.dead and process.code != -signal.SIGKILL
        process.end()
        with self._log.open('rb') as log:
            log.seek(max(printed, self._log.stat().st_size - _TAIL_BYTES))
            said = log.read(_TAIL_BYTES).decode(errors='replace')
        left = [line for line in said.splitlines() if line.startswith(CHILDREN_LEFT)]
        wrong = [
            *([] if in_time else ['had to be killed']),
            *(['a traceback'] if _TRACEBACK in said else []),
            *([f'leaves {left[-1].removeprefix(CHILDREN_LEFT)}'] if left and in_time else []),
        ]
        self._verdicts.judge(
            'ends', f'{name}: {", ".join(wrong)}' if wrong else '', f'{name}: after {after_s:.1f} s'
        )

    # Judging its runs --------------------------------------------------------------------------

    def _judge_runs(self) -> None:
        if self._process is None:
            self._verdicts.skip('ends', 'the process was not started by the kit')
        died_of_field = self._died if _FIELD_REFUSED.search(self._died) else ''
        if died_of_field:
            self._verdicts.judge('values', died_of_field, '')
        strange = self._died_in in ('strange', 'after')
        lost = f'run {self._died_in}: {self._died}' if self._died and not strange else ''
        self._verdicts.judge('lives', lost, f'{len(self._runs)} runs')
        self._judge_ready()
        self._judge_memory()
        self._judge_bad_input()
        if self._took_s:
            self._verdicts.judge('time', '', answer_time(self._took_s))
        pairs = self._runs[0].pairs()
        if pairs and self._role.word == 'perception':
            self._verdicts.judge('accuracy', '', accuracy(pairs))
        elif len(pairs) >= len(SIDES) and self._role.word == 'controller':
            self._verdicts.judge('steering', '', steering(pairs))

    def _judge_ready(self) -> None:
        unready = next((run for run in self._runs if not run.ready), None)
        if unready is None:
            broken = next((words for one in self._ready if (words := self._bad_ready(one))), '')
            first = self._ready[0]
            mark = first.fingerprint[:12] or 'no fingerprint: its versions cannot be distinguished'
            came = f'{len(self._runs)} runs, {first.implementation!r}, {mark}'
            self._verdicts.judge('ready', broken, came)
        elif not self._died:
            other = f'READY for run_id {unready.other!r}, not {unready.run_id!r}'
            words = f'ERROR: {unready.error}' if unready.error else \
                other if unready.other else 'none came'
            self._verdicts.judge('ready', f'run {unready.kind}: {words}', '')

    def _bad_ready(self, status: NodeStatus) -> str:
        if status.node != self._role.node:
            return f'node is {status.node!r}'
        if not status.implementation:
            return 'implementation is empty'
        if not re.fullmatch('([0-9a-f]{64})?', status.fingerprint):
            return f'fingerprint is {status.fingerprint!r}'
        if {*status.listens} != self._heard():
            hears = ', '.join(sorted(self._heard())) or 'nothing'
            return f'listens is {list(status.listens)}; it hears {hears}'
        alike = same_ready(self._ready[0], status)
        return '' if alike else 'implementation or fingerprint changes between runs'

    def _judge_memory(self) -> None:
        first, second, fresh = (self._answered_run(kind) for kind in ('first', 'second', 'fresh'))
        if first is None or second is None:
            return
        broken = difference(first, second)
        if broken and fresh is not None:
            why = 'differs again: unseeded random numbers, or arithmetic without fixed order' \
                if difference(first, fresh) else 'repeats the first run: it keeps state'
            broken = f'{broken}; a fresh process {why}'
        self._verdicts.judge('forgets', broken, f'{len(second.questions)} bit-identical')

    def _answered_run(self, kind: str) -> Run | None:
        """The run of a kind, if all its questions were answered."""
        return next((
            run for run in self._runs
            if run.kind == kind and run.questions and len(run.pairs()) == len(self._states)
        ), None)

    def _judge_bad_input(self) -> None:
        runs = [run for run in self._runs if run.kind == 'strange']
        shown = []
        for of, one in ((run, one) for run in runs for one in run.questions):
            wrong, came = self._reaction(of, one)
            if wrong:
                self._verdicts.judge('bad_input', f'{one.kind}: {came}', '')
            shown.append(f'{one.kind}: {came}')
        after = next((run for run in self._runs if run.kind == 'after'), None)
        if not shown or after is None:
            return
        broken = '' if after.pairs() else 'no answer to a valid one in the next run'
        if self._died_in == 'after':
            broken = f'{runs[-1].questions[-1].kind}: {self._died}'
        self._verdicts.judge('bad_input', broken, '; '.join(shown))

    def _reaction(self, run: Run, one: Question) -> tuple[bool, str]:
        """How a node answered invalid input: whether it must not, and as text."""
        if one.answers:
            value = one.answers[0].value
            return bool(bad_value(value)), bad_value(value) or _shown(_comparable(value))
        if self._died and run is self._runs[-1]:
            return True, self._died
        words = f'ERROR: {run.error}' if run.error else 'no answer'
        return self._role.word != 'perception', words


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
