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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.command_wrapper import SIGINT_GRACE_S, SIGTERM_GRACE_S
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
_GRACES_S: Final = {'SIGINT': SIGINT_GRACE_S + SIGTERM_GRACE_S, 'SIGTERM': SIGTERM_GRACE_S}
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

_END_MEND = (
    'except (KeyboardInterrupt, ExternalShutdownException): pass, around spin; end the processes '
    'that it started, and wait for them'
)
CLAUSES: Final = (
    Clause('starts', 'the command starts, and a node of it joins the graph within 30 s',
           'run it by hand: its own output says why'),
    Clause('name', 'its node is called {node}, in no namespace',
           'hand the command line on: rclpy.init(), or rclcpp::init(argc, argv); '
           'a second node of yours with use_global_arguments=False'),
    Clause('topics', 'publishes {answers} and node_status, hears scenario and {hears}; publishes '
           'nothing else of the graph', 'relative names, as in the table of the docs'),
    Clause('types', 'each topic has the type of the table', 'use the message of the table'),
    Clause('qos', 'scenario and node_status reliable, transient local; the rest reliable, its '
           'subscriptions volatile',
           'QoSProfile(depth=16), for those two with durability=TRANSIENT_LOCAL'),
    Clause('ready', 'a NodeStatus READY with the run_id of the Scenario',
           'publish it on node_status when the ends are matched'),
    Clause('ready_says', 'READY names node, implementation, fingerprint (SHA-256 or empty), and '
           'listens (its topics)', 'fill in these fields'),
    Clause('waits', 'no READY before each end of the run is matched, in both directions',
           'count the subscriptions of your publisher, and the publishers of your input'),
    Clause('uninvited', 'no READY for a run whose participants do not name the node',
           "leave a Scenario alone whose participants lack your node's name"),
    Clause('ready_again', 'READY for each further run', 'get ready anew at every Scenario'),
    Clause('answers', 'an answer to each message, within the patience',
           'publish from the callback of the input, without conditions'),
    Clause('once', 'one answer to each message, and none unasked', 'publish once in each callback'),
    Clause('run_id', 'the answer has the run_id of the run', 'the one you said READY for'),
    Clause('seq', "the answer's seq is the number of the control step",
           'the stamp in ns divided by 100,000,000; a controller copies seq'),
    Clause('stamp', "the answer's header.stamp is that of the message answered",
           'copy the stamp of the header'),
    Clause('fields', 'each field has the type of the message: no int, bool, str or array where a '
           'float is due', 'in Python, float(x) around each number, bool(x) around valid'),
    Clause('finite', 'finite numbers, a speed not below 0; or valid=false',
           'say valid=false where you cannot tell; a controller brakes; float(x) around a negative '
           'int, which is NaN otherwise'),
    Clause('forgets', 'the same messages in a second run have the same answers',
           'begin each run as the first: reset filters and counters, seed random numbers, have a '
           'GPU compute in a fixed order'),
    Clause('strange_image', 'an image that is empty, cut off or of another encoding does not end '
           'the node: valid=false, no answer, or ERROR with a detail',
           'look at encoding, size and len(data) before you reshape', ('perception',)),
    Clause('unusable', 'an estimate that is not valid, NaN or infinite has a finite command too',
           'brake: angle 0, speed 0', ('controller',)),
    Clause('other_run', 'an estimate of another run gets no answer in the name of this one',
           "leave it alone, or answer with the estimate's own run_id", ('controller',)),
    Clause('lives', 'the node lives on from run to run', 'see its output'),
    Clause('sigint', 'ends within 5 s of SIGINT, without a traceback, and leaves no process',
           _END_MEND),
    Clause('sigterm', 'ends within 5 s of SIGTERM, without a traceback, and leaves no process',
           _END_MEND),
    Clause('reproducible', 'a fresh process gives the same answers', informative=True),
    Clause('time', 'how long an answer takes', informative=True),
    Clause('memory', 'memory and what it grew by', informative=True),
    Clause('disorder', 'a message that comes twice, and one that is late', informative=True),
    Clause('accuracy', 'estimates against the truth', roles=('perception',), informative=True),
    Clause('sign', 'to which side it steers, left positive', roles=('controller',),
           informative=True),
    Clause('limits', 'largest angle and speed', roles=('controller',), informative=True),
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
    fields = judged['fields']
    if fields is not None and fields[0] is Status.FAIL:  # Nothing follows from other numbers.
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
    taken = sorted(others & set(record.nodes))
    wrong = [] if name in record.nodes else [f'found {shown}']
    if (count := record.nodes.count(name)) > 1:
        wrong.append(f'{count} nodes are called {name}')
    wrong += [f'{one} is the name of another node of the graph' for one in taken]
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
        f'{end.node} publishes {end.topic.name}, an intruder' for end in record.ends
        if end.publishes and end.node != role.node
    ]
    if wrong and record.elsewhere:
        wrong.append(f'there is {", ".join(record.elsewhere)}')
    return _kept('; '.join(wrong), f'hears {", ".join(sorted(heard))}')


