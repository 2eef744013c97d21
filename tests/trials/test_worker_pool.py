"""Workers that answer, die, hang or break: the crew says which, and leaves nobody behind."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.pacing.timing import parse_timing
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.system import System
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.verdict.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import typed
from taxinet_ros.trials.worker_pool import (
    Answer,
    Task,
    WorkerPool,
    encode_line,
)

COMMAND = (sys.executable, str(Path(__file__).with_name('fake_worker.py')))


def request(word: str, index: int = 0) -> RunRequest:
    return RunRequest(
        run_id=f'run-{index}', index=index, program=word, seed=1,
        scenario=Scenario(rain_fraction=0.0),
        judging=Judging(specs=('f',)), participants=(),
    )


def make(folder: Path, **changes) -> WorkerPool:
    return WorkerPool(**{'command': COMMAND, 'size': 2, 'logs': folder / 'logs', **changes})


@pytest.fixture
def crew(tmp_path: Path) -> Iterator[WorkerPool]:
    with make(tmp_path) as crew:
        yield crew
    assert crew.workers == []


def answers(crew: WorkerPool, number: int) -> list[Answer]:
    found: list[Answer] = []
    while len(found) < number:
        found += crew.answers(1.0)
    assert len(found) == number
    return found


def test_given_runs_then_they_travel_whole(tmp_path):
    asked = RunRequest(
        run_id='r', index=3, program='p', seed=2**60, participants=('c',),
        judging=Judging(specs=('a', 'b'), stop_on=StopOn.DECIDED, bounds=('d',), rates=('e',)),
        scenario=Scenario(cross_track_m=0.1 + 0.2, clouds='stratus', rain_fraction=1 / 3),
    )
    statistics = RunStatistics(max_cross_track_m=31.5, he_error=ErrorStatistics(mean=-1 / 3))
    answer = RunResult(
        outcome=Outcome.FAIL, last_seq=4, statistics=statistics, stopped_early=True,
        robustness={'f': RobustnessInterval.exactly(-1 / 3), 'g': RobustnessInterval(-math.inf, 1)},
    )
    assert typed(RunRequest, json.loads(encode_line(dataclasses.asdict(asked)))) == asked
    task = Task(
        **{name: getattr(asked, name) for name in RunRequest.__dataclass_fields__},
        word='noisy:1', exact=False, observer='module:Name', observed='word', system=System(
            perception='original', gains={'heading_gain': 1 / 3},
            timing=parse_timing('latency perception=0.3'), world='kmwh', world_sha256='x',
        ),
    )
    assert typed(Task, json.loads(encode_line(dataclasses.asdict(task)))) == task
    back = typed(RunResult, json.loads(encode_line(dataclasses.asdict(answer))))
    assert repr(back) == repr(answer)  # NaN is not equal to itself


def test_given_two_workers_then_each_has_a_run_and_both_are_used_again(crew):
    pids = set()
    for round_ in range(3):
        assert crew.free
        crew.give(request('fine', 2 * round_))
        crew.give(request('fine', 2 * round_ + 1))
        assert (crew.busy, crew.free) == (2, False)
        found = answers(crew, 2)
        assert {asked.index for asked, _ in found} == {2 * round_, 2 * round_ + 1}
        assert [result.rho for _, result in found] == [{'f': 1.5}] * 2
        pids |= {result.detail for _, result in found}
    assert len(pids) == 2


@pytest.mark.parametrize(
    ('word', 'kind', 'detail'),
    [
        ('killed', 'died', 'killed by SIGKILL'),
        ('exits', 'died', 'exit code 3: out of paper'),
    ],
)
def test_given_a_worker_that_dies_then_its_run_says_how_and_the_next_has_a_fresh_one(
    word, kind, detail, crew
):
    crew.give(request(word))
    ((asked, result),) = answers(crew, 1)
    assert asked.program == word
    assert (result.outcome, result.kind, result.who) == (Outcome.INFRA_ERROR, kind, 'worker')
    assert (result.detail, result.last_seq) == (detail, 7)
    assert crew.workers == []
    crew.give(request('fine', 1))
    assert answers(crew, 1)[0][1].outcome is Outcome.PASS


def test_given_a_broken_graph_then_its_worker_is_not_used_again(crew):
    crew.give(request('breaks'))
    (broken,) = crew.workers
    ((_, result),) = answers(crew, 1)
    assert result.outcome is Outcome.INFRA_ERROR
    assert not broken.alive
    crew.give(request('fine', 1))
    assert crew.workers[0].pid != broken.pid
    assert answers(crew, 1)[0][1].outcome is Outcome.PASS


def test_given_an_idle_worker_that_dies_then_the_next_run_does_not_suffer(crew):
    crew.give(request('fine'))
    answers(crew, 1)
    (idle,) = crew.workers
    os.kill(idle.pid, 9)
    os.waitid(os.P_PID, idle.pid, os.WEXITED | os.WNOWAIT)
    crew.give(request('fine', 1))
    assert answers(crew, 1)[0][1].outcome is Outcome.PASS


def test_given_a_worker_that_hangs_then_it_is_killed_after_the_silence(tmp_path):
    with make(tmp_path, silence_s=1.5) as crew:
        crew.give(request('hangs'))
        (worker,) = crew.workers
        ((_, result),) = answers(crew, 1)
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'timeout')
    assert result.detail == 'silent for 1.5 s'
    assert not worker.alive


def test_given_a_mistake_of_the_users_then_it_is_his(crew):
    crew.give(request('mistake'))
    with pytest.raises(UsageError, match='weights: no such file'):
        answers(crew, 1)


def test_given_an_interrupt_then_the_runs_under_way_end_in_order_and_no_more_begin(crew):
    crew.give(request('waits'))
    crew.give(request('killed', 1))
    crew.interrupt()
    assert not crew.free
    found = answers(crew, 2)
    assert [result.outcome for _, result in found] == [Outcome.INTERRUPTED] * 2


def test_given_the_end_then_workers_at_work_are_not_waited_for(tmp_path):
    with make(tmp_path) as crew:
        crew.give(request('hangs'))
        (worker,) = crew.workers
    assert not worker.alive
