"""The stages of a study are the paper's, and every one can be done by hand."""

from __future__ import annotations

import dataclasses
import shutil
from inspect import signature
from pathlib import Path

import pytest
from studies import smoke_config
from typer.main import get_command

from taxinet_ros.cli.main import app
from taxinet_ros.cli.study.stages import call_stage
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import SAMPLERS
from taxinet_ros.scenes.programs import find_program, shipped_folder
from taxinet_ros.study.stages.config import read_config, shipped_config
from taxinet_ros.study.stages.plan import (
    NETWORKS,
    PAPER_RULE,
    learned_program,
    stages,
    stages_until,
    weights_of,
)
from taxinet_ros.study.stages.stage import with_engine
from taxinet_ros.trials.search import Search

SHIPPED = read_config(shipped_config())
FOUND = {stage.name: stage for stage in stages(SHIPPED)}
LEARNED_PROGRAM = learned_program(SHIPPED)


def command(name: str) -> str:
    return ' '.join(FOUND[name].words())


@pytest.mark.parametrize('name', FOUND)
def test_given_a_stage_then_taxinet_knows_its_words(name):
    first, *words = FOUND[name].words(resume=True)
    known = get_command(app).commands[first]
    known.make_context(first, list(words))


@pytest.mark.ros
@pytest.mark.parametrize('name', [
    'train-halton', 'train-specialised', 'train-iterative-crossing', 'evaluate-best',
    'learn-ce-verifai-2',
])
def test_given_a_stage_then_its_function_has_the_options_of_its_command(
    name, tmp_path, monkeypatch
):
    asked: list[object] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('taxinet_ros.cli.run.search.run_falsify',
                        lambda search, **_: asked.append(asked_of(search)) or 0)
    monkeypatch.setattr('taxinet_ros.cli.training.train.run_train', asked.append)
    stage, = with_engine([FOUND[name]], 'loop', '5')
    if stage.command == 'falsify':  # with a network that is there
        stage = dataclasses.replace(stage, options={**stage.options, 'perception': 'original'})
    assert call_stage(stage, False) == 0
    app(list(stage.words()))
    assert asked[0] == asked[1]


def asked_of(search):
    """All that a search was made from."""
    return [vars(search)[name] for name in signature(Search).parameters]


def test_given_the_stages_then_each_stands_after_what_it_needs():
    made: set[str] = set()
    for stage in FOUND.values():
        assert set(stage.inputs) - {LEARNED_PROGRAM} <= made
        assert set(stage.programs) - {LEARNED_PROGRAM} <= {
            'training_original', 's_falsif', 's_falsif_ce', 'runway_position', 'crossing'}
        made |= set(stage.outputs)


def test_given_the_trainings_then_sizes_and_seed_are_the_same_for_all():
    shared = ' --images 12000 --validation 1500 --epochs 20 --batch 64 --seed 1 '
    names = [network for network in NETWORKS if network != 'best']
    assert len(names) == 7
    assert all(shared in command(f'train-{network}') for network in names)


def test_given_the_evaluations_then_all_networks_have_the_same_scenes():
    campaigns = [name for name in FOUND if name.startswith(('evaluate-', 'falsify-'))]
    assert len(campaigns) == 8
    for name in campaigns:
        assert command(name).startswith('falsify s_falsif --sampler random --seed 0 --perception ')
        assert ' --runs 4000 ' in command(name)


def test_given_further_training_then_it_begins_with_the_generic_network_and_adds_a_fifth():
    start = f'--start {weights_of("generic")}'
    for kind, program in (
        ('generic', 's_falsif'), ('crossing', 'crossing'), ('learned', LEARNED_PROGRAM),
    ):
        words = command(f'train-iterative-{kind}')
        assert words.startswith('train s_falsif ')
        assert f'{start} --add {program}=2400' in words


