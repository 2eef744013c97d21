"""What a node or function of a user has to do: each clause is a function.

A clause looks at what was seen of it in several runs, and says what that was, or '' if there was
nothing to judge by; or it raises :class:`Broken`. Its docstring is the demand, and behind ``Fix:``
how to meet it. ``docs/own_nodes.md`` lists the same, and a test compares both.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import math
import re
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from taxinet_ros.core import topics as graph
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.topics import Topic
from taxinet_ros.core.types import (
    NS_PER_S,
    UNKNOWN_COVARIANCE,
    AircraftState,
    TaxiCommand,
    TrackingError,
)

SIDES: Final = ((3.0, 0.0), (-3.0, 0.0), (0.0, 0.2), (0.0, -0.2))
"""First poses of a run: cross-track error [m] and heading error [rad], in pairs of opposites."""
MOST_CTE_M, MOST_HE_RAD = 100.0, math.pi
"""Estimates beyond are in a wrong unit."""
MOST_STEERING_RAD, MOST_SPEED_MPS = math.pi / 2, 60.0
"""Commands beyond are in a wrong unit; no aircraft taxis so."""
_DEGREES = 180.0 / math.pi
_FIELD_REFUSED: Final = re.compile(r"The '\w+' field must be ")


class Broken(Exception):  # noqa: N818 (a result, not an error)
    """A clause is broken; the message is what came instead."""


@dataclass(frozen=True, kw_only=True)
class Role:
    """A role of a user's node: it hears one of some topics, and answers on another."""

    word: str
    node: str
    hears: tuple[Topic, ...]
    answers: Topic


ROLES: Final = {role.word: role for role in (
    Role(word='perception', node=graph.PERCEPTION, hears=(graph.IMAGE, graph.TRUTH),
         answers=graph.ESTIMATE),
    Role(word='controller', node=graph.STEERING_CONTROLLER, hears=(graph.ESTIMATE,),
         answers=graph.COMMAND),
)}


class End(NamedTuple):
    """A publisher or a subscription on a topic of the graph, as rclpy describes it."""

    topic: Topic
    publishes: bool
    info: Any


class Answer(NamedTuple):
    """An answer; ``doubt`` says what is wrong with its numbers as they were sent."""

    value: TrackingError | TaxiCommand
    run_id: str = ''
    seq: int = 0
    stamp_ns: int = 0
    took_s: float = 0.0
    doubt: str = ''


@dataclass(kw_only=True)
class Question:
    """A message to be answered; ``kind`` says what is wrong with it, or ''."""

    seq: int
    truth: TrackingError
    kind: str = ''
    asked_s: float = 0.0
    answers: list[Answer] = field(default_factory=list)

    @property
    def stamp_ns(self) -> int:
        """Simulated time of the step [ns]."""
        return self.seq * CONTROL_PERIOD_NS


@dataclass(kw_only=True)
class Run:
    """Behaviour in one run."""

    kind: str  # first, second, strange, after; fresh or later in another process
    run_id: str = ''
    ready: list[Any] = field(default_factory=list)  # its messages READY
    other: str = ''  # run_id of a READY for no run
    error: str = ''  # detail of its first ERROR
    unasked: bool = False  # whether an answer came before the first question
    questions: list[Question] = field(default_factory=list)

    def pairs(self) -> list[tuple[TrackingError, Any]]:
        """The truth of each answered question, and the value of its first answer."""
        return [(one.truth, one.answers[0].value) for one in self.questions if one.answers]


