"""What is recorded of a node that is checked: its part, its ends, its runs and answers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

from rclpy.qos import DurabilityPolicy, LivelinessPolicy, ReliabilityPolicy
from taxinet_msgs.msg import NodeStatus

from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic

SIDES: Final = ((3.0, 0.0), (-3.0, 0.0), (0.0, 0.2), (0.0, -0.2))
_FOREVER_NS = 2**63 - 1


@dataclass(frozen=True, kw_only=True)
class Role:
    """One of the parts that a node of somebody's can play.

    Attributes:
        word: of the option, ``perception`` or ``controller``.
        node: the node's name.
        hears: topics of which it takes one.
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
        """In what its quality of service is not that of the table; '' where it is."""
        offers = 'offered' if self.publishes else 'asked for'
        if self.qos.reliability != ReliabilityPolicy.RELIABLE:
            return f'{self}: reliability {_word(self.qos.reliability)} {offers}, reliable needed'
        needed = self.topic.qos.durability
        latched = needed == DurabilityPolicy.TRANSIENT_LOCAL
        if self.qos.durability != needed and (latched or not self.publishes):
            return f'{self}: durability {_word(self.qos.durability)} {offers}, {_word(needed)} ' \
                'needed'
        return self._untimely()

    def _untimely(self) -> str:
        """What it asks for, or lets go, in time, beyond the table, which says nothing of time."""
        if self.publishes:
            lifespan_s = _seconds(self.qos.lifespan)
            lost = f'{self}: lifespan {lifespan_s:g} s offered: older messages are lost'
            return lost if lifespan_s < math.inf else ''
        if (deadline_s := _seconds(self.qos.deadline)) < math.inf:
            return f'{self}: deadline {deadline_s:g} s asked for, none offered'
        if self.qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC:
            return f'{self}: liveliness {_word(self.qos.liveliness)} asked for, automatic offered'
        if (lease_s := _seconds(self.qos.liveliness_lease_duration)) < math.inf:
            return f'{self}: liveliness lease {lease_s:g} s asked for, none offered'
        return ''

    def __str__(self) -> str:
        return f'{"publisher" if self.publishes else "subscription"} of {self.topic.name}'


@dataclass(frozen=True, kw_only=True)
class Answer:
    """An estimate or a command, and how long after its message it came [s]."""

    seq: int
    stamp_ns: int
    run_id: str
    value: TrackingError | TaxiCommand
    after_s: float


@dataclass(kw_only=True)
class Question:
    """A message that the node is to answer.

    Attributes:
        seq: control step.
        truth: what the tracking error is.
        kind: what it is beside ordinary, or ''.
        asked_s: when it was sent, by the monotonic clock [s].
        missed: whether no answer came within the patience.
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
    """What the node did in one run.

    Attributes:
        run_id: of its Scenario.
        kind: ``first``, ``uninvited``, ``second``, ``third``, ``fresh``, ``strange`` or ``after``.
        ready: its READYs for the run.
        ready_s: how long the first one took [s].
        early: who was not there yet at that time, or ''.
        questions: what it was asked, in order.
        unasked: number of answers before the first question.
        errors: details of its ERRORs.
        others: run_ids of READYs for no run.
        given_up: whether something was waited for in vain.
        unmatched: topics that the node hears, whose publisher never found it.
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
        """What any run asks."""
        return [one for one in self.questions if not one.kind]

    def answered(self) -> list[tuple[Question, Answer]]:
        """Every ordinary question with its first answer, where it has one."""
        return [(one, one.answers[0]) for one in self.ordinary if one.answers]

    def values(self) -> list[Any]:
        """First answers, by what of them may be compared."""
        return [comparable(answer.value) for _, answer in self.answered()]


@dataclass(frozen=True, kw_only=True)
class Ending:
    """How the node ended when it was asked to.

    Attributes:
        after_s: how long it took [s]; None where it had to be killed.
        traceback: whether it printed one.
        left: processes that outlived it, by name, or ''.
    """

    after_s: float | None
    traceback: bool
    left: str


@dataclass(kw_only=True)
class Record:
    """All that a node did while it was driven.

    Attributes:
        role: the part that it plays.
        ours: whether its process was started by us.
        nodes: full names of the nodes that were found.
        ends: theirs on topics of the graph.
        elsewhere: topics that they publish on, which are not of the graph.
        died: how it ended without being asked, or ''; and in which kind of run.
        runs: in order.
        endings: by the name of the signal.
        memory_mb: before and after the runs of its first process [MB].
        patience_s: how long an answer was waited for [s].
    """

    role: Role
    ours: bool = True
    patience_s: float = 0.0
    nodes: list[str] = field(default_factory=list)
    ends: list[End] = field(default_factory=list)
    elsewhere: list[str] = field(default_factory=list)
    died: str = ''
    died_in: str = ''
    runs: list[Run] = field(default_factory=list)
    endings: dict[str, Ending] = field(default_factory=dict)
    memory_mb: list[float] = field(default_factory=list)

    def run(self, kind: str) -> Run | None:
        """The first run of a kind."""
        return next((run for run in self.runs if run.kind == kind), None)

    def asked(self) -> list[tuple[Run, Question]]:
        """All that is asked in any run, in order."""
        return [(run, one) for run in self.runs for one in run.ordinary]


def comparable(value: TrackingError | TaxiCommand) -> tuple[Any, ...]:
    """As a value that equals itself where it holds NaN."""
    if isinstance(value, TrackingError):
        return (repr(value.cte_m), repr(value.he_rad), value.valid) if value.valid else (False,)
    return repr(value.steering_rad), repr(value.speed_mps)


def _seconds(duration: Any) -> float:
    """Of a duration of a quality of service; what is not given, or the longest, is infinite."""
    return duration.nanoseconds / NS_PER_S if 0 < duration.nanoseconds < _FOREVER_NS else math.inf


def _word(policy: Any) -> str:
    return str(policy.name).lower().replace('_', ' ')