def _types(record: Record) -> Judged:
    ends = _of_node(record)
    wrong = [
        f'{end} has {end.type_name}, not {end.topic.type_name}'
        for end in ends if end.type_name != end.topic.type_name
    ]
    return _kept('; '.join(wrong), f'{len(ends)} ends') if ends else None


def _qos(record: Record) -> Judged:
    ends = _of_node(record)
    misfits = [misfit for end in ends if (misfit := end.misfit())]
    misfits += [
        f'subscription of {name} was never matched' for run in record.runs[-1:]
        for name in run.unmatched
    ]
    return _kept('; '.join(misfits), f'{len(ends)} ends') if ends else None

# READY -------------------------------------------------------------------------------------------


def _no_ready(run: Run) -> str:
    if run.errors:
        return f'ERROR: {run.errors[0]}'
    if run.others:
        return f'READY for run_id {run.others[0]!r}, not {run.run_id!r}'
    return '' if run.ready else 'none came'


def _ready(record: Record) -> Judged:
    run = record.run('first')
    if run is None or (record.died_in == 'first' and not run.ready):
        return None
    return _kept('' if run.ready else _no_ready(run), f'after {run.ready_s:.3f} s')


def _ready_says(record: Record) -> Judged:
    said = [status for run in record.runs for status in run.ready]
    if not said:
        return None
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
    one = said[0]
    mark = one.fingerprint[:12] or 'no fingerprint: its versions cannot be distinguished'
    return Status.PASS, f'{one.implementation!r}, {mark}'


def _waits(record: Record) -> Judged:
    run = record.run('first')
    if run is None or not run.ready:
        return None
    return _kept(f'READY without {run.early}' if run.early else '', 'waits for both')


def _uninvited(record: Record) -> Judged:
    run = record.run('uninvited')
    return _kept('READY' if run.ready else '', 'no READY') if run is not None else None


def _ready_again(record: Record) -> Judged:
    runs = [run for run in record.runs if run.kind not in ('first', 'uninvited')]
    late = [run for run in runs if not run.ready]
    if not runs or (late and record.died):
        return None
    broken = f'run {late[0].kind}: {_no_ready(late[0])}' if late else ''
    return _kept(broken, f'{len(runs)} more runs')

# Answers -----------------------------------------------------------------------------------------


def _answers(record: Record) -> Judged:
    for run, one in record.asked():
        if one.answers and not one.missed:
            continue
        if run.errors:
            return Status.FAIL, f'frame {one.seq}: ERROR: {run.errors[0]}'
        if run.given_up:
            return Status.FAIL, f'frame {one.seq} of run {run.kind}: none in ' \
                f'{record.patience_s:g} s'
    every = [one for _, one in record.asked() if one.answers]
    return (Status.PASS, f'{len(every)} of {len(every)}') if every else None


