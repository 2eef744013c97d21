"""Which runs are audited, what counts as a difference, and what follows from one."""

from __future__ import annotations

import dataclasses
import shutil
from collections import Counter
from pathlib import Path

import pytest

from taxinet_ros.api.run import run
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.facts import made_on
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.provenance import COMMIT
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.system import System
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.audit import bag_difference, is_audited, result_difference
from taxinet_ros.trials.options import check_engine


@pytest.mark.parametrize(('percent', 'every'), [(1.0, 100), (50.0, 2), (33.0, 3), (100.0, 1)])
def test_given_a_share_then_one_run_in_every_so_many_is_audited_and_the_first(percent, every):
    for seed in (0, 7):
        chosen = [index for index in range(20 * every) if is_audited(seed, index, percent)]
        assert chosen[0] == 0
        assert Counter(index // every for index in chosen) == Counter(range(20))
    places = {index % every for index in chosen}
    assert len(places) > 1 or every == 1, 'a period of the scenes must not hide from it'
    assert not any(is_audited(0, index, 0.0) for index in range(1000))


@pytest.mark.parametrize(('text', 'percent'), [
    (None, 1.0), ('0', 0.0), ('0.5', 0.5), ('2 %', 2.0), ('100%', 100.0),
])
def test_given_a_percentage_then_it_is_read(text, percent):
    assert check_engine('loop', text, System(perception='truth')) == percent
    elsewhere = System(perception='external', controller='cmd:mine')
    assert check_engine('graph', None, elsewhere) == 0.0


@pytest.mark.parametrize(('words', 'said'), [
    (('sail', None, 'truth', 'steering'), 'engine sail: unknown; known: graph, loop'),
    (('graph', '1', 'truth', 'steering'), 'audit 1: no effect with engine graph'),
    (('loop', '101', 'truth', 'steering'), 'audit 101: expected a percentage'),
    (('loop', 'nan', 'truth', 'steering'), 'audit nan: expected a percentage'),
    (('loop', 'some', 'truth', 'steering'), 'audit some: expected a percentage'),
    (('loop', None, 'external', 'steering'), 'engine loop: perception external is a node'),
    (('loop', None, 'truth', 'cmd:mine --fast'), 'engine loop: controller cmd:mine --fast is a'),
])
def test_given_what_the_engine_cannot_do_then_it_is_refused_by_name(words, said):
    engine, audit, perception, controller = words
    with pytest.raises(UsageError, match=said):
        check_engine(engine, audit, System(perception=perception, controller=controller))


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    scene = Scenario(cross_track_m=2.0, duration_s=1.0)
    return run(scene).save_bag(tmp_path_factory.mktemp('one') / 'run', images=False)


def test_given_bags_then_the_first_difference_is_the_earliest_in_simulated_time(bag, tmp_path):
    same = shutil.copytree(bag, tmp_path / 'same' / 'run')
    assert bag_difference(bag, same) == ''

    scene = Scenario(cross_track_m=2.0, duration_s=1.0)
    steps: list[float] = []

    def late(truth: object) -> tuple[float, float]:
        steps.append(0.0)
        return truth.cte_m + (1e-12 if len(steps) == 8 else 0.0), truth.he_rad

    late.needs_image, late.word = False, 'truth'
    other = run(scene, perception=late).save_bag(tmp_path / 'late' / 'run', images=False)
    assert bag_difference(bag, other).startswith('/perception/tracking_error, step 7, cross_track')

    short = dataclasses.replace(scene, duration_s=0.5)
    other = run(short).save_bag(tmp_path / 'short' / 'run', images=False)
    assert bag_difference(bag, other).startswith('/scenario, step 0, duration_s: ')



def test_given_code_that_was_edited_meanwhile_then_the_difference_says_so(bag, tmp_path):
    same = shutil.copytree(bag, tmp_path / 'same' / 'run')
    told = same / 'metadata.yaml'
    commit = made_on(read_info(bag))[COMMIT]
    told.write_text(told.read_text().replace(commit, 'f' * 12))
    assert bag_difference(bag, same) == (
        'the same messages, but their workers loaded different code: '
        f'commit {commit} | {"f" * 12}')

    told.write_text(told.read_text().replace('f' * 12, commit) + '\n')
    assert bag_difference(bag, same).endswith('not the same bytes: metadata.yaml')


def test_given_results_then_all_but_their_time_is_compared():
    one = RunResult(
        outcome=Outcome.PASS, last_seq=9, robustness={'a': RobustnessInterval(1.0, 1.0)}, wall_s=1.0
    )
    assert result_difference(one, dataclasses.replace(one, wall_s=2.0)) == ''
    other = dataclasses.replace(one, robustness={'a': RobustnessInterval(1.0, 1.0 + 2**-52)})
    assert result_difference(one, other).startswith('robustness: ')
