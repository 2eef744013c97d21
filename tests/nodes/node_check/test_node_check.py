"""``taxinet check-node`` on nodes that keep the contract, and on such that break it."""

from __future__ import annotations

import ast
import dataclasses
import json
import math
import multiprocessing
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from taxinet_ros.bag.run.messages import observation_messages
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.pacing.stepped_run import subnormal
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.testing import ContractError, check_controller, clauses
from taxinet_ros.testing.clauses import (
    CLAUSES,
    ROLES,
    SIDES,
    Answer,
    Broken,
    End,
    Finding,
    Question,
    Run,
    Seen,
    Status,
    demand,
    difference,
)
from taxinet_ros.testing.stage import check_node, shows_traceback

HERE = Path(__file__).parent
WRONG = str(HERE / 'wrong_node.py')
EXAMPLES = HERE.parents[2] / 'examples'
PATIENT_S = 600.0  # no fault that is waited for
AT_ONCE = 6

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

PERCEPTION = EXAMPLES / 'my_perception_package' / 'my_perception_package' / 'perception.py'
KEPT = {'perception': [str(PERCEPTION)], 'controller': [str(EXAMPLES / 'own_controller.py')]}
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
    'int': ('controller', {'values', 'lives'}, PATIENT_S),
    'strange_image': ('perception', {'bad_input'}, PATIENT_S),
    'dies_later': ('perception', {'bad_input'}, PATIENT_S),
    ODD: ('controller', {'forgets', 'steering'}, PATIENT_S),
}