@dataclass(kw_only=True)
class Seen:
    """What was seen of a node or function."""

    role: Role
    frames: int  # of a whole run
    names: list[str] = field(default_factory=list)  # of its nodes, absolute
    ends: list[End] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)
    early: str | None = None  # READY before all ends were matched; None if that was not tried
    unmatched: str = ''  # subscriptions that were never matched
    silence: str = ''  # the answer that did not come in time
    died: str = ''  # how its process died unasked
    died_in: str = ''  # in which kind of run
    endings: list[tuple[str, str, float]] = field(default_factory=list)  # signal, what is wrong, s

    def own(self, *, publishes: bool) -> list[End]:
        """Its publishers, or its subscriptions."""
        return [
            end for end in self.ends
            if end.publishes is publishes and end.info.node_name == self.role.node
        ]

    @property
    def heard(self) -> set[str]:
        """Topics that it subscribes to."""
        return {end.topic.name for end in self.own(publishes=False)}

    def answered(self) -> Iterator[tuple[Run, Question, Answer]]:
        """All answers to proper questions."""
        for run in self.runs:
            for question in run.questions:
                if not question.kind:
                    yield from ((run, question, answer) for answer in question.answers)

    def whole(self, kind: str) -> Run | None:
        """The run of a kind, if all its questions were answered."""
        return next((
            run for run in self.runs if run.kind == kind and len(run.pairs()) == self.frames
        ), None)

    @property
    def bad_numbers(self) -> str:
        """What is wrong with the numbers of its answers; '' if nothing."""
        if _FIELD_REFUSED.search(self.died):
            return self.died
        return next((words for _, _, one in self.answered() if (words := bad_answer(one))), '')


def _unless(*broken: str) -> None:
    """Raise the violations that there are."""
    if found := [words for words in broken if words]:
        raise Broken('; '.join(found))


SCENE: Final = Scenario(distance_m=1000.0, time_of_day_s=10 * 3600.0, duration_s=60.0)
"""Where it is asked."""
UNUSABLE: Final = {
    'valid=false': TrackingError(cte_m=0.0, he_rad=0.0, valid=False),
    'NaN': TrackingError(cte_m=math.nan, he_rad=math.nan),
    'infinite': TrackingError(cte_m=math.inf, he_rad=0.0),
}
"""Estimates at which a controller has to brake."""


def poses(count: int) -> list[AircraftState]:
    """Aircraft poses step by step: first :data:`SIDES`, then across the runway."""
    begin = Aircraft(SCENE).state
    places = list(SIDES)[:count]
    for number in range(count - len(places)):
        turn = 2 * math.pi * number / max(count - len(SIDES), 1)
        places.append((5 * math.sin(turn), 0.15 * math.sin(2 * turn + 0.5)))
    return [
        dataclasses.replace(begin, x_m=begin.x_m + 0.5 * seq, y_m=cte_m, yaw_rad=he_rad)
        for seq, (cte_m, he_rad) in enumerate(places)
    ]


# The clauses ------------------------------------------------------------------------------------


def starts(seen: Seen) -> str:
    """The command starts, and a node of it joins the graph within 30 s.

    Fix: run it by hand: its own output says why
    """
    if not seen.names or (seen.died and not seen.runs):
        raise Broken(seen.died or 'no node came')
    return ', '.join(seen.names)


def name(seen: Seen) -> str:
    """Its node is called {node}, in no namespace.

    Fix: hand the command line on: rclpy.init(), or rclcpp::init(argc, argv); a second node of yours
    with use_global_arguments=False
    """
    if not seen.names:
        return ''
    wanted, shown = f'/{seen.role.node}', ', '.join(seen.names)
    count = seen.names.count(wanted)
    _unless(f'{count} nodes are called {wanted}; found {shown}' if count != 1 else '')
    return shown


