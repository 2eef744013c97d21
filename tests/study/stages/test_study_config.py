"""The numbers of a study: from its file, scaled, and refused with one line where they are wrong."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import typed
from taxinet_ros.study.stages.config import (
    StudyConfig,
    read_config,
    scaled,
    shipped_config,
)
from taxinet_ros.study.stages.run import OPTIONS, open_study, read_options

SHIPPED = read_config(shipped_config())


def written(folder: Path, text: str) -> Path:
    path = folder / 'mine.yaml'
    path.write_text(text)
    return path


def test_given_the_shipped_study_then_its_sizes_are_the_paper_s():
    assert (SHIPPED.runs, SHIPPED.learning_runs, SHIPPED.epochs) == (4000, 1200, 20)
    assert (SHIPPED.added, SHIPPED.further_epochs) == (2400, 20)
    assert SHIPPED.training_seed != SHIPPED.seed
    assert not {SHIPPED.training_seed, SHIPPED.seed} & set(SHIPPED.learning_seeds)


def test_t14_study_given_the_shipped_one_then_it_learns_by_both_rules_with_five_seeds_each():
    assert SHIPPED.samplers == ('ce', 'ce-verifai')
    assert len(set(SHIPPED.learning_seeds)) == 5


def test_t14_study_given_one_sampler_and_seed_then_there_is_one_search(tmp_path):
    own = read_config(written(tmp_path, 'learning: {sampler: mab, seed: 7}'))
    assert (own.samplers, own.learning_seeds) == (('mab',), (7,))


def test_given_a_file_that_says_little_then_the_rest_is_as_shipped(tmp_path):
    own = read_config(written(tmp_path, 'evaluation: {runs: 50}\nbest: truth\n'))
    assert own == dataclasses.replace(SHIPPED, runs=50, best='truth')


def test_given_programs_beside_the_file_then_they_are_found_from_anywhere(tmp_path, monkeypatch):
    (tmp_path / 'near.scenic').write_text('model runway_world\nego = new Plane at (0, 9)\n')
    monkeypatch.chdir('/')
    own = read_config(written(tmp_path, 'evaluation: {program: near.scenic}'))
    assert own.program == str(tmp_path / 'near.scenic')


@pytest.mark.parametrize(('text', 'complaint'), [
    ('evaluation: {runs: many}', "evaluation.runs: expected a whole number, 1 to 10000000, got 'm"),
    ('evaluation: {runs: 0}', 'evaluation.runs: expected a whole number'),
    ('evaluation: {runs: true}', 'evaluation.runs: expected a whole number'),
    ('evaluation: {walks: 3}', 'evaluation.walks: unknown key; known: program, runs'),
    ('evolution: {runs: 3}', 'evolution: unknown key; known: best, debugging, evaluation, '),
    ('evaluation: 3',
     'evaluation: expected KEY: VALUE pairs with the keys program, runs, seed, got 3'),
    ('- 3', 'expected KEY: VALUE pairs'),
    ('evaluation: {program: s_false}', "evaluation.program: program 's_false': no such file"),
    ('debugging: {experiments: {moon: 3}}', "debugging.experiments.moon: experiment 'moon'"),
    ('debugging: {experiments: {off: 3}}', 'debugging.experiments: expected words as keys, got F'),
    ('learning: {sampler: random}', 'learning.sampler: expected a sampler that learns a'),
    ('learning: {sampler: [ce, random]}', 'learning.sampler: expected a sampler that learns'),
    ('learning: {sampler: []}', 'learning.sampler: expected one or several, each once, got []'),
    ('learning: {seed: [3, 3]}', 'learning.seed: expected one or several, each once, got [3, 3]'),
    ('learning: {seed: [3, x]}', 'learning.seed: expected a whole number, 0 to '),
    ('learning: {seed: [3, 1]}', 'is 1, as learning.seed is; choose another'),
    ('iteration: {share: 0}', 'iteration.share: expected a number above 0, at most 10, got 0'),
    ('iteration: {share: .nan}', 'iteration.share: expected a number above 0'),
    ('best: worst', "best: perception: 'worst' is unknown; known: truth, "),
    ('evaluation: {seed: 1}', 'is 1, as evaluation.seed is; choose another'),
    ('workers: 9', 'workers: expected a whole number, 1 to 8, got 9'),
    ('workers: 1\nworkers: 2', 'line 2, column 1: workers is given twice'),
])
def test_given_a_mistake_then_one_line_names_file_key_and_how_to_fix_it(
    tmp_path, text, complaint
):
    path = written(tmp_path, text)
    with pytest.raises(UsageError) as error:
        read_config(path)
    words = str(error.value)
    assert words.startswith(f'{path}: ')
    assert complaint in words
    assert '\n' not in words


def test_given_no_such_file_then_the_option_is_named(tmp_path):
    with pytest.raises(UsageError, match=r'config .*: cannot be read: No such file'):
        read_config(tmp_path / 'gone.yaml')


@given(st.floats(0.001, 50))
def test_given_any_scale_then_no_size_is_less_than_a_smoke_run_needs(scale):
    small = scaled(SHIPPED, scale)
    assert small.images >= 128
    assert small.validation >= 32
    assert small.runs >= 20
    assert min(small.experiments.values()) >= 10
    assert 2 <= small.epochs <= 20
    assert abs(small.images - 12_000 * scale) <= 128


def test_given_scales_then_epochs_are_all_there_from_a_tenth_on():
    assert [scaled(SHIPPED, scale).epochs for scale in (0.02, 0.05, 0.1, 1)] == [4, 10, 20, 20]


@pytest.mark.parametrize('scale', [0.0, -1.0, 101.0, float('nan')])
def test_given_no_scale_at_all_then_it_is_refused(scale):
    with pytest.raises(UsageError, match=r'scale .*: needs to be above 0'):
        scaled(SHIPPED, scale)


def test_given_a_study_that_was_begun_then_its_numbers_come_back(tmp_path):
    small = scaled(SHIPPED, 0.02)
    with open_study(tmp_path, print) as record:
        record.put(OPTIONS, 'case-study', dataclasses.asdict(small))
    assert typed(StudyConfig, read_options(tmp_path, 'case-study', 'resume')) == small
    for folder, command in ((tmp_path, 'improve'), (tmp_path / 'elsewhere', 'case-study')):
        refusal = f'report_only: {folder}: no study of taxinet {command}'
        with pytest.raises(UsageError, match=refusal):
            read_options(folder, command, 'report_only')