def check(words: list[str], role: str | None, patience_s: float) -> tuple[dict[str, Finding], str]:
    """What became of a node, and what it printed."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / 'node.log'
        log.touch()
        _, found = check_node(
            [sys.executable, *words], role, frames=8, patience_s=patience_s, log=log,
        )
        return {one.clause: one for one in found}, log.read_text()


@pytest.fixture(scope='module')
def checks() -> Iterator[dict[str, Future[tuple[dict[str, Finding], str]]]]:
    """All checks, several at once, since each mostly waits."""
    server = multiprocessing.get_context('forkserver')
    server.set_forkserver_preload(['taxinet_ros.testing.stage'])
    with ProcessPoolExecutor(AT_ONCE, mp_context=server) as pool:
        yield {
            **{role: pool.submit(check, words, None, PATIENT_S) for role, words in KEPT.items()},
            **{
                faults: pool.submit(check, [WRONG, role, faults], role, patience_s)
                for faults, (role, _, patience_s) in FAULTS.items()
            },
        }


@pytest.mark.parametrize('role', KEPT)
def test_given_an_example_then_it_keeps_every_clause(role, checks):
    found, printed = checks[role].result()
    assert found['starts'].came == f'/{ROLES[role].node}'
    assert [*found] == [clause.__name__ for clause in CLAUSES[role]]
    assert {name: one.came for name, one in found.items() if one.status is not Status.PASS} == {}
    of_rclpy = 'context is not valid' in printed and not shows_traceback(printed)
    assert printed == '' or of_rclpy


@pytest.mark.parametrize('faults', FAULTS)
def test_given_faults_then_their_clauses_fail_and_no_others(faults, checks):
    found, _ = checks[faults].result()
    broken = {name for name, one in found.items() if one.status is Status.FAIL}
    assert broken == FAULTS[faults][1], found
    if broken == {'starts'}:
        assert {one.came for name, one in found.items() if name not in broken} == {
            'fix starts first'
        }
    if 'values' in broken:
        assert {found[name].status for name in ('forgets', 'bad_input', 'steering')} == {
            Status.NOT_TRIED
        }


def test_given_nothing_to_judge_by_then_no_clause_passes():
    found = clauses.judge(Seen(role=ROLES['controller'], frames=8), [clauses.waits, clauses.step])
    assert [one.broken for one in found] == [True, True]


def test_given_a_slow_random_node_that_steers_away_then_it_is_told(checks):
    found, _ = checks[ODD].result()
    assert 'unseeded' in found['forgets'].came
    assert 'slower than real time' in found['answers'].came
    assert 'AWAY' in found['steering'].came
    assert 'radians?' in found['steering'].came


def test_what_a_node_died_of_is_told(checks):
    assert checks['dies_later'].result()[0]['bad_input'].came == 'mono8: exit code 7'
    assert "The 'speed' field must be of type 'float'" in checks['int'].result()[0]['values'].came


PLACES = [
    TrackingError(cte_m=cte_m, he_rad=he_rad)
    for cte_m, he_rad in (*SIDES, (5.0, 0.1), (-5.0, -0.1))
]


def came(role: str, pairs: list) -> str:
    """What the clause on the numbers of a role says of answers to a truth, broken or not."""
    questions = [
        Question(seq=seq, truth=truth, answers=[Answer(value)])
        for seq, (truth, value) in enumerate(pairs)
    ]
    seen = Seen(role=ROLES[role], frames=len(pairs), runs=[Run(kind='first', questions=questions)])
    try:
        return CLAUSES[role][-1](seen)
    except Broken as error:
        return f'FAIL {error}'


@pytest.mark.parametrize(('cte', 'he', 'says'), [
    (1.0, 1.0, 'CTE 0.00 m, HE 0.00 deg'),
    (-1.0, 1.0, 'FAIL CTE seems to have the wrong sign'),
    (1.0, -0.5, 'FAIL HE seems to have the wrong sign'),
    (1.0, 180 / math.pi, 'FAIL HE looks like degrees'),
    (1.0, 20.0, 'FAIL 0 m, 4 rad: in metres and radians?'),
    (100.0, 1.0, 'in metres and radians?'),
    (0.0, 1.0, 'CTE is always the same'),
])
def test_given_estimates_with_a_usual_mistake_then_it_is_named(cte, he, says):
    assert says in came('perception', [
        (truth, TrackingError(cte_m=cte * truth.cte_m, he_rad=he * truth.he_rad))
        for truth in PLACES
    ])


@pytest.mark.parametrize('value', [
    TaxiCommand(steering_rad=1.6e-314, speed_mps=5.0),
    TaxiCommand(steering_rad=0.1, speed_mps=5e-324),
    TrackingError(cte_m=-4.6e-310, he_rad=0.0),
])
def test_subnormal_numbers_are_a_bad_value(value):
    answer = Answer(value, doubt=subnormal(value))
    assert 'subnormal, an int or array in a float field?' in clauses.bad_answer(answer)


def test_a_covariance_that_is_none_is_a_bad_value():
    answer = TrackingError(cte_m=1.0, he_rad=0.0, covariance=(0.1, 0.2, 0.0, 0.1))
    assert clauses.bad_answer(Answer(answer)) == 'covariance [0.1, 0.2, 0, 0.1]: not symmetric'


def test_answers_that_differ_in_the_last_digit_are_shown_with_their_difference():
    first, second = (
        Run(kind='first', questions=[Question(
            seq=0, truth=PLACES[0],
            answers=[Answer(TaxiCommand(steering_rad=0.0, speed_mps=speed_mps))],
        )]) for speed_mps in (5.0, math.nextafter(5.0, 6.0))
    )
    assert difference(first, first) == ''
    assert difference(first, second) == 'frame 0: (0.0, 5.0), then (0.0, 5.000000000000001)'


@pytest.mark.parametrize(('gain', 'says'), [
    (-0.05, '3 m left of the line: -8.6 deg; at most'),
    (0.05, 'FAIL steers AWAY, by +0.15 rad where it is left of the centreline'),
    (-2.0, 'FAIL 12 rad: beyond any nose wheel; in radians?'),
    (0.0, 'at most 0.0 deg, 4 m/s'),
])
def test_given_commands_then_it_is_told_to_which_side_they_steer(gain, says):
    assert says in came('controller', [
        (truth, TaxiCommand(
            steering_rad=gain * (truth.cte_m + 10 * truth.he_rad), speed_mps=4.0
        )) for truth in PLACES
    ])


def test_a_controller_that_is_away_at_one_of_two_poses_may_know_the_one_before():
    rads = (-0.1, -0.1, -0.1, 0.1, 0.0, 0.0)
    assert 'FAIL' not in came('controller', [
        (truth, TaxiCommand(steering_rad=rad, speed_mps=4.0))
        for truth, rad in zip(PLACES, rads, strict=True)
    ])


def end(node: str, topic, publishes: bool, qos=None, type_name: str = '') -> End:
    qos = qos or topic.qos
    return End(topic, publishes, SimpleNamespace(
        node_name=node, topic_type=type_name or topic.type_name, qos_profile=qos,
    ))


@pytest.mark.parametrize(('more', 'says'), [
    ([], ''),
    ([('steering_controller', interface.COMMAND)], 'publishes taxi_command 2 times'),
    ([('helper', interface.COMMAND)], 'helper publishes taxi_command'),
    ([('steering_controller', interface.PROGRESS)],
     'steering_controller publishes lockstep/progress'),
])
def test_given_more_publishers_than_its_own_two_then_each_is_named(more, says):
    name = 'steering_controller'
    spoken = [(name, interface.COMMAND), (name, interface.NODE_STATUS), *more]
    heard = [(name, interface.SCENARIO), (name, interface.ESTIMATE)]
    seen = Seen(role=ROLES['controller'], frames=8, names=[f'/{name}'], ends=[
        end(node, topic, publishes) for publishes, of in ((True, spoken), (False, heard))
        for node, topic in of
    ])
    if says:
        with pytest.raises(Broken, match=f'^{says}$'):
            clauses.topics(seen)
    else:
        assert clauses.topics(seen) == 'hears perception/tracking_error, scenario'


@pytest.mark.parametrize(('topic', 'publishes', 'qos', 'says'), [
    (interface.COMMAND, False, QoSProfile(depth=16), ''),
    (interface.COMMAND, True, QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL), ''),
    (interface.SCENARIO, False, QoSProfile(depth=16),
     'scenario: reliable, volatile asked for; reliable, transient_local needed'),
    (interface.COMMAND, True, BEST_EFFORT,
     'taxi_command: best_effort, volatile offered; reliable, volatile needed'),
])
def test_given_quality_of_service_then_what_can_lose_messages_is_named(
    topic, publishes, qos, says
):
    seen = Seen(
        role=ROLES['controller'], frames=8,
        ends=[end('steering_controller', topic, publishes, qos)],
    )
    if says:
        with pytest.raises(Broken, match=f'^{says}$'):
            clauses.qos(seen)
    else:
        assert clauses.qos(seen) == '1 ends'


@pytest.mark.parametrize(('words', 'says'), [
    ((f'{HERE}/wrong_node.py',), "give 'python3 "),
    ((f'{HERE}/wrong_node.py:main', '--role', 'controller', '--patience', '9'),
     '--patience: '),
])
def test_given_words_that_cannot_be_then_they_are_refused_before_the_check(words, says, taxinet):
    code, _, err = taxinet('check-node', *words)
    assert (code, says in err) == (2, True), err


def test_given_an_executable_python_file_then_it_is_run_as_a_node(tmp_path, taxinet):
    program = tmp_path / 'mine.py'
    program.write_text('#!/bin/sh\necho out of paint\nexit 3\n')
    program.chmod(0o755)
    code, out, err = taxinet('check-node', program, '--role', 'controller', '--json')
    assert (code, 'breaks: starts' in err) == (2, True)
    assert json.loads(out)['clauses'][0]['came'] == 'exit code 3: out of paint'


def test_the_kit_takes_a_command_as_it_takes_a_function():
    with pytest.raises(ContractError, match=r'(?s)controller cmd:.*starts: expected: .*fix: run'):
        check_controller(f'cmd:{sys.executable} {WRONG} controller starts')


def test_given_the_docs_then_they_have_each_clause_with_these_words():
    lines = (HERE.parents[2] / 'docs' / 'own_nodes.md').read_text().splitlines()
    begin = lines.index('| clause | what is asked |') + 2
    role = dataclasses.replace(
        ROLES['controller'], node='`perception` or `steering_controller`',
        answers=SimpleNamespace(name='its answers'), hears=[SimpleNamespace(name='its input')],
    )
    expected = [
        f'| `{clause.__name__}` | {demand(clause, role)[0]} |'
        for clause in dict.fromkeys(CLAUSES['perception'] + CLAUSES['controller'])
    ]
    assert lines[begin:begin + len(expected) + 1] == [*expected, '']
    assert len(lines) <= 170


@pytest.mark.parametrize('seq', [0, 7])
def test_given_any_message_of_a_step_then_it_tells_the_step_as_the_docs_say(seq):
    state = Aircraft(Scenario()).state
    pixels = np.zeros((200, 360, 3), np.uint8)
    now = Observation(seq=seq, stamp_ns=seq * CONTROL_PERIOD_NS, state=state, image=pixels)
    steps = {}
    types = {topic.name: topic.type for topic in interface.TOPICS}
    for topic, cdr in observation_messages(now, now.image, 'r'):
        message = deserialize_message(cdr, types[topic.name])
        stamp = message.clock if topic.name == interface.CLOCK.name else message.header.stamp
        steps[topic.name] = (stamp.sec * 1_000_000_000 + stamp.nanosec) / 100_000_000
    assert steps == {
        topic.name: seq for topic in interface.TOPICS
        if topic.publishers == (interface.SIMULATOR,) and topic.recorded == interface.PER_STEP
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
    source = Path(KEPT[role][0]).read_text()
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