def topics(seen: Seen) -> str:
    """Publishes {answers} and node_status alone, hears scenario and {hears}; types as in the table.

    Fix: relative names and messages, as in the table of the docs
    """
    role = seen.role
    if f'/{role.node}' not in seen.names:
        return ''
    spoken = Counter(end.topic.name for end in seen.own(publishes=True))
    inputs = [topic.name for topic in role.hears]
    needed = role.answers.name, graph.NODE_STATUS.name
    _unless(
        *(f'does not publish {one}' for one in needed if one not in spoken),
        '' if graph.SCENARIO.name in seen.heard else 'does not hear scenario',
        '' if seen.heard & {*inputs} else f'does not hear {" or ".join(inputs)}',
        *(f'publishes {one} {times} times' for one, times in spoken.items() if times > 1),
        *(f'{end.info.node_name} publishes {end.topic.name}' for end in seen.ends
          if end.publishes and (end.info.node_name != role.node or end.topic.name not in needed)),
        *(f'{end.topic.name} has {end.info.topic_type}, not {end.topic.type_name}'
          for end in seen.ends if end.info.topic_type != end.topic.type_name),
    )
    return f'hears {", ".join(sorted(seen.heard))}'


def qos(seen: Seen) -> str:
    """All reliable; scenario and node_status transient local, its other subscriptions volatile.

    Fix: QoSProfile(depth=16), for those two with durability=TRANSIENT_LOCAL
    """
    own = [*seen.own(publishes=True), *seen.own(publishes=False)]
    if not own:
        return ''
    _unless(*map(_misfit, own), seen.unmatched)
    return f'{len(own)} ends'


def _misfit(end: End) -> str:
    """Mismatch of the quality of service of an end with the table; '' if none."""
    wanted = end.topic.quality
    reliability, durability = (
        policy.name.lower()
        for policy in (end.info.qos_profile.reliability, end.info.qos_profile.durability)
    )
    if reliability == wanted.reliability and (
        durability == wanted.durability or (end.publishes and not wanted.latched)
    ):
        return ''
    verb = 'offered' if end.publishes else 'asked for'
    return f'{end.topic.name}: {reliability}, {durability} {verb}; ' \
        f'{wanted.reliability}, {wanted.durability} needed'


def ready(seen: Seen) -> str:
    """A NodeStatus READY for each run: its run_id, node, implementation, fingerprint, listens.

    Fix: publish it on node_status at every Scenario, when the ends are matched; the fingerprint is
    a SHA-256 or empty, listens are the topics that it hears
    """
    for run in seen.runs:
        if not run.ready and seen.died:
            return ''
        other = f'READY for run_id {run.other!r}, not {run.run_id!r}' if run.other else ''
        error = f'ERROR: {run.error}' if run.error else ''
        _unless('' if run.ready else f'run {run.kind}: {error or other or "none came"}')
    every = [one for run in seen.runs for one in run.ready]
    for one in every:
        _unless(
            '' if one.node == seen.role.node else f'node is {one.node!r}',
            '' if one.implementation else 'implementation is empty',
            '' if re.fullmatch('([0-9a-f]{64})?', one.fingerprint)
            else f'fingerprint is {one.fingerprint!r}',
            '' if {*one.listens} == seen.heard
            else f'listens is {list(one.listens)}; it hears {sorted(seen.heard)}',
        )
    marks = {(one.implementation, one.fingerprint) for one in every}
    _unless('implementation or fingerprint changes between runs' if len(marks) > 1 else '')
    return ', '.join(
        f'{name!r}, {sha256[:12] or "no fingerprint: its versions cannot be distinguished"}'
        for name, sha256 in marks
    )


def waits(seen: Seen) -> str:
    """No READY before each end of the run is matched, in both directions.

    Fix: count the subscriptions of your publisher, and the publishers of your input
    """
    if seen.early is None:
        return ''
    _unless(seen.early)
    return 'waits for both'


def answers(seen: Seen) -> str:
    """One answer to each message, within the patience, and none unasked.

    Fix: publish once from the callback of the input, without conditions
    """
    for run in seen.runs:
        _unless(f'one before the first frame of run {run.kind}' if run.unasked else '', *(
            f'{len(one.answers)} to frame {one.seq} of run {run.kind}'
            for one in run.questions if len(one.answers) > 1 and not one.kind
        ))
    _unless(seen.silence)
    took_ms = [1e3 * answer.took_s for _, _, answer in seen.answered()]
    if not took_ms:
        return ''
    median = statistics.median(took_ms)
    slow = '; slower than real time' if median > CONTROL_PERIOD_NS / 1e6 else ''
    return f'{len(took_ms)}, median {median:.1f} ms, max {max(took_ms):.1f} ms{slow}'


