"""Clauses of the contract of perception and controller nodes, and their evaluation.

The clauses are data; ``docs/own_nodes.md`` lists the same, and a test compares both.
:mod:`taxinet_ros.nodes.node_check.driver` drives a node and records what it does; the record is
evaluated here.
"""

from __future__ import annotations

import enum
import math
import re
import statistics
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.convert import same_ready
from taxinet_ros.nodes.messages.step import subnormal
from taxinet_ros.nodes.node_check.record import (
    SIDES,
    Answer,
    End,
    Question,
    Record,
    Run,
    comparable,
)

BOTH: Final = ('perception', 'controller')
"""The roles of a clause that applies to both."""
_DEGREES = 180.0 / math.pi
_STEERING_LIMIT_RAD, _SPEED_LIMIT_MPS = math.pi / 3, 10.0


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
"""Clauses in order of evaluation; those blocked by the first broken one are not tried."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one clause; ``came`` is the observation in one line."""

    clause: Clause
    status: Status
    came: str
    expected: str

Judged = tuple[Status, str] | None
"""None: cannot be evaluated, since an earlier clause is broken."""


def judge(record: Record) -> list[Finding]:
    """Evaluate a record, clause by clause."""
    role = record.role
    words = {
        'node': role.node, 'answers': role.answers.name,
        'hears': ' or '.join(topic.name for topic in role.hears),
    }
    owed = [clause for clause in CLAUSES if role.word in clause.roles]
    judged = {clause.name: _JUDGES[clause.name](record) for clause in owed}
    if (values := judged['values']) is not None and values[0] is Status.FAIL:
        judged.update(dict.fromkeys(_OF_NUMBERS & judged.keys()))
    broken = ', '.join(name for name, one in judged.items() if one and one[0] is Status.FAIL)
    left = Status.NOT_TRIED, f'fix {broken} first' if broken else 'not reached'
    return [
        Finding(
            clause=clause, status=status, came=came, expected=clause.expected.format(**words),
        )
        for clause in owed
        for status, came in [judged[clause.name] or left]
    ]


def _kept(broken: str, came: str) -> tuple[Status, str]:
    return (Status.FAIL, broken) if broken else (Status.PASS, came)

# How it joins the graph --------------------------------------------------------------------------


def _starts(record: Record) -> Judged:
    if record.died and not record.runs:
        return Status.FAIL, record.died
    return _kept('' if record.nodes else 'no node came', ', '.join(record.nodes))


def _name(record: Record) -> Judged:
    if not record.nodes:
        return None
    shown, name = ', '.join(record.nodes), f'/{record.role.node}'
    others = {f'/{one}' for one in (interface.SIMULATOR, *interface.PARTICIPANTS)} - {name}
    wrong = [] if name in record.nodes else [f'found {shown}']
    if (count := record.nodes.count(name)) > 1:
        wrong.append(f'{count} nodes are called {name}')
    wrong += [
        f'{one} is the name of another node of the graph'
        for one in sorted(others & set(record.nodes))
    ]
    return _kept('; '.join(wrong), shown)


def _of_node(record: Record) -> list[End]:
    return [end for end in record.ends if end.node == record.role.node]


def _topics(record: Record) -> Judged:
    if f'/{record.role.node}' not in record.nodes:
        return None
    ends, role = _of_node(record), record.role
    spoken = Counter(end.topic.name for end in ends if end.publishes)
    heard = {end.topic.name for end in ends if not end.publishes}
    wrong = [
        f'does not publish {topic.name}' for topic in (role.answers, interface.NODE_STATUS)
        if topic.name not in spoken
    ]
    wrong += [] if interface.SCENARIO.name in heard else ['does not hear scenario']
    if not heard & {topic.name for topic in role.hears}:
        wrong.append(f'does not hear {" or ".join(topic.name for topic in role.hears)}')
    extra = spoken.keys() - {role.answers.name, interface.NODE_STATUS.name}
    wrong += [f'publishes {name}' for name in sorted(extra)]
    wrong += [f'publishes {name} {times} times' for name, times in spoken.items() if times > 1]
    wrong += [
        f'{end.node} publishes {end.topic.name}' for end in record.ends
        if end.publishes and end.node != role.node
    ]
    wrong += [
        f'{end} has {end.type_name}, not {end.topic.type_name}'
        for end in ends if end.type_name != end.topic.type_name
    ]
    return _kept('; '.join(wrong), f'hears {", ".join(sorted(heard))}')


