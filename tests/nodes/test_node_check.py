"""``taxinet check-node`` on nodes that keep the contract, and on such that break it."""

from __future__ import annotations

import math
import multiprocessing
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import pytest

from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.nodes.node_check import CheckOptions, check_node, command_starter
from taxinet_ros.nodes.node_contract import (
    ROLES,
    SIDES,
    Answer,
    Finding,
    Question,
    Record,
    Run,
    Status,
    judge,
)

HERE = Path(__file__).parent
WRONG = str(HERE / 'wrong_node.py')
EXAMPLES = HERE.parents[1] / 'examples'
PATIENT_S = 600.0  # no fault that is waited for
AT_ONCE = 6

pytestmark = pytest.mark.ros

KEPT = {role: [str(EXAMPLES / f'own_{role}.py')] for role in ROLES}
ODD = 'slow,random,away'
FAULTS = {
    'starts': ('controller', {'starts'}, PATIENT_S),
    'name': ('controller', {'name'}, 1.0),
    'topics,types,qos': ('controller', {'topics', 'types', 'qos'}, PATIENT_S),
    'ready': ('controller', {'ready'}, 1.0),
    'ready_again': ('controller', {'ready_again'}, 2.0),
    'silent': ('controller', {'answers'}, 2.0),
    'dies': ('controller', {'lives'}, PATIENT_S),
    'waits,listens': ('controller', {'waits', 'ready_says', 'uninvited'}, PATIENT_S),
    'uninvited,run_id,seq,stamp,twice,traceback': (
        'controller', {'uninvited', 'run_id', 'seq', 'stamp', 'once', 'sigint', 'sigterm'},
        PATIENT_S,
    ),
    'remembers,unusable,other_run,leaves': (
        'controller', {'forgets', 'unusable', 'other_run', 'sigint', 'sigterm'}, PATIENT_S,
    ),
    'nan,deaf': ('controller', {'finite', 'unusable', 'sigint', 'sigterm'}, PATIENT_S),
    'nan,strange_image': ('perception', {'finite', 'strange_image'}, PATIENT_S),
    ODD: ('controller', set(), PATIENT_S),
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
    server.set_forkserver_preload(['taxinet_ros.nodes.node_check'])
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
    assert 'not reproducible' in found['reproducible'].came
    assert 'not reproducible' in found['forgets'].came
    assert 'runs take longer' in found['time'].came
    assert 'AWAY' in found['sign'].came
    assert 'radians?' in found['limits'].came


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
    (-1.0, 1.0, 'CTE looks as if its sign were swapped'),
    (1.0, -0.5, 'HE looks as if its sign were swapped'),
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


@pytest.mark.parametrize(('gain', 'says'), [
    (-0.05, '3 m left of the line: -8.6 deg; towards the line'),
    (0.05, '3 m left of the line: 8.6 deg; steers AWAY from the line'),
    (0.0, 'it does not steer'),
])
def test_given_commands_then_it_is_told_to_which_side_they_steer(gain, says):
    record = judged('controller', lambda truth: TaxiCommand(
        steering_rad=gain * (truth.cte_m + 10 * truth.he_rad), speed_mps=4.0
    ))
    assert says in by_clause(judge(record))['sign'].came


def test_given_nothing_but_a_node_that_never_came_then_nothing_else_is_judged():
    findings = judge(Record(role=ROLES['perception']))
    assert [one.clause.name for one in findings if one.status is Status.FAIL] == ['starts']
    assert {one.came for one in findings[1:]} == {'mend starts first'}
