"""An experiment whose bench breaks stops there, and resumed it ends as if nothing had been."""

from __future__ import annotations

import contextlib
from pathlib import Path

import falsify_samples as toy
import pandas as pd
import pytest

from taxinet_ros.campaign import search as search_module
from taxinet_ros.campaign.experiment_file import Arm, Experiment
from taxinet_ros.campaign.table import WALL_CLOCK_COLUMNS, read_table
from taxinet_ros.cli import experiment as command
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult

RUNS = 10
ARMS = ('shadows', 'no_shadows')
LAW = ('steering', 'steering')


class Bench:
    """Does the runs of all arms; those in ``broken`` break, by arm and index."""

    def __init__(self) -> None:
        self.broken: set[tuple[str, int]] = set()
        self.done: list[tuple[str, int]] = []
        self.reports = 0

    def run_search(self, search: search_module.Search, crew: object) -> None:
        arm = search.options.campaign.out.name

        def judge(request: RunRequest) -> RunResult:
            self.done.append((arm, request.index))
            broken = (arm, request.index) in self.broken
            return toy.result(request, Outcome.INFRA_ERROR if broken else None)

        for _ in toy.answers(search, 2, judge=judge):
            pass

    def report(self, *arguments: object, **others: object) -> None:
        self.reports += 1


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    bench = Bench()
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)
    monkeypatch.setattr(command, 'run_search', bench.run_search)
    monkeypatch.setattr(command, 'Crew', lambda *arguments: contextlib.nullcontext())
    monkeypatch.setattr(command, '_report', bench.report)
    return bench


def run(out: Path, *, resume: bool = False, controllers: tuple[str, str] = LAW) -> int:
    experiment = Experiment(
        name='light', program='nominal', runs=RUNS, seed=3, sampler='halton', sampler_options={},
        specs=('phi_eventually',), overrides={},
        arms=tuple(
            Arm(name=name, perception='truth', controller=controller)
            for name, controller in zip(ARMS, controllers, strict=True)
        ),
        compare_to=ARMS[0], over='',
    )
    return command.run_experiment(experiment, out, workers=2, resume=resume, as_json=False)


def test_f1_given_an_arm_that_broke_then_no_other_is_begun_and_resumed_it_is_as_if_not(
    bench, tmp_path, capsys
):
    whole, out = tmp_path / 'whole', tmp_path / 'c'
    assert run(whole) == 0
    assert bench.reports == 1
    sound = len(set(bench.done))
    for arm in ARMS:
        bench.broken, bench.done = {(arm, index) for index in range(4, RUNS)}, []
        capsys.readouterr()
        assert run(out, resume=arm != ARMS[0]) == 4
        assert 'broken by the bench; --resume goes on' in capsys.readouterr().out
        assert {name for name, _ in bench.done} <= set(ARMS[:ARMS.index(arm) + 1])
        assert bench.reports == 1, 'nothing is compared before all is there'
    bench.broken, bench.done = set(), []
    assert run(out, resume=True) == 0
    assert bench.reports == 2
    assert 0 < len(bench.done) < sound
    but = [*WALL_CLOCK_COLUMNS, 'retries']
    for arm in ARMS:
        one, other = (read_table(folder / arm).drop(columns=but) for folder in (whole, out))
        assert len(one) == RUNS
        pd.testing.assert_frame_equal(one, other)


def test_f1_given_an_experiment_killed_before_its_first_line_when_resumed_then_it_begins(
    bench, tmp_path
):
    (tmp_path / 'c' / ARMS[0]).mkdir(parents=True)
    assert run(tmp_path / 'c', resume=True) == 0
    for folder in ('nothing', 'other'):
        (tmp_path / 'other' / 'photos').mkdir(parents=True, exist_ok=True)
        with pytest.raises(UsageError, match='holds no arm of light'):
            run(tmp_path / folder, resume=True)


def test_r11_given_an_arm_with_a_controller_of_its_own_when_that_changes_then_resume_refuses(
    bench, tmp_path
):
    file, out = tmp_path / 'own.py', tmp_path / 'c'
    file.write_text('def steer(estimate): return 0.0, 5.0\n')
    own = ('steering', f'{file}:steer')
    bench.broken = {(ARMS[1], index) for index in range(4, RUNS)}
    assert run(out, controllers=own) == 4
    assert bench.reports == 0
    with pytest.raises(UsageError, match=r'controller.*steering'):
        run(out, resume=True, controllers=LAW)
    file.write_text('def steer(estimate): return 0.1, 5.0\n')
    with pytest.raises(UsageError, match='controller_sha256'):
        run(out, resume=True, controllers=own)
    file.write_text('def steer(estimate): return 0.0, 5.0\n')
    bench.broken = set()
    assert run(out, resume=True, controllers=own) == 0