def _qos(record: Record) -> Judged:
    ends = _of_node(record)
    misfits = [misfit for end in ends if (misfit := end.misfit())]
    misfits += [
        f'subscription of {name} was never matched' for run in record.runs[-1:]
        for name in run.unmatched
    ]
    return _kept('; '.join(misfits), f'{len(ends)} ends') if ends else None

# READY -------------------------------------------------------------------------------------------


def _ready(record: Record) -> Judged:
    unready = [run for run in record.runs if not run.ready]
    if not record.runs or (unready and record.died):
        return None
    for run in unready:
        if run.errors:
            return Status.FAIL, f'run {run.kind}: ERROR: {run.errors[0]}'
        others = f'READY for run_id {run.others[0]!r}, not {run.run_id!r}' if run.others else ''
        return Status.FAIL, f'run {run.kind}: {others or "none came"}'
    said = [status for run in record.runs for status in run.ready]
    heard = {end.topic.name for end in _of_node(record) if not end.publishes}
    for status in said:
        if status.node != record.role.node:
            return Status.FAIL, f'node is {status.node!r}'
        if not status.implementation:
            return Status.FAIL, 'implementation is empty'
        if not re.fullmatch('([0-9a-f]{64})?', status.fingerprint):
            return Status.FAIL, f'fingerprint is {status.fingerprint!r}'
        if set(status.listens) != heard:
            lacks = ', '.join(sorted(heard)) or 'nothing'
            return Status.FAIL, f'listens is {list(status.listens)}; it hears {lacks}'
        if not same_ready(said[0], status):
            return Status.FAIL, 'implementation or fingerprint changes between runs'
    mark = said[0].fingerprint[:12] or 'no fingerprint: its versions cannot be distinguished'
    return Status.PASS, f'{len(record.runs)} runs, {said[0].implementation!r}, {mark}'


def _waits(record: Record) -> Judged:
    run = record.run('first')
    if run is None or not run.ready:
        return None
    return _kept(f'READY without {run.early}' if run.early else '', 'waits for both')

# Answers -----------------------------------------------------------------------------------------


def _answers(record: Record) -> Judged:
    for run, one in record.asked():
        if len(one.answers) > 1:
            return Status.FAIL, f'{len(one.answers)} to frame {one.seq} of run {run.kind}'
        if one.answers and not one.missed:
            continue
        if run.errors:
            return Status.FAIL, f'frame {one.seq}: ERROR: {run.errors[0]}'
        if run.given_up:
            return Status.FAIL, f'frame {one.seq} of run {run.kind}: none in ' \
                f'{record.patience_s:g} s'
    for run in record.runs:
        if run.unasked:
            return Status.FAIL, f'{run.unasked} before the first frame of run {run.kind}'
    count = len(_all_answers(record))
    return (Status.PASS, f'{count} of {count}') if count else None


def _all_answers(record: Record) -> list[tuple[Run, Question, Answer]]:
    return [(run, one, said) for run, one in record.asked() for said in one.answers]


def _each_answer(wrong: Callable[[Run, Question, Answer], str]) -> Callable[[Record], Judged]:
    """Evaluator that checks each answer separately."""
    def judge_answers(record: Record) -> Judged:
        every = _all_answers(record)
        broken = next((words for one in every if (words := wrong(*one))), '')
        return _kept(broken, 'in each answer') if every else None

    return judge_answers


def _wrong_step(run: Run, asked: Question, said: Answer) -> str:
    if said.run_id != run.run_id:
        return f'run_id {said.run_id!r}, not {run.run_id!r}'
    if said.seq != asked.seq:
        return f'seq {said.seq} to frame {asked.seq}'
    if said.stamp_ns == asked.stamp_ns:
        return ''
    return f'stamp {said.stamp_ns / NS_PER_S:g} s to frame {asked.seq}, of ' \
        f'{asked.stamp_ns / NS_PER_S:g}'