def step(seen: Seen) -> str:
    """The answer has the run_id of the run, and seq and header.stamp of the message answered.

    Fix: copy the stamp; seq is the stamp in ns divided by 100,000,000; a controller copies it
    """
    if not any(seen.answered()):
        return ''
    for run, one, answer in seen.answered():
        stamp = f'stamp {answer.stamp_ns / NS_PER_S:g} s to frame {one.seq}, of ' \
            f'{one.stamp_ns / NS_PER_S:g}'
        _unless(
            '' if answer.run_id == run.run_id else f'run_id {answer.run_id!r}, not {run.run_id!r}',
            '' if answer.seq == one.seq else f'seq {answer.seq} to frame {one.seq}',
            '' if answer.stamp_ns == one.stamp_ns else stamp,
        )
    return 'in each answer'


def values(seen: Seen) -> str:
    """Fields have their types, finite numbers, a speed from 0, a proper covariance; or valid=false.

    Fix: float(x) around each number, bool(x) around valid; say valid=false where you cannot tell; a
    controller brakes
    """
    _unless(seen.bad_numbers)
    if not any(seen.answered()):
        return ''
    return 'in each answer'


def bad_answer(answer: Answer) -> str:
    """What is wrong with the numbers of an answer; '' if nothing."""
    value = answer.value
    if answer.doubt:
        return answer.doubt
    if isinstance(value, TrackingError):
        wrong = value.valid and not value.usable
        said = f'{value.cte_m:g} m, {value.he_rad:g} rad, valid=true' if wrong else ''
        return said or value.covariance_flaw
    fits = math.isfinite(value.steering_rad) and 0 <= value.speed_mps < math.inf
    return '' if fits else f'{value.steering_rad:g} rad at {value.speed_mps:g} m/s'


def forgets(seen: Seen) -> str:
    """The same messages in a second run, and in a fresh process, have the same answers.

    Fix: begin each run as the first: reset filters and counters, seed random numbers, have a GPU
    compute in a fixed order
    """
    first, second, fresh, later = map(seen.whole, ('first', 'second', 'fresh', 'later'))
    if first is None or second is None or seen.bad_numbers:
        return ''
    again = difference(first, second)
    elsewhere = difference(first, fresh or later or first)
    if again and fresh:
        why = 'differs again: unseeded random numbers, or arithmetic without fixed order' \
            if elsewhere else 'repeats the first run: it keeps state of earlier runs'
        raise Broken(f'{again}; a fresh process {why}')
    _unless(again, f'in another process {elsewhere}' if elsewhere else '')
    return f'{len(second.questions)} bit-identical'


def difference(first: Run, other: Run) -> str:
    """The first answer in which two runs differ, or ''."""
    said = ([_shown(value) for _, value in run.pairs()] for run in (first, other))
    for seq, (one, two) in enumerate(zip(*said, strict=False)):
        if one != two:
            return f'frame {seq}: {one}, then {two}'
    return ''


def _shown(value: TrackingError | TaxiCommand) -> str:
    """All digits of an answer: what is equal in them is equal, also NaN."""
    if isinstance(value, TaxiCommand):
        return f'({value.steering_rad!r}, {value.speed_mps!r})'
    claimed = '' if value.covariance == UNKNOWN_COVARIANCE else f', {list(value.covariance)!r}'
    return f'({value.cte_m!r}, {value.he_rad!r}{claimed})' if value.valid else '(valid=False)'