def test_t14_study_given_the_searches_then_there_is_one_for_each_rule_and_seed():
    searches = {name: command(name) for name in FOUND if name.startswith('learn-')}
    assert len(searches) == 10
    for sampler in ('ce', 'ce-verifai'):
        for seed in (2, 3, 4, 5, 6):
            words = searches[f'learn-{sampler}-{seed}']
            rule = ' --sampler-option rule=verifai' if sampler == PAPER_RULE else ''
            assert words.startswith(f'falsify s_falsif_ce --sampler ce{rule} --seed {seed} ')
            assert f'--perception {weights_of("generic")} ' in words
            assert ' --runs 1200 ' in words
    assert LEARNED_PROGRAM == 'learn-ce-verifai-2/learned.scenic'
    assert SAMPLERS['ce'].rules['verifai'].options['alpha'].default == 0.9  # VerifAI's own


def test_the_third_arm_trains_on_what_the_papers_rule_learned_where_there_is_a_search_by_it():
    learned = {
        samplers: learned_program(dataclasses.replace(SHIPPED, samplers=samplers))
        for samplers in (('ce', 'ce-verifai'), ('ce-verifai', 'ce'), ('mab', 'ce'))
    }
    assert [Path(path).parent.name for path in learned.values()] == [
        'learn-ce-verifai-2', 'learn-ce-verifai-2', 'learn-mab-2']
    assert FOUND['train-iterative-learned'].needs == 'learn-ce-verifai-2/learned.scenic'


def test_given_until_then_the_stages_end_there_and_an_unknown_one_lists_them():
    found = tuple(FOUND.values())
    assert [stage.name for stage in stages_until(found, 'falsify-original')] == [
        'train-original', 'falsify-original']
    with pytest.raises(UsageError, match='until lunch: no such stage; known: train-original, '):
        stages_until(found, 'lunch')


def test_given_a_program_or_its_world_that_changed_then_keys_differ(tmp_path):
    out, folder = tmp_path, tmp_path / 'programs'
    shutil.copytree(shipped_folder(), folder)
    program = folder / 's_falsif.scenic'
    config = smoke_config()
    first = train(config, program).key(out)
    assert train(config, program).key(out) == first
    world = folder / 'runway_world.scenic'
    world.write_text(world.read_text() + '# other\n')
    second = train(config, program).key(out)
    program.write_text(program.read_text() + '# other\n')
    assert len({first, second, train(config, program).key(out)}) == 3
    assert find_program(program) == program


def train(config, program: Path):
    config = dataclasses.replace(config, generic=str(program))
    return next(stage for stage in stages(config) if stage.name == 'train-generic')


def test_given_more_runs_then_the_key_is_another_and_the_identity_the_same(tmp_path):
    config = smoke_config()
    few, many = (
        next(stage for stage in stages(dataclasses.replace(config, runs=runs))
             if stage.name == 'evaluate-best')
        for runs in (20, 30)
    )
    assert few.key(tmp_path) != many.key(tmp_path)
    assert few.identity(tmp_path) == many.identity(tmp_path)
    other = dataclasses.replace(few, perception='original')
    assert other.identity(tmp_path) != few.identity(tmp_path)


def test_given_an_engine_then_campaigns_run_on_it_and_their_results_are_the_same(tmp_path):
    found = stages(smoke_config())
    assert with_engine(found, 'graph', None) == found
    by_loop = with_engine(found, 'loop', '5')
    words = ('--engine', 'loop', '--audit', '5')
    for one, other in zip(found, by_loop, strict=True):
        runs = one.command in ('falsify', 'experiment')
        assert other.words() == (*one.words(), *(words if runs else ()))
    assert train(smoke_config(), find_program('s_falsif')).command == 'train'
    few, many = (
        next(stage for stage in every if stage.name == 'evaluate-best')
        for every in (found, by_loop)
    )
    assert few.key(tmp_path) == many.key(tmp_path)
    there = with_engine(found, 'loop', None, 'tcp://10.0.0.1:8786')
    for one, other in zip(found, there, strict=True):
        runs = one.command in ('falsify', 'experiment')
        assert ('--cluster' in other.words()) == runs
        assert runs <= ('--workers' not in other.words())
    with pytest.raises(UsageError, match='audit 5: no effect with engine graph'):
        with_engine(found, 'graph', '5')
