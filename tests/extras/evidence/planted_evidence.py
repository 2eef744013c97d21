"""Campaigns and a judged monitor with known outcomes, without bags, whose checksums hold."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import pytest
from campaign_records import write_campaign

import taxinet_ros as tx
from taxinet_ros.core.mtl import RobustnessInterval, exact_intervals
from taxinet_ros.core.perception.weights import SHIPPED, load_card
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.extras.assurance import judge as judging
from taxinet_ros.trials.past_runs.trials import Trial, TrialPool
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.worker_pool import Task

PROGRAM = '# --- planted.scenic ---\nmodel runway_world\n# --- runway_world.scenic ---\nego = 1\n'
SHA = {
    word: load_card(SHIPPED[word].with_suffix('.json')).weights_sha256
    for word in ('original', 'taxinet')
}
PASS, FAIL, INFRA = Outcome.PASS, Outcome.FAIL, Outcome.INFRA_ERROR
UNDECIDED = 'undecided'
"""A run that fails another formula and was stopped before this one was decided."""


def row(index: int, outcome: Outcome | str, *, seed: int, perception: str, drawn: bool,
        rho: float | None) -> RunRow:
    """A run; rho is 1 or -1 if not given."""
    undecided = outcome == UNDECIDED
    real = FAIL if undecided else Outcome(outcome)
    value = rho if rho is not None else 1.0 if real is PASS else -1.0
    robustness = exact_intervals({'phi': value}) if real.judged else {}
    if undecided:
        robustness = {
            'phi': RobustnessInterval(-2.0, 3.0), 'other': RobustnessInterval(-9.0, -1.0),
        }
    return RunRow(
        run_id=f'planted-s{seed}-{index:05d}', index=index, program='planted', seed=seed,
        perception=perception, fingerprint=SHA.get(perception, ''), outcome=real,
        sampler='random' if drawn else 'ce', drawn=drawn, robustness=robustness,
        stopped_early=True if undecided else None, stopped_s=1.0 if undecided else None,
        left_runway=None if undecided or not real.judged else real is FAIL,
        kind='' if real.judged else 'timeout', who='' if real.judged else 'perception',
        **tx.Scenario(cross_track_m=float(index % 8), distance_m=100.0 * seed + index).to_human(),
    )


def planted(
    folder: Path, outcomes: Sequence[Outcome | str], *, seed: int = 0, perception: str = 'original',
    drawn: bool | Sequence[bool] = True, rho: Sequence[float] | None = None, finished: bool = True,
    planned: int | None = None, **facts: object,
) -> Path:
    """Write a finished campaign of these outcomes, in order."""
    specs = {'phi': 'always((abs(cte) <= 1.5))'}
    if UNDECIDED in outcomes:
        specs['other'] = 'always((abs(cte) <= 9))'
    each = [drawn] * len(outcomes) if isinstance(drawn, bool) else drawn
    rows = [
        row(index, outcome, seed=seed, perception=perception, drawn=each[index],
            rho=rho[index] if rho else None)
        for index, outcome in enumerate(outcomes)
    ]
    told = {
        'taxinet_ros_version': '0.1.0',
        'stacks': {'12345678': {'python': '3.11.7', 'taxinet_ros': '0.1.0', 'commit': 'f' * 40}},
        'program': 'planted.scenic', 'program_text': PROGRAM,
        'program_sha256': hashlib.sha256(PROGRAM.encode()).hexdigest(), 'seed': seed,
        'runs': len(rows), 'first_runs': planned or len(rows), 'perception': perception,
        'perception_sha256': SHA.get(perception, ''), 'controller': 'steering',
        'controller_sha256': '', 'gains': {}, 'specs': specs, 'world': 'kmwh', 'timing': '',
        'engine': 'loop', 'audit_percent': 0.0, 'images': 'none',
        'sampler': 'random' if all(each) else 'ce', **facts,
    }
    begun = () if finished else [len(rows)]
    return write_campaign(folder, rows, told, begun=begun, ended=finished)


def trial(task: Task, *, satisfied: bool, alarm_s: float | None) -> Trial:
    """A run of a monitor's judgement."""
    return Trial(
        run_id=task.run_id, word=task.word, passed=satisfied, left_runway=False,
        robustness=RobustnessInterval.exactly(1.0 if satisfied else -1.5), seen={
            'duration_s': 30.0, 'due_s': None if satisfied else 12.0, 'reached': True,
            'off_s': None, 'alarm_s': alarm_s, 'reason': 'unseen' if alarm_s else '',
            'alarms_s': [alarm_s] * len(judging.FACTORS),
        },
    )


def judged_monitor(folder: Path, perception: str = 'original', monitor: str = 'original') -> Path:
    """What the command itself writes of three scenes whose runs are made up."""
    alarms_s = [None, 11.0, 13.0]

    def run(pool, tasks, take, interrupted) -> None:
        for task in tasks:
            satisfied = task.index == 0 or (task.index == 1 and task.run_id.endswith('-stop'))
            take(trial(task, satisfied=satisfied, alarm_s=alarms_s[task.index]))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judging, 'draw_scenes', lambda *_, **__: [
            tx.Scenario(cross_track_m=float(number)) for number in range(len(alarms_s))
        ])
        patch.setattr(TrialPool, 'run', run)
        judging.judge(judging.JudgeOptions(
            program='s_falsif', perception=perception, controller='steering', monitor=monitor,
            fallbacks=('stop',), runs=len(alarms_s), seed=4, workers=1, out=folder,
        ), lambda *_: None)
    return folder