def bad_input(seen: Seen) -> str:
    """An empty, cut or grey image ends no node; an estimate without value has a finite command.

    Fix: look at encoding, size and len(data) before you reshape, and say valid=false, nothing, or
    ERROR with a detail; a controller brakes: angle 0, speed 0
    """
    if seen.bad_numbers:
        return ''
    shown = []
    for run in seen.runs:
        for one in run.questions if run.kind == 'strange' else ():
            wrong, came = _reaction(seen, run, one)
            shown.append(f'{one.kind}: {came}')
            _unless(shown[-1] if wrong else '')
    after = next((run for run in seen.runs if run.kind == 'after'), None)
    if after is None:
        return ''
    if not shown:
        return 'does not use images'
    if seen.died_in == 'after':
        raise Broken(f'{shown[-1].partition(":")[0]}: {seen.died}')
    _unless('' if after.pairs() else 'no answer to a valid one in the next run')
    return '; '.join(shown)


def _reaction(seen: Seen, run: Run, one: Question) -> tuple[bool, str]:
    """How a node answered invalid input: whether it must not, and as text."""
    if one.answers:
        wrong = bad_answer(one.answers[0])
        return bool(wrong), wrong or _shown(one.answers[0].value)
    if seen.died and run is seen.runs[-1]:
        return True, seen.died
    words = f'ERROR: {run.error}' if run.error else 'no answer'
    return seen.role.word != 'perception', words


def lives(seen: Seen) -> str:
    """The node lives on from run to run.

    Fix: see its output
    """
    if seen.died_in not in ('', 'strange', 'after'):  # which are bad_input
        raise Broken(f'run {seen.died_in}: {seen.died}')
    if not seen.runs:
        return ''
    return f'{len(seen.runs)} runs'


def ends(seen: Seen) -> str:
    """Ends within 5 s of SIGINT and of SIGTERM, without a traceback, and leaves no process.

    Fix: except (KeyboardInterrupt, ExternalShutdownException): pass, around spin; end the processes
    that it started, and wait for them
    """
    if not seen.endings:
        return ''
    _unless(*(f'{name}: {wrong}' for name, wrong, _ in seen.endings if wrong))
    return ', '.join(f'{name}: after {after_s:.1f} s' for name, _, after_s in seen.endings)


def accuracy(seen: Seen) -> str:
    """Estimates are in metres and radians, left positive.

    Fix: divide, or swap the sign; how far they are from the truth is for you to judge
    """
    pairs = [pair for run in seen.runs[:1] for pair in run.pairs() if pair[1].usable]
    if not any(seen.answered()) or seen.bad_numbers:
        return ''
    cte, he = (
        np.array([[getattr(true, name), getattr(said, name)] for true, said in pairs])
        for name in ('cte_m', 'he_rad')
    )
    if len(pairs) >= len(SIDES):
        _unless(_suspect('CTE', cte), _suspect('HE', he))
    for _, said in pairs:
        if abs(said.cte_m) > MOST_CTE_M or abs(said.he_rad) > MOST_HE_RAD:
            raise Broken(f'{said.cte_m:g} m, {said.he_rad:g} rad: in metres and radians?')
    if not pairs:
        return 'no usable estimate'
    same = ''.join(f', {name} is always the same' for name, both in (('CTE', cte), ('HE', he))
                   if both[:, 1].std() == 0)
    errors = np.abs([cte[:, 1] - cte[:, 0], np.degrees(he[:, 1] - he[:, 0])]).mean(axis=1)
    return f'mean absolute error of {len(pairs)} frames: CTE {errors[0]:.2f} m, HE ' \
        f'{errors[1]:.2f} deg{same}'


def _suspect(name: str, pairs: np.ndarray[Any, Any]) -> str:
    """Detect common mistakes from estimates against the truth."""
    true, said = pairs[:, 0], pairs[:, 1]
    if said.std() == 0 or true.std() == 0:
        return ''
    together = float(np.corrcoef(true, said)[0, 1])
    factor = float((true * said).sum() / (true * true).sum())
    if together < -0.8:
        return f'{name} seems to have the wrong sign: left is positive'
    if name == 'HE' and together > 0.8 and _DEGREES / 2 < factor < _DEGREES * 2:
        return 'HE looks like degrees, not radians'
    return ''