def _once(record: Record) -> Judged:
    for run in record.runs:
        if run.unasked:
            return Status.FAIL, f'{run.unasked} before the first frame of run {run.kind}'
        for one in run.ordinary:
            if len(one.answers) > 1:
                return Status.FAIL, f'{len(one.answers)} to frame {one.seq} of run {run.kind}'
    return (Status.PASS, 'one each') if _all_answers(record) else None


def _all_answers(record: Record) -> list[tuple[Run, Question, Answer]]:
    return [(run, one, said) for run, one in record.asked() for said in one.answers]


def _each_answer(
    wrong: Callable[[Run, Question, Answer], str], came: str
) -> Callable[[Record], Judged]:
    """Evaluator that checks each answer separately."""
    def judge_answers(record: Record) -> Judged:
        every = _all_answers(record)
        broken = next((words for one in every if (words := wrong(*one))), '')
        return _kept(broken, came) if every else None

    return judge_answers


def _wrong_run_id(run: Run, asked: Question, said: Answer) -> str:
    return '' if said.run_id == run.run_id else f'{said.run_id!r}, not {run.run_id!r}'


def _wrong_seq(run: Run, asked: Question, said: Answer) -> str:
    return '' if said.seq == asked.seq else f'{said.seq} to frame {asked.seq}'


def _wrong_stamp(run: Run, asked: Question, said: Answer) -> str:
    if said.stamp_ns == asked.stamp_ns:
        return ''
    return f'{said.stamp_ns / NS_PER_S:g} s to frame {asked.seq}, of {asked.stamp_ns / NS_PER_S:g}'


_OF_NUMBERS: Final = {
    'finite', 'forgets', 'unusable', 'reproducible', 'accuracy', 'sign', 'limits',
}
_FIELD_REFUSED: Final = re.compile(r"The '\w+' field must be ")


def _fields(record: Record) -> Judged:
    if _FIELD_REFUSED.search(record.died):
        return Status.FAIL, record.died
    return _each_answer(lambda run, asked, said: subnormal(said.value), 'in each answer')(record)


def _not_finite(run: Run, asked: Question, said: Answer) -> str:
    value = said.value
    if isinstance(value, TrackingError):
        wrong = value.valid and not value.usable
        return f'{value.cte_m:g} m, {value.he_rad:g} rad, valid=true' if wrong else ''
    return _bad_command(value)


def _bad_command(value: TaxiCommand) -> str:
    fits = math.isfinite(value.steering_rad) and 0 <= value.speed_mps < math.inf
    return '' if fits else f'{value.steering_rad:g} rad at {value.speed_mps:g} m/s'


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


def _forgets(record: Record) -> Judged:
    first, second, fresh = (_whole(record, kind) for kind in ('first', 'second', 'fresh'))
    if first is None or second is None:
        return None
    different = _difference(first, second)
    if not different:
        return Status.PASS, f'{len(second)} bit-identical'
    if fresh is None or _difference(first, fresh):
        again = 'a fresh process differs again: unseeded random numbers, or '
        again += 'arithmetic without fixed order'
        return Status.FAIL, f'{different}; {again}' if fresh is not None else different
    return Status.FAIL, f'{different}; a fresh process repeats the first run: it keeps state'


def _reproducible(record: Record) -> Judged:
    first, fresh = _whole(record, 'first'), _whole(record, 'fresh')
    if not record.ours:
        return Status.NOT_TRIED, 'the process was not started by the kit'
    if first is None or fresh is None:
        return None
    different = _difference(first, fresh)
    return Status.NOTE, f'not reproducible: {different}' if different else 'yes, bit for bit'


def _strange_image(record: Record) -> Judged:
    heard = {end.topic.name for end in _of_node(record) if not end.publishes}
    if interface.IMAGE.name not in heard:
        return (Status.NOT_TRIED, 'does not use images') if heard else None
    runs = [run for run in record.runs if run.kind == 'strange']
    if (deadly := _deadly(record)) is not None:
        return Status.FAIL, f'{deadly.kind}: {record.died}'
    after = record.run('after')
    if not runs or after is None or record.died:
        return None
    if not after.answered():
        return Status.FAIL, 'no answer to a valid one in the next run'
    return Status.PASS, '; '.join(_of_strange(run) for run in runs)