_OF_NUMBERS: Final = {'forgets', 'bad_input', 'accuracy', 'steering'}
"""Clauses that need valid numbers."""
_FIELD_REFUSED: Final = re.compile(r"The '\w+' field must be ")


def _values(record: Record) -> Judged:
    if _FIELD_REFUSED.search(record.died):
        return Status.FAIL, record.died
    return _each_answer(lambda run, asked, said: _bad_value(said.value))(record)


def _bad_value(value: TrackingError | TaxiCommand) -> str:
    if words := subnormal(value):
        return words
    if isinstance(value, TrackingError):
        wrong = value.valid and not value.usable
        return f'{value.cte_m:g} m, {value.he_rad:g} rad, valid=true' if wrong else ''
    fits = math.isfinite(value.steering_rad) and 0 <= value.speed_mps < math.inf
    return '' if fits else f'{value.steering_rad:g} rad at {value.speed_mps:g} m/s'


def _forgets(record: Record) -> Judged:
    first, second, fresh = (_whole(record, kind) for kind in ('first', 'second', 'fresh'))
    if first is None or second is None:
        return None
    different = _difference(first, second)
    if not different:
        return Status.PASS, f'{len(second)} bit-identical'
    if fresh is None:
        return Status.FAIL, different
    why = 'differs again: unseeded random numbers, or arithmetic without fixed order' \
        if _difference(first, fresh) else 'repeats the first run: it keeps state'
    return Status.FAIL, f'{different}; a fresh process {why}'


def _whole(record: Record, kind: str) -> list[Any] | None:
    """Answers of a run that was completed."""
    run = record.run(kind)
    if run is None or not run.ordinary or not all(one.answers for one in run.ordinary):
        return None
    return run.values()


def _difference(first: list[Any], other: list[Any]) -> str:
    pairs = enumerate(zip(first, other, strict=False))
    at = next((seq for seq, (one, two) in pairs if one != two), None)
    if at is None:
        return ''
    pair = first[at], other[at]
    rounded = [_shown(values) for values in pair]
    shown = rounded if len(set(rounded)) == 2 else [_shown(values, digits=17) for values in pair]
    return f'frame {at}: {shown[0]}, then {shown[1]}'


def _bad_input(record: Record) -> Judged:
    runs = [run for run in record.runs if run.kind == 'strange' and run.questions]
    if not runs:
        unused = record.runs and record.role.word == 'perception' and not any(
            end.topic is interface.IMAGE and not end.publishes for end in _of_node(record)
        )
        return (Status.NOT_TRIED, 'does not use images') if unused else None
    told = []
    for run in runs:
        for one in run.questions:
            reaction, sound = _reaction(record, run, one)
            if not sound:
                return Status.FAIL, f'{one.kind}: {reaction}'
            told.append(f'{one.kind}: {reaction}')
    after = record.run('after')
    if record.died_in == 'after':
        return Status.FAIL, f'{runs[-1].questions[-1].kind}: {record.died}'
    if after is None:
        return None
    return _kept('' if after.answered() else 'no answer to a valid one in the next run',
                 '; '.join(told))


def _reaction(record: Record, run: Run, one: Question) -> tuple[str, bool]:
    """How a node answered invalid input, and whether it may."""
    if one.answers:
        value = one.answers[0].value
        return _bad_value(value) or _shown(comparable(value)), not _bad_value(value)
    if record.died and run is record.runs[-1]:
        return record.died, False
    words = f'ERROR: {run.errors[0]}' if run.errors else 'no answer'
    return words, record.role.word == 'perception'

# Its process -------------------------------------------------------------------------------------


def _lives(record: Record) -> Judged:
    if not record.runs:
        return None
    if record.died and record.died_in not in ('strange', 'after'):
        return Status.FAIL, f'run {record.died_in}: {record.died}'
    return Status.PASS, f'{len(record.runs)} runs'


