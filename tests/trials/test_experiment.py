"""Confirmation experiments: YAML files and what people get wrong in them, and resumption.

An experiment whose bench breaks stops there, and resumed it ends as if nothing had been.
"""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path

import falsify_samples as toy
import pandas as pd
import pytest

from taxinet_ros.analysis.experiment import report as experiment_report
from taxinet_ros.cli.run import campaign as campaign_command
from taxinet_ros.cli.run import experiment as command
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.source import SceneSource, program_text
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.experiment import (
    Arm,
    Experiment,
    arm_searches,
    check_paired,
    find_experiment,
    known_experiments,
    read_experiment,
    with_network,
)
from taxinet_ros.trials.record.facts import campaign_facts
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS, RunRow
from taxinet_ros.trials.record.table import read_table

GOOD = {
    'program': 's_falsif', 'runs': 5, 'perception': 'truth', 'sampler': 'halton',
    'set': '{clouds: clear, rain: 0, date: 2020-06-21}',
    'arms': '{a: {}, b: {set: {shadows: off, steering.heading_gain: 1.2}, perception: original}}',
}


def written(folder: Path, **changes: object) -> Path:
    values = {**GOOD, **changes}
    lines = [f'{key}: {value}' for key, value in values.items() if value is not None]
    path = folder / 'mine.yaml'
    path.write_text('\n'.join(lines) + '\n')
    return path


def test_given_a_file_then_its_arms_differ_in_what_they_set_only(tmp_path):
    one = read_experiment(written(tmp_path))
    a, b = one.arms
    assert (one.name, one.compare_to, one.seed, one.specs) == ('mine', 'a', 0, ('phi_eventually',))
    assert one.overrides == {'clouds': 'clear', 'rain_percent': '0', 'date': '2020-06-21'}
    assert (a.laid_over, a.gains, a.perception) == ({}, {}, 'truth')
    assert (b.laid_over, b.gains) == ({'shadows': 'off'}, {'heading_gain': 1.2})
    assert b.perception == 'original'
    searches = arm_searches(one, tmp_path / 'out', workers=2, resume=False)
    assert [s.campaign.out.name for s in searches.values()] == ['a', 'b']
    assert {s.campaign.images for s in searches.values()} == {'none'}
    assert searches['b'].campaign.overrides == searches['a'].campaign.overrides == one.overrides


def test_r11_given_controllers_then_each_arm_has_its_own_and_it_is_on_record(tmp_path):
    file = tmp_path / 'own.py'
    file.write_text('def steer(estimate): return 0.0, 5.0\n')
    one = read_experiment(written(
        tmp_path, controller=f'{file}:steer', arms='{a: {}, b: {controller: steering}}'
    ))
    assert [arm.controller for arm in one.arms] == [f'{file}:steer', 'steering']
    searches = arm_searches(one, tmp_path / 'out', workers=1, resume=False)
    program = find_program(one.program)
    text = program_text(program)
    recorded = [campaign_facts(search.campaign, program, text) for search in searches.values()]
    assert [facts['controller'] for facts in recorded] == [f'{file}:steer', 'steering']
    assert [len(facts['controller_sha256']) for facts in recorded] == [64, 0]