def _deadly(record: Record) -> Question | None:
    """The malformed message that ended the node; its process may end only in the next run.

    A message it answered is not the cause if it survived into the next run.
    """
    if not record.died or not record.runs or record.died_in not in ('strange', 'after'):
        return None
    last = record.runs[-1]
    if last.kind == 'strange' and last.questions:
        return last.questions[-1]
    before = record.runs[-2] if len(record.runs) > 1 else last
    if record.role.word == 'controller' or before.kind != 'strange' or not before.questions:
        return None
    asked = before.questions[-1]
    lived = asked.answers or before.errors or any(one.answers for one in last.questions)
    return None if lived else asked


def _of_strange(run: Run) -> str:
    if not run.questions:
        return 'not asked'
    one = run.questions[-1]
    if run.errors:
        return f'{one.kind}: ERROR: {run.errors[0]}'
    said = [answer.value for answer in one.answers]
    if not said:
        return f'{one.kind}: no answer'
    usable = isinstance(said[0], TrackingError) and said[0].usable
    return f'{one.kind}: {"a valid estimate from a bad image" if usable else "valid=false"}'


def _unusable(record: Record) -> Judged:
    run = record.run('strange')
    if run is None or not run.questions:
        return None
    for one in run.questions:
        if not one.answers:
            reason = f'ERROR: {run.errors[0]}' if run.errors else record.died or 'no answer'
            return Status.FAIL, f'{one.kind}: {reason}'
        if broken := _not_finite(run, one, one.answers[0]):
            return Status.FAIL, f'{one.kind}: {broken}'
    return Status.PASS, '; '.join(
        f'{one.kind}: {_shown(comparable(one.answers[0].value))}' for one in run.questions
    )


def _other_run(record: Record) -> Judged:
    run = record.run('third')
    asked = [one for one in run.questions if one.kind == 'another run'] if run else []
    if run is None or not asked:
        return None
    named = [said.run_id for said in asked[0].answers]
    came = 'answers with its run_id, which is ignored' if named else 'no answer'
    return _kept("answers it with this run's run_id" if run.run_id in named else '', came)

# Its process -------------------------------------------------------------------------------------


def _lives(record: Record) -> Judged:
    if not record.runs:
        return None
    if record.died and _deadly(record) is None:
        return Status.FAIL, f'run {record.died_in}: {record.died}'
    return Status.PASS, f'{len(record.runs)} runs'


def _ends(name: str) -> Callable[[Record], Judged]:
    def judge_end(record: Record) -> Judged:
        if not record.ours:
            return Status.NOT_TRIED, 'the process was not started by the kit'
        ending = record.endings.get(name)
        if ending is None:
            return None
        wrong = [
            *(['had to be killed'] if ending.after_s is None else []),
            *(['a traceback'] if ending.traceback else []),
            *([f'leaves {ending.left}'] if ending.left else []),
        ]
        took_s = ending.after_s or 0.0
        late = f'; in a graph a command is killed after {_GRACES_S[name]:g} s' \
            if took_s > _GRACES_S[name] else ''
        return _kept(', '.join(wrong), f'after {took_s:.1f} s{late}')

    return judge_end


def _time(record: Record) -> Judged:
    took = sorted(said.after_s for _, _, said in _all_answers(record))
    if not took:
        return None
    median, worst = statistics.median(took), took[-1]
    high = took[min(len(took) - 1, round(0.95 * len(took)))]
    factor = CONTROL_PERIOD_NS / NS_PER_S / max(median, 1e-9)
    slow = '' if factor >= 1 else '; slower than real time'
    return Status.NOTE, (
        f'median {median * 1e3:.1f} ms, 95 % {high * 1e3:.1f} ms, max {worst * 1e3:.1f} ms of '
        f'{len(took)}: at most {factor:.3g} x real time{slow}'
    )


