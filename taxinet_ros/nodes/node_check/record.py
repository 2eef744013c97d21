"""Record of a checked node: role, endpoints, runs and answers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from taxinet_msgs.msg import NodeStatus

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic

SIDES: Final = ((3.0, 0.0), (-3.0, 0.0), (0.0, 0.2), (0.0, -0.2))
"""First poses used for questions: cross-track error [m] and heading error [rad]."""


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


@dataclass(frozen=True, kw_only=True)
class Answer:
    """An estimate or a command, and its delay after the question [s]."""

    seq: int
    stamp_ns: int
    run_id: str
    value: TrackingError | TaxiCommand
    after_s: float


@dataclass(kw_only=True)
class Question:
    """A message to be answered by the node.

    Attributes:
        seq: control step.
        truth: true tracking error.
        kind: kind of a non-ordinary question, or ''.
        asked_s: time sent, monotonic clock [s].
        missed: whether no answer came in time.
        answers: in order of arrival.
    """

    seq: int
    truth: TrackingError
    kind: str = ''
    asked_s: float = 0.0
    missed: bool = False
    answers: list[Answer] = field(default_factory=list)

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
        ready: its READY messages for the run.
        ready_s: time to the first one [s].
        early: missing peers at that time, or ''.
        questions: questions in order.
        unasked: number of answers before the first question.
        errors: details of its ERROR messages.
        others: run_ids of READY messages for unknown runs.
        given_up: whether a timeout expired.
        unmatched: subscribed topics whose publisher was never matched.
    """

    run_id: str
    kind: str
    ready: list[NodeStatus] = field(default_factory=list)
    ready_s: float = math.nan
    early: str = ''
    questions: list[Question] = field(default_factory=list)
    unasked: int = 0
    errors: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    given_up: bool = False
    unmatched: tuple[str, ...] = ()

    @property
    def ordinary(self) -> list[Question]:
        """Questions of an ordinary run."""
        return [one for one in self.questions if not one.kind]

    def answered(self) -> list[tuple[Question, Answer]]:
        """Ordinary questions with their first answers."""
        return [(one, one.answers[0]) for one in self.ordinary if one.answers]

    def values(self) -> list[Any]:
        """Comparable values of the first answers."""
        return [comparable(answer.value) for _, answer in self.answered()]


@dataclass(frozen=True, kw_only=True)
class Ending:
    """How the node ended on request.

    Attributes:
        after_s: time to end [s]; None if it had to be killed.
        traceback: whether it printed one.
        left: names of processes that outlived it, or ''.
    """

    after_s: float | None
    traceback: bool
    left: str


@dataclass(kw_only=True)
class Record:
    """Complete record of a driven node.

    Attributes:
        role: its role.
        ours: whether the kit started its process.
        nodes: full names of the nodes found.
        ends: their endpoints on topics of the graph.
        died: how it ended unexpectedly, or '', and in which kind of run.
        runs: in order.
        endings: endings by signal name.
        patience_s: timeout for an answer [s].
    """

    role: Role
    ours: bool = True
    patience_s: float = 0.0
    nodes: list[str] = field(default_factory=list)
    ends: list[End] = field(default_factory=list)
    died: str = ''
    died_in: str = ''
    runs: list[Run] = field(default_factory=list)
    endings: dict[str, Ending] = field(default_factory=dict)

    def run(self, kind: str) -> Run | None:
        """The first run of a kind."""
        return next((run for run in self.runs if run.kind == kind), None)

    def asked(self) -> list[tuple[Run, Question]]:
        """All questions of all runs, in order."""
        return [(run, one) for run in self.runs for one in run.ordinary]


def comparable(value: TrackingError | TaxiCommand) -> tuple[Any, ...]:
    """Convert to a value that equals itself even with NaN."""
    if isinstance(value, TrackingError):
        return (repr(value.cte_m), repr(value.he_rad), value.valid) if value.valid else (False,)
    return repr(value.steering_rad), repr(value.speed_mps)


def _word(policy: Any) -> str:
    return str(policy.name).lower().replace('_', ' ')
