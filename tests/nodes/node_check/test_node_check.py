"""``taxinet check-node`` on nodes that keep the contract, and on such that break it."""

from __future__ import annotations

import ast
import math
import multiprocessing
import re
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from taxinet_ros.bag.run.messages import observation_messages
from taxinet_ros.cli.run.check_node import run_check
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.step import StepMessage
from taxinet_ros.nodes.node_check import (
    CLAUSES,
    ROLES,
    SIDES,
    End,
    Finding,
    Question,
    Run,
    Status,
    accuracy,
    bad_value,
    check_node,
    command_starter,
    difference,
    steering,
    topics_broken,
)

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
    'int': ('controller', {'values', 'lives'}, PATIENT_S),
    'strange_image': ('perception', {'bad_input'}, PATIENT_S),
    'dies_later': ('perception', {'bad_input'}, PATIENT_S),
    ODD: ('controller', {'forgets'}, PATIENT_S),
}


def check(words: list[str], role: str | None, patience_s: float) -> tuple[dict[str, Finding], str]:
    """What became of a node, and what it printed."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / 'node.log'
        log.touch()
        report = check_node(
            command_starter([sys.executable, *words]), role, print, domain_id=None, frames=8,
            patience_s=patience_s, log=log,
        )
        return {one.clause.name: one for one in report.findings}, log.read_text()


@pytest.fixture(scope='module')
def checks() -> Iterator[dict[str, Future[tuple[dict[str, Finding], str]]]]:
    """All checks, several at once, since each mostly waits."""
    server = multiprocessing.get_context('forkserver')
    server.set_forkserver_preload(['taxinet_ros.nodes.node_check'])
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
    assert found.keys() == {one.name for one in CLAUSES if role in one.roles}
    assert {name: one.came for name, one in found.items() if one.status is Status.FAIL} == {}
    assert printed == ''


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


def test_given_a_slow_random_node_that_steers_away_then_it_is_told(checks):
    found, _ = checks[ODD].result()
    assert 'unseeded' in found['forgets'].came
    assert 'slower than real time' in found['time'].came
    assert 'AWAY' in found['steering'].came
    assert 'radians?' in found['steering'].came


def test_what_a_node_died_of_is_told(checks):
    assert checks['dies_later'].result()[0]['bad_input'].came == 'mono8: exit code 7'
    assert "The 'speed' field must be of type 'float'" in checks['int'].result()[0]['values'].came


PLACES = [
    TrackingError(cte_m=cte_m, he_rad=he_rad)
    for cte_m, he_rad in (*SIDES, (5.0, 0.1), (-5.0, -0.1))
]


@pytest.mark.parametrize(('cte', 'he', 'says'), [
    (1.0, 1.0, 'CTE 0.00 m, HE 0.00 deg'),
    (-1.0, 1.0, 'CTE seems to have the wrong sign'),
    (1.0, -0.5, 'HE seems to have the wrong sign'),
    (1.0, 180 / math.pi, 'HE looks like degrees'),
    (0.0, 1.0, 'CTE is always the same'),
])
def test_given_estimates_with_a_usual_mistake_then_it_is_named(cte, he, says):
    found = accuracy([
        (truth, TrackingError(cte_m=cte * truth.cte_m, he_rad=he * truth.he_rad))
        for truth in PLACES
    ])
    assert says in found
    assert found.count('looks') == (1 if 'looks' in says else 0)


@pytest.mark.parametrize('value', [
    TaxiCommand(steering_rad=1.6e-314, speed_mps=5.0),
    TaxiCommand(steering_rad=0.1, speed_mps=5e-324),
    TrackingError(cte_m=-4.6e-310, he_rad=0.0),
])
def test_subnormal_numbers_are_a_bad_value(value):
    assert 'subnormal, an int or array in a float field?' in bad_value(value)


def test_an_estimate_far_away_has_an_error_of_few_digits():
    far = TrackingError(cte_m=1e300, he_rad=0.0)
    assert 'CTE 1e+300 m' in accuracy([(truth, far) for truth in PLACES])


def test_answers_that_differ_in_the_last_digit_are_shown_with_their_difference():
    first, second = (
        Run(run_id='r', kind='first', questions=[Question(
            seq=0, truth=PLACES[0],
            answers=[StepMessage(0, TaxiCommand(steering_rad=0.0, speed_mps=speed_mps))],
        )]) for speed_mps in (5.0, math.nextafter(5.0, 6.0))
    )
    assert difference(first, first) == ''
    assert difference(first, second) == 'frame 0: (0, 5), then (0, 5.0000000000000009)'


@pytest.mark.parametrize(('gain', 'says'), [
    (-0.05, '3 m left of the line: -8.6 deg; towards the line'),
    (0.05, '3 m left of the line: 8.6 deg; steers AWAY from the centreline'),
    (0.0, 'it does not steer'),
])
def test_given_commands_then_it_is_told_to_which_side_they_steer(gain, says):
    assert says in steering([
        (truth, TaxiCommand(
            steering_rad=gain * (truth.cte_m + 10 * truth.he_rad), speed_mps=4.0
        )) for truth in PLACES
    ])


@pytest.mark.parametrize(('more', 'says'), [
    ([], []),
    ([('steering_controller', interface.COMMAND)], ['publishes taxi_command 2 times']),
    ([('helper', interface.COMMAND)], ['helper publishes taxi_command']),
    ([('steering_controller', interface.PROGRESS)], ['publishes lockstep/progress']),
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
    assert topics_broken(ROLES['controller'], ends) == says


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