def _memory(record: Record) -> Judged:
    if not record.ours:
        return Status.NOT_TRIED, 'the process was not started by the kit'
    if len(record.memory_mb) < 2:
        return None
    before, after = record.memory_mb[0], record.memory_mb[-1]
    return Status.NOTE, f'{after:.0f} MB, {after - before:+.1f} MB in {len(record.asked())} frames'


def _disorder(record: Record) -> Judged:
    run = record.run('third')
    odd = [one for one in run.questions if one.kind in ('twice', 'late')] if run else []
    if not odd:
        return None
    return Status.NOTE, ', '.join(
        f'{one.kind}: {"answered" if one.answers else "no answer"}' for one in odd
    )

# Plausibility of its answers ---------------------------------------------------------------------


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


def _sides(record: Record) -> Iterator[tuple[TrackingError, TaxiCommand]]:
    run = record.run('first')
    for one, said in (run.answered() if run else [])[:len(SIDES)]:
        if isinstance(said.value, TaxiCommand):
            yield one.truth, said.value


def _sign(record: Record) -> Judged:
    sides = list(_sides(record))
    if len(sides) < len(SIDES):
        return None
    away = []
    for true, command in sides:
        words = f'{true.cte_m:g} m, {math.degrees(true.he_rad):.0f} deg'
        if command.steering_rad * (true.cte_m + true.he_rad) > 0:
            away.append(words)
    left = f'3 m left of the line: {math.degrees(sides[0][1].steering_rad):.1f} deg'
    if away:
        return Status.NOTE, f'{left}; steers AWAY from the centreline at {"; ".join(away)}'
    still = all(command.steering_rad == 0 for _, command in sides)
    return Status.NOTE, f'{left}; {"it does not steer" if still else "towards the line"}'


def _limits(record: Record) -> Judged:
    said = [one.value for _, _, one in _all_answers(record)]
    commands = [one for one in said if isinstance(one, TaxiCommand)]
    if not commands:
        return None
    angle = max(abs(one.steering_rad) for one in commands)
    speed = max(one.speed_mps for one in commands)
    words = f'{math.degrees(angle):.1f} deg, {speed:g} m/s'
    if angle > _STEERING_LIMIT_RAD:
        words += ': beyond any nose wheel; is it in radians?'
    if speed > _SPEED_LIMIT_MPS:
        words += ': faster than taxiing; is it in m/s?'
    return Status.NOTE, words


def _shown(values: tuple[Any, ...], digits: int = 6) -> str:
    numbers = [
        f'{float(one):.{digits}g}' if isinstance(one, str) else f'valid={one}' for one in values
    ]
    return f'({", ".join(numbers)})'

_JUDGES: Final[dict[str, Callable[[Record], Judged]]] = {
    'starts': _starts, 'name': _name, 'topics': _topics, 'types': _types, 'qos': _qos,
    'ready': _ready, 'ready_says': _ready_says, 'waits': _waits, 'uninvited': _uninvited,
    'ready_again': _ready_again, 'answers': _answers, 'once': _once,
    'run_id': _each_answer(_wrong_run_id, 'in each answer'),
    'seq': _each_answer(_wrong_seq, 'in each answer'),
    'stamp': _each_answer(_wrong_stamp, 'in each answer'), 'fields': _fields,
    'finite': _each_answer(_not_finite, 'in each answer'),
    'forgets': _forgets, 'strange_image': _strange_image, 'unusable': _unusable,
    'other_run': _other_run, 'lives': _lives, 'sigint': _ends('SIGINT'),
    'sigterm': _ends('SIGTERM'), 'reproducible': _reproducible, 'time': _time,
    'memory': _memory, 'disorder': _disorder, 'accuracy': _accuracy, 'sign': _sign,
    'limits': _limits,
}