def steering(seen: Seen) -> str:
    """Steers towards the centreline from both sides, in radians and m/s, left positive.

    Fix: swap the sign, or divide
    """
    pairs = seen.runs[0].pairs() if seen.runs else []
    if len(pairs) < len(SIDES) or seen.bad_numbers:
        return ''
    angle = max(abs(command.steering_rad) for _, command in pairs)
    speed = max(command.speed_mps for _, command in pairs)
    away = [command.steering_rad * (true.cte_m + true.he_rad) > 0 for true, command in pairs]
    first_rad, third_rad = (pairs[one][1].steering_rad for one in (0, 2))
    _unless(
        # Of one pose alone that is no error: a filter may still know the one before.
        f'steers AWAY, by {first_rad:+.3g} rad where it is left of the centreline'
        if all(away[:2]) else '',
        f'steers AWAY, by {third_rad:+.3g} rad where its nose points to the left'
        if all(away[2:4]) else '',
        f'{angle:.3g} rad: beyond any nose wheel; in radians?'
        if angle > MOST_STEERING_RAD else '',
        f'{speed:g} m/s: in m/s?' if speed > MOST_SPEED_MPS else '',
    )
    return f'3 m left of the line: {math.degrees(first_rad):.1f} deg; at most ' \
        f'{math.degrees(angle):.1f} deg, {speed:g} m/s'


Clause = Callable[[Seen], str]
ENDPOINTS: Final[tuple[Clause, ...]] = (starts, name, topics, qos)
"""Clauses without which no run can begin."""
_ANY: Final[tuple[Clause, ...]] = (
    *ENDPOINTS, ready, waits, answers, step, values, forgets, bad_input, lives, ends,
)
CLAUSES: Final = {'perception': (*_ANY, accuracy), 'controller': (*_ANY, steering)}
"""Clauses of a node in order, by role."""
OF_FUNCTIONS: Final = (answers, values, forgets, bad_input, lives, accuracy, steering)
"""Those that a function can break, which a node of this package calls."""


# The result -------------------------------------------------------------------------------------


class Status(enum.StrEnum):
    """Result of a clause."""

    PASS = 'PASS'
    FAIL = 'FAIL'
    NOT_TRIED = 'not tried'


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one clause: what it demands, what came, and how to meet it."""

    clause: str
    status: Status
    expected: str
    came: str
    fix: str

    @property
    def broken(self) -> bool:
        """Whether the clause is broken."""
        return self.status is Status.FAIL

    @property
    def words(self) -> str:
        """All of it, in a line."""
        if self.broken:
            return f'expected: {self.expected}; got: {self.came}; fix: {self.fix}'
        return f'{self.expected}: {self.came}'


def demand(clause: Clause, role: Role) -> tuple[str, str]:
    """What a clause demands of a role, and how to meet it."""
    expected, _, fix = ' '.join((inspect.getdoc(clause) or '').split()).partition('. Fix: ')
    hears = ' or '.join(topic.name for topic in role.hears)
    return expected.format(node=role.node, answers=role.answers.name, hears=hears), fix


def judge(seen: Seen, clauses: Sequence[Clause]) -> list[Finding]:
    """Result of each clause, in order."""
    came: dict[Clause, tuple[Status, str]] = {}
    for clause in clauses:
        try:
            came[clause] = Status.PASS, clause(seen)
        except Broken as error:
            came[clause] = Status.FAIL, str(error)
    broken = [clause.__name__ for clause, (status, _) in came.items() if status is Status.FAIL]
    first = Status.NOT_TRIED, f'fix {", ".join(broken)} first'
    found = []
    for clause, (status, words) in came.items():
        if not words:  # silence is no proof
            status, words = first if broken else (Status.FAIL, 'could not be tried')
        expected, fix = demand(clause, seen.role)
        found.append(Finding(
            clause=clause.__name__, status=status, expected=expected, came=words, fix=fix,
        ))
    return found
