"""``taxinet check-node`` on nodes that keep the contract, and on such that break it."""

from __future__ import annotations

import ast
import dataclasses
import math
import multiprocessing
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from taxinet_msgs.msg import NodeStatus

from taxinet_ros.bag.run.messages import observation_messages
from taxinet_ros.cli.run.check_node import run_check
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.node_check.clauses import CLAUSES, Finding, Status, judge
from taxinet_ros.nodes.node_check.driver import CheckOptions, check_node, command_starter
from taxinet_ros.nodes.node_check.record import ROLES, SIDES, Answer, End, Question, Record, Run

HERE = Path(__file__).parent
WRONG = str(HERE / 'wrong_node.py')
EXAMPLES = HERE.parents[2] / 'examples'
PATIENT_S = 600.0  # no fault that is waited for
AT_ONCE = 6

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

KEPT = {role: [str(EXAMPLES / f'own_{role}.py')] for role in ROLES}
ODD = 'slow,random,away'
BEST_EFFORT = QoSProfile(depth=16, reliability=ReliabilityPolicy.BEST_EFFORT)
FAULTS = {
    'starts': ('controller', {'starts'}, PATIENT_S),
    'very_slow': ('perception', set(), PATIENT_S),
    'dies_at_2': ('perception', {'lives'}, PATIENT_S),
    'name': ('controller', {'name'}, 1.0),
    'two': ('controller', {'name'}, 1.0),
    'topics,types,qos': ('controller', {'topics', 'qos'}, PATIENT_S),
    'ready_again': ('controller', {'ready'}, 2.0),
    'silent': ('controller', {'answers'}, 2.0),
    'waits,listens': ('controller', {'waits', 'ready'}, PATIENT_S),
    'seq,twice,traceback': ('controller', {'step', 'answers', 'ends'}, PATIENT_S),
    'remembers,unusable,leaves': ('controller', {'forgets', 'bad_input', 'ends'}, PATIENT_S),
    'nan,deaf': ('controller', {'values', 'ends'}, PATIENT_S),
    'strange_image': ('perception', {'bad_input'}, PATIENT_S),
    ODD: ('controller', {'forgets'}, PATIENT_S),
}


