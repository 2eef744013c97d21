"""What the engine does for every proposer: a second try, patience with the bench, an end."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import falsify_samples as toy
import pytest

from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.system import System
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.source import Rejected
from taxinet_ros.trials.campaign import ProgramOrder
from taxinet_ros.trials.engine import Engine, Proposer
from taxinet_ros.trials.options import AUDIT, CampaignOptions, make_options
from taxinet_ros.trials.past_runs.trials import Trial, _Trials
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import facts_of_runs
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.requirements import DEFAULT_JUDGING
from taxinet_ros.trials.worker_pool import Task


class Same(Proposer):
    """The same scene again and again, but for one that is rejected."""

    patience, runs = 2, 6

    def __init__(self, out: Path) -> None:
        self.campaign = CampaignOptions(
            program='scenes', runs=6, seed=3, perception='truth', out=out, images='none'
        )
        self.source: AbstractContextManager[None] = nullcontext()
        self._next = 0

    def prepare(self) -> dict[str, Any]:
        return facts_of_runs(self.campaign, {'program': 'scenes'})

    def propose(self) -> int:
        self._next += 1
        return self._next - 1

    def scene(self, index: int) -> Scenario:
        if index == 3:
            raise Rejected('the bench had no part in it', 0)
        return Scenario(duration_s=1.0)

    def completed(self, row: RunRow) -> RunRow:
        return row


class Once(Same):
    retries = False


def drive(
    proposer: Same, judge: Callable[[RunRequest], RunResult], attempts: list[int]
) -> Engine[Same]:
    with Engine(proposer, ('perception',)) as engine:
        while (request := engine.next()) is not None:
            attempts.append(request.index)
            (proposer.campaign.out / request.run_id).mkdir()
            result = judge(request)
            usable = engine.take(request, result)
            assert usable is (result.outcome.judged)
        assert engine.ended
    return engine


def broken(*times: int) -> Callable[[RunRequest], RunResult]:
    """A bench that breaks run 0 so many times, run 1 so many times, and so on."""
    left = dict(enumerate(times))

    def judge(request: RunRequest) -> RunResult:
        left[request.index] = left.get(request.index, 0) - 1
        breaks = left[request.index] >= 0
        return toy.result(request, Outcome.INFRA_ERROR if breaks else None)

    return judge


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('kind', 'times', 'attempts', 'outcomes', 'retries'), [
    (Same, (1,), [0, 0, 1, 2, 4, 5], 'PPPRPP', [1, 0, 0, 0, 0, 0]),
    (Same, (0, 2), [0, 1, 1, 2, 4, 5], 'PIPRPP', [0, 1, 0, 0, 0, 0]),
    (Same, (0, 2, 2), [0, 1, 1, 2, 2], 'PII', [0, 1, 1]),
    (Same, (0, 0, 2, 0, 2), [0, 1, 2, 2, 4, 4], 'PPIRI', [0, 0, 1, 0, 1]),
    (Once, (0, 1, 1), [0, 1, 2], 'PII', [0, 0, 0]),
], ids=['fixed', 'one broken', 'broken', 'a rejected scene is no sign of health', 'no retries'])
def test_given_runs_that_break_then_each_is_tried_once_more_and_some_in_a_row_end_it(
    kind, times, attempts, outcomes, retries, tmp_path
):
    began: list[int] = []
    engine = drive(kind(tmp_path), broken(*times), began)
    assert began == attempts
    letters = ''.join('I' if row.kind == 'test' and row.outcome is Outcome.INFRA_ERROR
                      else row.outcome.value[0] for row in engine.rows)
    assert letters.replace('F', 'P') == outcomes
    assert [row.retries for row in engine.rows] == retries
    last = len(outcomes) < 6 or outcomes.endswith('RI')
    assert engine.stopped == ('2 runs in a row were broken by the bench' if last else '')
    assert (engine.broken is list(engine.rows)[-1]) is last
    assert read_campaign(tmp_path).attempts == {
        index: began.count(index) for index in dict.fromkeys(began)
    }
    aside = {path.name for path in tmp_path.glob('*.broken-1')}
    assert aside == {f'scenes-s3-0000{index}.broken-1' for index in began if began.count(index) > 1}


def test_given_a_run_that_an_audit_finds_different_then_it_is_not_retried_and_ends_the_campaign(
    tmp_path
):
    def judge(request: RunRequest) -> RunResult:
        result = toy.result(request, Outcome.INFRA_ERROR)
        return dataclasses.replace(result, kind=AUDIT, detail='another rho')

    began: list[int] = []
    engine = drive(Same(tmp_path), judge, began)
    assert began == [0]
    assert engine.stopped == 'audit of run 0: another rho'


def test_given_an_interrupted_run_then_no_other_follows(tmp_path):
    began: list[int] = []
    engine = drive(
        Same(tmp_path), lambda request: toy.result(request, Outcome.INTERRUPTED), began
    )
    assert (began, engine.interrupted, engine.stopped) == ([0], True, '')


def test_given_runs_at_a_time_then_broken_ones_are_in_a_row_by_their_start_not_by_their_end(
    tmp_path
):
    with Engine(Once(tmp_path / 'c'), ('perception',)) as engine:
        first, whole, second, _ = requests = [engine.next() for _ in range(4)]
        for request in requests:
            (tmp_path / 'c' / request.run_id).mkdir()
        for request in (first, second):
            engine.take(request, toy.result(request, Outcome.INFRA_ERROR))
        assert not engine.stopped
        engine.take(whole, toy.result(whole))
        assert not engine.stopped


def test_given_a_network_that_is_replaced_meanwhile_then_its_runs_are_not_mixed(tmp_path):
    order = ProgramOrder(make_options(
        program='nominal', runs=2, seed=0, out=tmp_path / 'c', perception='taxinet', images='none'
    ))
    order.hear({}, RunResult(outcome=Outcome.PASS, fingerprint='a'))
    order.hear({}, RunResult(outcome=Outcome.INFRA_ERROR))
    with pytest.raises(UsageError, match='perception taxinet: changed during the campaign'):
        order.hear({}, RunResult(outcome=Outcome.FAIL, fingerprint='b'))


def test_given_a_network_that_is_replaced_meanwhile_then_no_trial_of_it_is_kept(tmp_path):
    task = Task(
        run_id='r', index=0, program='p', seed=0, scenario=Scenario(), judging=DEFAULT_JUDGING,
        participants=(), system=System(perception='n.safetensors'),
    )
    kept: list[Trial] = []
    trials = _Trials(iter(()), kept.append, lambda: False)
    trials.take(task, RunResult(outcome=Outcome.PASS, fingerprint='a'))
    trials.take(task, RunResult(outcome=Outcome.INFRA_ERROR, who='worker'))
    with pytest.raises(UsageError, match=r'perception n\.safetensors has changed'):
        trials.take(task, RunResult(outcome=Outcome.FAIL, fingerprint='b'))
    assert len(kept) == 2