def test_given_the_shipped_experiments_then_each_varies_what_its_name_says():
    assert known_experiments() == ('crossing', 'light', 'shadows', 'shadows_afternoon')
    found = {name: read_experiment(find_experiment(name)) for name in known_experiments()}
    varied = {name: {key for arm in one.arms for key in arm.laid_over}
              for name, one in found.items()}
    assert varied == {'crossing': {'crossing'}, 'light': {'time_of_day_h'}, 'shadows': {'shadows'},
                      'shadows_afternoon': {'shadows'}}
    assert found['light'].arms[1].laid_over == {'time_of_day_h': '10'}
    with SceneSource(found['crossing'].program, seed=0) as source:
        starts = [source.scene(index).distance_m for index in range(20)]
    assert 1100 <= min(starts) < 1300
    assert 1500 < max(starts) <= 1700
    with SceneSource(found['shadows_afternoon'].program, seed=0) as source:
        scenes = [source.scene(index) for index in range(20)]
    assert min(scene.time_of_day_s for scene in scenes) > 12 * 3600
    assert {(scene.clouds, scene.rain_fraction) for scene in scenes} == {('clear', 0.0)}
    assert max(scene.distance_m for scene in scenes) <= 1000


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'program': None}, "the key 'program' is missing"),
        ({'program': 's_falsify'}, "program: program 's_falsify': no such file"),
        ({'runs': 0}, 'runs: expected a whole number, 1 or more, got 0'),
        ({'runs': 'many'}, "runs: expected a whole number, 1 or more, got 'many'"),
        ({'seed': -1}, 'seed: expected a whole number, 0 or more'),
        ({'sampler': 'ce'}, 'sampler: expected one of random, halton, sobol, grid, for all arms '
                            'need the same scenes; got ce'),
        ({'perception': 'nobody'}, "perception: perception: 'nobody' is unknown"),
        ({'specs': 'phi_never'}, 'specs: spec: unknown name'),
        ({'specs': '[1]'}, 'specs: expected a list of formulas'),
        ({'set': '{clouds: fog}'}, "set: override clouds=fog: clouds is 'fog'"),
        ({'set': '{cloud: clear}'}, "set: override cloud=clear: unknown key 'cloud'"),
        ({'set': '{rain: [1]}'}, 'set.rain: expected a number, a word, on or off'),
        ({'over': 'wind'}, 'over: expected one of cross_track'),
        ({'arms': '{on: {}, off: {}}'}, 'arms: expected words as keys, got True; put it in'),
        ({'arms': '{a: {}}'}, 'arms: expected two or more'),
        ({'arms': '[a, b]'}, 'arms: expected KEY: VALUE pairs'),
        ({'arms': '{a: {}, b/c: {}}'}, 'arms.b/c: expected a name of letters'),
        ({'arms': '{a: {}, b: {sets: {}}}'}, 'arms.b.sets: unknown key; known: set, perception, c'),
        (
            {'arms': '{a: {}, b: {set: {rain: 40}}}'},
            'arms.b.set: override clouds=clear rain_percent=40',
        ),
        ({'arms': '{a: {}, b: {set: {steering.gain: 1}}}'}, 'arms.b.set.steering.gain: unknown'),
        ({'arms': '{a: {}, b: {controller: nobody}}'}, "arms.b.controller: controller: 'nobody'"),
        ({'arms': '{a: {}, b: {controller: gone.py:steer}}'}, 'arms.b.controller: controller gone'),
        ({'controller': '"cmd:"'}, "controller: 'cmd:': names no program"),
        ({'arms': '{a: {set: {steering.heading_gain: 2}, controller: external}, b: {}}'},
         'arms.a.controller: steering.heading_gain: gains apply only'),
        ({'arms': '{a: {}, b: {perception: original}}', 'compare_to': 'c'},
         'compare_to: expected one of the arms'),
        ({'arms': '{a: {}, b: {}}'}, 'arms.b: runs the same as a, so there is nothing to compare'),
        ({'arms': '{a: {set: {rain: 40, clouds: broken}}, b: {perception: original}, '
                  'c: {set: {clouds: broken, rain_percent: 40.0}}}'}, 'arms.c: runs the same as a'),
        ({'arm': '{}'}, 'arm: unknown key; known: program, runs'),
        ({'runs': '3\nruns: 4'}, 'line 3, column 1: runs is given twice'),
        ({'set': '{clouds: '}, 'line '),
    ],
)
def test_given_a_mistake_then_one_line_has_file_key_and_what_is_expected(tmp_path, changes, words):
    path = written(tmp_path, **changes)
    with pytest.raises(UsageError) as error:
        read_experiment(path)
    text = str(error.value)
    assert text.startswith(f'{path}: ')
    assert words in text
    assert '\n' not in text


def test_given_no_such_file_or_a_used_folder_then_one_line_says_so(tmp_path):
    with pytest.raises(UsageError, match='no shipped experiment; known: crossing, light, shadows'):
        find_experiment('shadow')
    one = read_experiment(written(tmp_path))
    with pytest.raises(UsageError, match='already exists'):
        arm_searches(one, tmp_path, workers=1, resume=False)
    with pytest.raises(UsageError, match='holds no arm of mine'):
        arm_searches(one, tmp_path, workers=1, resume=True)
    with pytest.raises(UsageError, match='workers 0: '):
        arm_searches(one, tmp_path / 'new', workers=0, resume=False)