def check(words: list[str], role: str | None, patience_s: float) -> tuple[list[Finding], str]:
    """What became of a node, and what it printed."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / 'node.log'
        log.touch()
        record = check_node(CheckOptions(
            start=command_starter([sys.executable, *words]), role=role, domain=None, frames=8,
            patience_s=patience_s, log=log,
        ), print)
        return judge(record), log.read_text()


@pytest.fixture(scope='module')
def checks() -> Iterator[dict[str, Future[tuple[list[Finding], str]]]]:
    """All checks, several at once, since each mostly waits."""
    server = multiprocessing.get_context('forkserver')
    server.set_forkserver_preload(['taxinet_ros.nodes.node_check.driver'])
    with ProcessPoolExecutor(AT_ONCE, mp_context=server) as pool:
        yield {
            **{role: pool.submit(check, words, None, PATIENT_S) for role, words in KEPT.items()},
            **{
                faults: pool.submit(check, [WRONG, role, faults], role, patience_s)
                for faults, (role, _, patience_s) in FAULTS.items()
            },
        }


def by_clause(findings: list[Finding]) -> dict[str, Finding]:
    return {one.clause.name: one for one in findings}


def broken(found: dict[str, Finding]) -> set[str]:
    return {name for name, one in found.items() if one.status is Status.FAIL}


@pytest.mark.parametrize('role', KEPT)
def test_given_an_example_then_it_keeps_every_clause(role, checks):
    findings, printed = checks[role].result()
    assert by_clause(findings)['starts'].came == f'/{ROLES[role].node}'
    assert {one.status for one in findings} == {Status.PASS, Status.NOTE}, findings
    assert printed == ''


@pytest.mark.parametrize('faults', FAULTS)
def test_given_faults_then_their_clauses_fail_and_no_others(faults, checks):
    found = by_clause(checks[faults].result()[0])
    assert broken(found) == FAULTS[faults][1], found


def test_given_a_slow_random_node_that_steers_away_then_it_is_told(checks):
    found = by_clause(checks[ODD].result()[0])
    assert 'unseeded' in found['forgets'].came
    assert 'slower than real time' in found['time'].came
    assert 'AWAY' in found['steering'].came
    assert 'radians?' in found['steering'].came


def judged(role: str, answer: Callable[[TrackingError], TrackingError | TaxiCommand]) -> Record:
    """A record of one run in which a node answered so."""
    run = Run(run_id='r', kind='first')
    for seq, (cte_m, he_rad) in enumerate([*SIDES, (5.0, 0.1), (-5.0, -0.1)]):
        truth = TrackingError(cte_m=cte_m, he_rad=he_rad)
        question = Question(seq=seq, truth=truth)
        said = Answer(
            seq=seq, stamp_ns=question.stamp_ns, run_id='r', value=answer(truth), after_s=0.01
        )
        question.answers.append(said)
        run.questions.append(question)
    return Record(role=ROLES[role], runs=[run])


@pytest.mark.parametrize(('cte', 'he', 'says'), [
    (1.0, 1.0, 'CTE 0.00 m, HE 0.00 deg'),
    (-1.0, 1.0, 'CTE seems to have the wrong sign'),
    (1.0, -0.5, 'HE seems to have the wrong sign'),
    (1.0, 180 / math.pi, 'HE looks like degrees'),
    (0.0, 1.0, 'CTE is always the same'),
])
def test_given_estimates_with_a_usual_mistake_then_it_is_named(cte, he, says):
    record = judged('perception', lambda truth: TrackingError(
        cte_m=cte * truth.cte_m, he_rad=he * truth.he_rad
    ))
    found = by_clause(judge(record))['accuracy'].came
    assert says in found
    assert found.count('looks') == (1 if 'looks' in says else 0)


@pytest.mark.parametrize(('role', 'answer'), [
    ('controller', TaxiCommand(steering_rad=1.6e-314, speed_mps=5.0)),
    ('controller', TaxiCommand(steering_rad=0.1, speed_mps=5e-324)),
    ('perception', TrackingError(cte_m=-4.6e-310, he_rad=0.0)),
])
def test_subnormal_numbers_break_the_clause_of_values_and_nothing_is_said_of_them(role, answer):
    found = by_clause(judge(judged(role, lambda truth: answer)))
    assert found['values'].status is Status.FAIL
    assert 'subnormal, an int or array in a float field?' in found['values'].came
    assert 'float(x)' in found['values'].clause.mend
    told = {'perception': 'accuracy', 'controller': 'steering'}[role]
    assert found[told].status is Status.NOT_TRIED


def test_a_node_that_dies_of_a_wrong_type_breaks_the_clause_of_values():
    died = "exit code 1: AssertionError: The 'speed' field must be of type 'float'"
    record = judged('controller', lambda truth: TaxiCommand(steering_rad=0.0, speed_mps=1.0))
    found = by_clause(judge(dataclasses.replace(record, died=died, died_in='first')))
    assert (found['values'].status, found['values'].came) == (Status.FAIL, died)


def test_an_estimate_far_away_has_an_error_of_few_digits():
    record = judged('perception', lambda truth: TrackingError(cte_m=1e300, he_rad=0.0))
    assert 'CTE 1e+300 m' in by_clause(judge(record))['accuracy'].came


def test_answers_that_differ_in_the_last_digit_are_shown_with_their_difference():
    records = [judged('controller', lambda truth, speed_mps=speed_mps: TaxiCommand(
        steering_rad=0.0, speed_mps=speed_mps
    )) for speed_mps in (5.0, math.nextafter(5.0, 6.0))]
    runs = [dataclasses.replace(record.runs[0], kind=kind)
            for record, kind in zip(records, ('first', 'second'), strict=True)]
    came = by_clause(judge(dataclasses.replace(records[0], runs=runs)))['forgets'].came
    assert came == 'frame 0: (0, 5), then (0, 5.0000000000000009)'


@pytest.mark.parametrize(('gain', 'says'), [
    (-0.05, '3 m left of the line: -8.6 deg; towards the line'),
    (0.05, '3 m left of the line: 8.6 deg; steers AWAY from the centreline'),
    (0.0, 'it does not steer'),
])
def test_given_commands_then_it_is_told_to_which_side_they_steer(gain, says):
    record = judged('controller', lambda truth: TaxiCommand(
        steering_rad=gain * (truth.cte_m + 10 * truth.he_rad), speed_mps=4.0
    ))
    assert says in by_clause(judge(record))['steering'].came


@pytest.mark.parametrize(('more', 'says'), [
    ([], ''),
    ([('steering_controller', interface.COMMAND)], 'publishes taxi_command 2 times'),
    ([('helper', interface.COMMAND)], 'helper publishes taxi_command'),
    ([('steering_controller', interface.PROGRESS)], 'publishes lockstep/progress'),
])
def test_given_more_publishers_than_its_own_two_then_each_is_named(more, says):
    name = 'steering_controller'
    spoken = [(name, interface.COMMAND), (name, interface.NODE_STATUS), *more]
    heard = [(name, interface.SCENARIO), (name, interface.ESTIMATE)]
    ends = [
        End(
            node=node, topic=topic, publishes=publishes, type_name=topic.type_name, qos=topic.qos
        ) for publishes, of in ((True, spoken), (False, heard)) for node, topic in of
    ]
    record = Record(role=ROLES['controller'], nodes=[f'/{name}'], ends=ends)
    found = by_clause(judge(record))['topics']
    assert (found.status, found.came) == (
        (Status.FAIL, says) if says
        else (Status.PASS, 'hears perception/tracking_error, scenario')
    )


@pytest.mark.parametrize(('topic', 'publishes', 'qos', 'says'), [
    (interface.COMMAND, False, QoSProfile(depth=16), ''),
    (interface.SCENARIO, False, QoSProfile(depth=16), 'volatile asked for, transient local needed'),
    (interface.COMMAND, True, BEST_EFFORT, 'best effort offered, reliable needed'),
])
def test_given_quality_of_service_then_what_can_lose_messages_is_named(
    topic, publishes, qos, says
):
    misfit = End(node='x', topic=topic, publishes=publishes, type_name='', qos=qos).misfit()
    assert (says in misfit) if says else misfit == ''


@pytest.mark.parametrize(('more', 'says'), [
    ({'log': Path('no_such_folder/x.log')}, 'no such folder: no_such_folder'),
    ({'log': Path('/')}, 'is a folder'),
    ({'patience_s': math.nan}, '--patience nan: not a number'),
    ({'command': str(HERE / 'wrong_node.py')}, "give 'python3 "),
])
def test_given_words_that_cannot_be_then_they_are_refused_before_the_check(more, says):
    words = {
        'command': 'true', 'role': None, 'external': False, 'domain': None, 'frames': 8,
        'patience_s': 1.0, 'log': None, 'as_json': False, **more,
    }
    with pytest.raises(UsageError, match=re.escape(says)):
        run_check(**words)


def test_given_an_executable_python_file_then_it_is_run_as_a_node(tmp_path, capfd):
    program = tmp_path / 'mine.py'
    program.write_text('#!/bin/sh\necho out of paint\nexit 3\n')
    program.chmod(0o755)
    with pytest.raises(UsageError, match='breaks: starts'):
        run_check(
            str(program), role='controller', external=False, domain=None, frames=8,
            patience_s=60.0, log=tmp_path / 'node.log', as_json=False,
        )
    assert 'exit code 3: out of paint' in capfd.readouterr().out
    assert (tmp_path / 'node.log').read_text() == 'out of paint\n'


def whole_record(role: str) -> Record:
    """Of a node that has kept everything, as far as runs tell."""
    runs = []
    strange = 3 if role == 'perception' else 1
    for kind in ('first', 'second', *['strange'] * strange, 'after', 'fresh'):
        run = judged(role, lambda truth: truth if role == 'perception' else TaxiCommand(
            steering_rad=0.0, speed_mps=1.0
        )).runs[0]
        ready = [NodeStatus(node=ROLES[role].node, implementation='x', state=NodeStatus.READY)]
        runs.append(dataclasses.replace(run, kind=kind, ready=ready, questions=[
            dataclasses.replace(one, kind='empty' if kind == 'strange' else '')
            for one in run.questions
        ]))
    name = ROLES[role].node
    ends = [
        End(
            node=name, topic=topic, publishes=False, type_name=topic.type_name, qos=topic.qos
        ) for topic in ROLES[role].hears[:1]
    ]
    return Record(role=ROLES[role], nodes=[f'/{name}'], runs=runs, ends=ends)


@pytest.mark.parametrize('role', ROLES)
@pytest.mark.parametrize('count', range(8))
def test_given_a_node_that_dies_at_any_place_then_it_is_judged_and_told(role, count):
    record = whole_record(role)
    runs = record.runs[:count]
    if runs:
        runs[-1].ready, runs[-1].questions = [], []
    kind = runs[-1].kind if runs else ''
    fails = broken(by_clause(judge(
        dataclasses.replace(record, runs=runs, died='exit code 7', died_in=kind)
    )))
    told = 'starts' if not runs else 'bad_input' if kind == 'after' else 'lives'
    if kind != 'strange':
        assert told in fails


def test_given_a_node_that_dies_of_a_strange_image_then_the_image_is_told():
    record = whole_record('perception')
    del record.runs[-2:]
    record.runs[-1].questions[-1].answers.clear()
    record.died, record.died_in = 'exit code 7', 'strange'
    assert broken(by_clause(judge(record))) >= {'bad_input'}


def test_given_nothing_but_a_node_that_never_came_then_nothing_else_is_judged():
    findings = judge(Record(role=ROLES['perception']))
    assert [one.clause.name for one in findings if one.status is Status.FAIL] == ['starts']
    assert {one.came for one in findings[1:]} == {'fix starts first'}


def test_given_the_docs_then_they_have_each_clause_with_these_words():
    lines = (HERE.parents[2] / 'docs' / 'own_nodes.md').read_text().splitlines()
    begin = lines.index('| clause | what is asked |') + 2
    words = {
        'node': '`perception` or `steering_controller`', 'answers': 'its answers',
        'hears': 'its input',
    }
    expected = [
        f'| `{clause.name}` | {clause.expected.format(**words)} |'
        for clause in CLAUSES if not clause.informative
    ]
    assert lines[begin:begin + len(expected) + 1] == [*expected, '']
    assert len(lines) <= 150


@pytest.mark.parametrize('seq', [0, 7])
def test_given_any_message_of_a_step_then_it_tells_the_step_as_the_docs_say(seq):
    state = Aircraft(Scenario()).state
    pixels = np.zeros((200, 360, 3), np.uint8)
    now = Observation(seq=seq, stamp_ns=seq * CONTROL_PERIOD_NS, state=state, image=pixels)
    steps = {}
    types = {topic.name: topic.type for topic in interface.TOPICS}
    for topic, cdr in observation_messages(now, 'r'):
        message = deserialize_message(cdr, types[topic.name])
        stamp = message.clock if topic.name == interface.CLOCK.name else message.header.stamp
        steps[topic.name] = (stamp.sec * 1_000_000_000 + stamp.nanosec) / 100_000_000
    assert steps == {
        topic.name: seq for topic in interface.TOPICS
        if topic.publishers == (interface.SIMULATOR,) and topic.each_step
    }
    fields = {
        topic.name: {'seq', 'run_id'} & topic.type.get_fields_and_field_types().keys()
        for topic in interface.TOPICS if topic.type.__module__.startswith('taxinet_msgs')
    }
    assert fields.pop(interface.SCENARIO.name) == fields.pop(interface.VERDICT.name) == {'run_id'}
    assert len(fields) == 8
    assert all(found == {'seq', 'run_id'} for found in fields.values()), fields


@pytest.mark.parametrize(('role', 'most'), [('perception', 48), ('controller', 41)])
def test_given_an_example_then_it_is_short(role, most):
    """Lines of code but imports, docstrings and blank ones."""
    source = (EXAMPLES / f'own_{role}.py').read_text()
    prose = {
        line for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Import | ast.ImportFrom)
        or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        for line in range(node.lineno, node.end_lineno + 1)
    }
    code = [
        line for number, line in enumerate(source.splitlines(), 1)
        if line.strip() and number not in prose
    ]
    assert len(code) <= most, len(code)