def _ends(record: Record) -> Judged:
    if not record.ours:
        return Status.NOT_TRIED, 'the process was not started by the kit'
    told = []
    for name, ending in record.endings.items():
        wrong = [
            *(['had to be killed'] if ending.after_s is None else []),
            *(['a traceback'] if ending.traceback else []),
            *([f'leaves {ending.left}'] if ending.left else []),
        ]
        if wrong:
            return Status.FAIL, f'{name}: {", ".join(wrong)}'
        told.append(f'{name}: after {ending.after_s or 0.0:.1f} s')
    return (Status.PASS, '; '.join(told)) if told else None

# Plausibility of its answers ---------------------------------------------------------------------


def _time(record: Record) -> Judged:
    took = sorted(said.after_s for _, _, said in _all_answers(record))
    if not took:
        return None
    median, worst = statistics.median(took), took[-1]
    factor = CONTROL_PERIOD_NS / NS_PER_S / max(median, 1e-9)
    slow = '' if factor >= 1 else '; slower than real time'
    return Status.NOTE, (
        f'median {median * 1e3:.1f} ms, max {worst * 1e3:.1f} ms of {len(took)}: at most '
        f'{factor:.3g} x real time{slow}'
    )


def _accuracy(record: Record) -> Judged:
    run = record.run('first')
    pairs = [(one.truth, said.value) for one, said in run.answered()] if run else []
    usable = [(true, said) for true, said in pairs if isinstance(said, TrackingError)
              and said.usable]
    if not pairs:
        return None
    if len(usable) < len(SIDES):
        return Status.NOTE, f'{len(usable)} usable estimates of {len(pairs)}'
    cte, he = (
        np.array([[getattr(true, name), getattr(said, name)] for true, said in usable])
        for name in ('cte_m', 'he_rad')
    )
    words = [
        f'CTE {_short(np.abs(cte[:, 1] - cte[:, 0]).mean())} m{_suspect("CTE", cte)}',
        f'HE {_short(np.degrees(np.abs(he[:, 1] - he[:, 0]).mean()))} deg{_suspect("HE", he)}',
    ]
    return Status.NOTE, f'mean absolute error of {len(usable)} frames: {", ".join(words)}'


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


def _steering(record: Record) -> Judged:
    run = record.run('first')
    sides = [
        (one.truth, said.value) for one, said in (run.answered() if run else [])[:len(SIDES)]
        if isinstance(said.value, TaxiCommand)
    ]
    if len(sides) < len(SIDES):
        return None
    away = [
        f'{true.cte_m:g} m, {math.degrees(true.he_rad):.0f} deg' for true, command in sides
        if command.steering_rad * (true.cte_m + true.he_rad) > 0
    ]
    still = all(command.steering_rad == 0 for _, command in sides)
    side = f'steers AWAY from the centreline at {"; ".join(away)}' if away else \
        'it does not steer' if still else 'towards the line'
    words = f'3 m left of the line: {math.degrees(sides[0][1].steering_rad):.1f} deg; {side}'
    commands = [one.value for _, _, one in _all_answers(record)]
    angle = max(abs(one.steering_rad) for one in commands if isinstance(one, TaxiCommand))
    speed = max(one.speed_mps for one in commands if isinstance(one, TaxiCommand))
    words += f'; at most {math.degrees(angle):.1f} deg, {speed:g} m/s'
    words += ': beyond any nose wheel; is it in radians?' if angle > _STEERING_LIMIT_RAD else ''
    return Status.NOTE, words + (
        ': faster than taxiing; is it in m/s?' if speed > _SPEED_LIMIT_MPS else ''
    )


def _shown(values: tuple[Any, ...], digits: int = 6) -> str:
    numbers = [
        f'{float(one):.{digits}g}' if isinstance(one, str) else f'valid={one}' for one in values
    ]
    return f'({", ".join(numbers)})'

_JUDGES: Final[dict[str, Callable[[Record], Judged]]] = {
    'starts': _starts, 'name': _name, 'topics': _topics, 'qos': _qos, 'ready': _ready,
    'waits': _waits, 'answers': _answers, 'step': _each_answer(_wrong_step), 'values': _values,
    'forgets': _forgets, 'bad_input': _bad_input, 'lives': _lives, 'ends': _ends, 'time': _time,
    'accuracy': _accuracy, 'steering': _steering,
}