def test_given_a_choice_that_an_arm_fixes_then_points_still_give_the_same_scenes():
    free, fixed = (
        SceneSource('s_falsif', seed=4, laid_over=laid_over)
        for laid_over in ({}, {'time_of_day_h': '10'})
    )
    with free, fixed:
        assert len(free.space()) == len(fixed.space())
        point = free.space().point([0.37] * len(free.space()))
        for index in range(5):
            scene, other = (source.scene(index, point) for source in (free, fixed))
            assert scene != other
            assert dataclasses.replace(scene, time_of_day_s=36000.0) == other


def test_given_another_network_then_all_arms_have_it_unless_they_differ_in_theirs(tmp_path):
    experiment = read_experiment(find_experiment('shadows'))
    other = with_network(experiment, 'truth')
    assert {arm.perception for arm in experiment.arms} == {'original'}
    assert [arm.perception for arm in other.arms] == ['truth', 'truth']
    assert [arm.laid_over for arm in other.arms] == [arm.laid_over for arm in experiment.arms]
    with pytest.raises(UsageError, match='perception truth: the arms of mine differ in their'):
        with_network(read_experiment(written(tmp_path)), 'truth')
    with pytest.raises(UsageError, match='lost'):
        with_network(experiment, 'lost')


def row(index: int, **changes) -> RunRow:
    scene = {**Scenario(distance_m=300.0 + index).to_human(), **changes}
    return RunRow(run_id=f'r-{index}', index=index, program='p', seed=0, perception='truth',
                  outcome=Outcome.PASS, robustness=exact_intervals({'phi': 1.0}), **scene)


def test_given_arms_with_other_scenes_then_they_are_not_compared(tmp_path):
    one = read_experiment(written(tmp_path))
    same = {'a': (row(0), row(1)), 'b': (row(0, shadows=False), row(1, shadows=False))}
    check_paired(one, same)
    with pytest.raises(UsageError, match=r'run 1 has heading_deg 3.0 in b and 0.0 in a'):
        check_paired(one, {**same, 'b': (row(0, shadows=False), row(1, heading_deg=3.0))})
    # What has no effect without what an arm takes away is gone with it.
    calm = read_experiment(written(
        tmp_path, arms={'a': {'set': {'wind_speed': 5}}, 'b': {'set': {'wind_speed': 0}}}))
    check_paired(calm, {
        'a': (row(0, wind_speed_mps=5.0, wind_direction_deg=40.0),),
        'b': (row(0, wind_direction_deg=0.0),),
    })
    rejected = RunRow(run_id='r-1', index=1, program='p', seed=0, perception='truth',
                      outcome=Outcome.REJECTED)
    check_paired(one, {**same, 'b': (row(0), rejected)})


RUNS = 10
ARMS = ('shadows', 'no_shadows')
LAW = ('steering', 'steering')


class Bench:
    """Does the runs of all arms; those in ``broken`` break, by arm and index."""

    def __init__(self) -> None:
        self.broken: set[tuple[str, int]] = set()
        self.done: list[tuple[str, int]] = []
        self.reports = 0

    def run_search(self, search: Engine[search_module.Search], crew: object) -> None:
        arm = search.options.out.name

        def judge(request: RunRequest) -> RunResult:
            self.done.append((arm, request.index))
            broken = (arm, request.index) in self.broken
            return toy.result(request, Outcome.INFRA_ERROR if broken else None)

        for _ in toy.answers(search, 2, judge=judge):
            pass

    def report(self, *_: object) -> tuple[dict[str, object], list[str]]:
        self.reports += 1
        return {}, []


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    bench = Bench()
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)
    monkeypatch.setattr(campaign_command, 'run_search', bench.run_search)
    monkeypatch.setattr(campaign_command, 'WorkerPool', lambda *arguments: contextlib.nullcontext())
    monkeypatch.setattr(experiment_report, 'write_experiment', bench.report)
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
        assert 'broken by the bench; continue with --resume' in capsys.readouterr().out
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
