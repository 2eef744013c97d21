from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from training_samples import foreign_folder

from taxinet_ros.core.perception.domain import domain_of_scenes, joined_domains
from taxinet_ros.core.perception.network import ARCHITECTURES, DEFAULT_ARCHITECTURE, TaxiNet
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.perception.weights import Source, digest, load_model
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.source import program_digest
from taxinet_ros.training.data.dataset import draw_scenes, make_dataset, no_progress
from taxinet_ros.training.data.dataset_folder import DatasetOptions, write_dataset
from taxinet_ros.training.data.image_folder import folders_domain, load_folders
from taxinet_ros.training.data.portions import parse_portion
from taxinet_ros.training.options import TrainOptions
from taxinet_ros.training.train import IMAGES, get_training_data, train
from taxinet_ros.version import __version__


def options(out: Path, **changes: object) -> TrainOptions:
    tiny = TrainOptions(
        program='nominal', out=out, images=12, validation=4, epochs=2, batch=4, workers=1, seed=7
    )
    return dataclasses.replace(tiny, **changes)


def from_data(out: Path, *folders: Path, **changes: object) -> TrainOptions:
    return options(out, program=None, data=folders, validation=2, **changes)


def test_given_a_tiny_training_when_done_twice_then_weights_are_equal_and_the_card_complete(
    tmp_path: Path,
) -> None:
    stages: list[str] = []
    first = tmp_path / 'first.safetensors'
    card = train(options(first), progress=lambda stage, done, total: stages.append(stage))
    again = tmp_path / 'again.safetensors'
    train(options(again))
    assert again.read_bytes() == first.read_bytes()
    assert stages == ['scenes'] * 16 + [IMAGES] * 16 + ['epochs'] * 2
    assert load_model(first).card == card
    assert make_perception(str(first)).fingerprint == card.weights_sha256
    assert card.weights_sha256 == digest(first.read_bytes())
    program = Source(kind='program', name='nominal', sha256=program_digest(find_program('nominal')))
    assert (card.training_data, card.validation_data) == ((program,), ())
    assert (card.seed, card.images, card.validation) == (7, 12, 4)
    assert (card.varied, card.augment, card.patience) == (False, False, 0)
    assert (card.epochs, card.batch, card.package_version) == (2, 4, __version__)
    shown = draw_scenes('nominal', seed=7, images=12)
    assert card.domain == domain_of_scenes(scene.to_human() for scene in shown)
    assert card.domain['camera'] == ('wing',)
    assert card.command_line == (
        'taxinet train nominal --images 12 --validation 4 --epochs 2 --batch 4 '
        '--learning-rate 0.003 --seed 7 --out first.safetensors'
    )
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [
        f'{name}.{suffix}' for name in ('again', 'first')
        for suffix in ('csv', 'json', 'png', 'safetensors')
    ]
    rows = list(csv.DictReader((tmp_path / 'first.csv').read_text().splitlines()))
    assert [row['number'] for row in rows] == ['1', '2']
    best = rows[card.best_epoch - 1]
    assert float(best['cte_mae_m']) == pytest.approx(card.errors['cte_m']['mae'], abs=1e-4)
    assert float(best['validation_loss']) == min(float(row['validation_loss']) for row in rows)
    assert (tmp_path / 'first.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.nightly
def test_given_a_foreign_folder_when_trained_on_then_rows_are_held_back_by_seed(
    tmp_path: Path,
) -> None:
    folder = foreign_folder(tmp_path / 'photos', images=8)
    cards = [
        train(from_data(tmp_path / f'{name}.safetensors', folder, seed=seed))
        for name, seed in (('one', 1), ('two', 1), ('three', 2))
    ]
    assert cards[0].weights_sha256 == cards[1].weights_sha256 != cards[2].weights_sha256
    assert (cards[0].images, cards[0].validation) == (6, 2)
    assert [(data.kind, data.name) for data in cards[0].training_data] == [('folder', 'photos')]
    assert cards[0].command_line == (
        f'taxinet train {folder} --validation 2 --epochs 2 --batch 4 '
        '--learning-rate 0.003 --seed 1 --out one.safetensors'
    )


def test_given_a_folder_to_measure_on_when_trained_then_nothing_is_held_back(
    tmp_path: Path,
) -> None:
    one, two, other = (foreign_folder(tmp_path / name, images=4) for name in ('a', 'b', 'c'))
    out = tmp_path / 'net.safetensors'
    card = train(from_data(out, one, two, validation_data=other, augment=True))
    assert (card.images, card.validation) == (8, 4)
    assert [data.name for data in card.training_data] == ['a', 'b']
    assert [data.name for data in card.validation_data] == ['c']
    assert card.augment
    assert card.command_line == (
        f'taxinet train {one} {two} --validation-data {other} --augment --epochs 2 --batch 4 '
        '--learning-rate 0.003 --seed 7 --out net.safetensors'
    )
    assert load_model(out).card == card


def test_given_portions_when_added_then_the_card_tells_and_the_validation_grows_in_proportion(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'net.safetensors'
    card = train(options(out, add=(parse_portion('crossing=6', 'program'),), sampler='halton'))
    assert (card.images, card.validation) == (12 + 6, 4 + 2)
    assert [(data.kind, data.name) for data in card.training_data] == [
        ('program', 'nominal'), ('program', 'crossing'),
    ]
    assert card.command_line.startswith(
        'taxinet train nominal --sampler halton --add crossing=6 --images 12 --validation 4 '
    )
    assert load_model(out).card == card


@pytest.mark.nightly
def test_given_something_added_then_the_pictures_of_the_set_itself_stay_the_same(
    tmp_path: Path,
) -> None:
    alone, more, other = (
        get_training_data(options(tmp_path / 'net.safetensors', **changes), no_progress)
        for changes in (
            {}, {'add': (parse_portion('nominal=3', 'program'),)},
            {'program': 'crossing', 'validation_program': 'nominal'},
        )
    )
    assert np.array_equal(more.training.pictures[:12], alone.training.pictures)
    assert np.array_equal(more.validation.pictures[:4], alone.validation.pictures)
    assert (len(more.training), len(more.validation)) == (15, 5)
    # Three more scenes of the same program, and none of them a scene of the set.
    assert not set(more.training.cte_m[12:]) & set(alone.training.cte_m)
    # The validation program gives what a training on it would have held back.
    assert np.array_equal(other.validation.pictures, alone.validation.pictures)
    assert not np.array_equal(other.training.pictures, alone.training.pictures)
    assert [data.name for data in other.validation_data] == ['nominal']


@pytest.mark.nightly
def test_given_weights_to_begin_from_then_training_goes_on_from_them(tmp_path: Path) -> None:
    first = train(options(tmp_path / 'first.safetensors', epochs=4))
    small_steps = {'seed': 8, 'epochs': 1, 'learning_rate': 1e-8}
    gentle = train(options(
        tmp_path / 'gentle.safetensors', start=str(tmp_path / 'first.safetensors'), **small_steps
    ))
    fresh = train(options(tmp_path / 'fresh.safetensors', **small_steps))
    assert gentle.start_sha256 == first.weights_sha256
    assert fresh.start_sha256 is None
    assert gentle.domain == joined_domains([first.domain, fresh.domain])
    pictures = make_dataset(draw_scenes('nominal', seed=3, images=6), workers=1).pictures
    answers = [
        TaxiNet(ARCHITECTURES[DEFAULT_ARCHITECTURE], load_model(tmp_path / name).weights)
        .infer(pictures)
        for name in ('first.safetensors', 'gentle.safetensors', 'fresh.safetensors')
    ]
    assert np.abs(answers[1] - answers[0]).max() < np.abs(answers[2] - answers[0]).max() / 4


@pytest.mark.nightly
def test_given_a_training_after_which_a_network_errs_more_then_a_warning_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    first = train(options(tmp_path / 'first.safetensors', epochs=4))
    assert capsys.readouterr().err == ''
    after = train(options(tmp_path / 'after.safetensors', epochs=1, learning_rate=0.3,
                          start=str(tmp_path / 'first.safetensors')))
    before, now = (one.errors['cte_m']['mae'] for one in (first, after))
    assert now > before, 'the same images are held out'
    line = f'first.safetensors errs less (cte_m {before:.3g} before, {now:.3g} now'
    assert line in capsys.readouterr().err


def test_given_a_start_that_is_no_network_when_trained_then_refused_before_any_work(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError, match='no such file'):
        train(options(tmp_path / 'net.safetensors', start=str(tmp_path / 'none.safetensors')))
    assert list(tmp_path.iterdir()) == []


def test_given_a_dataset_of_a_program_when_trained_on_then_it_is_what_the_program_gives(
    tmp_path: Path,
) -> None:
    write_dataset(DatasetOptions(program='nominal', out=tmp_path / 'd', count=5, seed=3, workers=1))
    from_disk, _ = load_folders([tmp_path / 'd'], workers=2)
    drawn = draw_scenes('nominal', seed=3, images=5)
    assert folders_domain([tmp_path / 'd']) == domain_of_scenes(one.to_human() for one in drawn)
    foreign = foreign_folder(tmp_path / 'foreign')
    assert folders_domain([tmp_path / 'd', foreign]) is None
    in_memory = make_dataset(draw_scenes('nominal', seed=3, images=5), workers=1)
    assert np.array_equal(from_disk.pictures, in_memory.pictures)
    assert list(from_disk.cte_m) == list(in_memory.cte_m)
    assert from_disk.he_rad == pytest.approx(in_memory.he_rad, abs=1e-12)


@pytest.mark.parametrize(
    ('validation', 'batch', 'reason'), [
        (8, 1, '8 images are too few to hold out 8 of them, as asked or by default; use a '
         'validation of 1, or a folder as validation_data'),
        (8, 64, 'use a validation of 1, with a batch of 7 or less, or a folder as validation_data'),
        (4, 5, 'a batch of 5, as asked or by default, is more than the 4 images to train on; '
         'use a batch of 4 or less'),
    ],
)
def test_given_too_few_rows_when_trained_then_one_line_says_so(
    validation: int, batch: int, reason: str, tmp_path: Path
) -> None:
    folder = foreign_folder(tmp_path / 'photos', images=8)
    asked = from_data(tmp_path / 'net.safetensors', folder, batch=batch)
    with pytest.raises(UsageError, match=reason):
        train(dataclasses.replace(asked, validation=validation))
    assert [path.name for path in tmp_path.iterdir()] == ['photos']


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'data': (Path('d'),)}, 'several of a program, places and data'),
        ({'program': None}, 'neither a program, places nor data'),
        ({'program': None, 'data': (Path('d'),), 'varied': True}, 'varied is for rendered'),
        ({'program': None, 'data': (Path('d'), Path('x/../d'))}, 'given twice'),
        ({'program': None, 'data': (Path('d'),), 'validation_data': Path('d')}, 'given twice'),
        ({'validation_data': Path('d')}, 'validation_data goes with data'),
        ({'sampler': 'dice'}, "sampler 'dice' is unknown; known: random, halton"),
        (
            {'program': None, 'data': (Path('d'),), 'sampler': 'halton'},
            'sampler is for rendered scenes',
        ),
        (
            {
                'program': None, 'data': (Path('d'),),
                'add': (parse_portion('crossing=1', 'program'),),
            },
            'add or add_runs is for rendered scenes',
        ),
    ],
)
def test_given_options_that_do_not_go_together_when_stated_then_one_line_says_so(
    change: dict[str, object], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=r'^train: ') as caught:
        options(tmp_path / 'net.safetensors', **change)
    assert reason in str(caught.value)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('net.pt', 'networks are .safetensors files; use net.safetensors'),
        ('net', 'networks are .safetensors files; use net.safetensors'),
        ('none/net.safetensors', 'is not a folder'),
        ('file/net.safetensors', 'is not a folder'),
        ('old.safetensors', 'exists'),
        ('only_card.safetensors', 'exists'),
        ('only_curves.safetensors', 'exists'),
    ],
)
def test_given_an_out_that_cannot_be_when_trained_then_refused_before_any_work(
    name: str, reason: str, tmp_path: Path
) -> None:
    for existing in ('file', 'old.safetensors', 'only_card.json', 'only_curves.png'):
        (tmp_path / existing).write_text('mine')
    started: list[str] = []
    with pytest.raises(UsageError) as caught:
        train(options(tmp_path / name), progress=lambda stage, *_: started.append(stage))
    assert reason in str(caught.value)
    assert str(caught.value).startswith('train: out ')
    assert '\n' not in str(caught.value)
    assert started == []
    assert {path.read_text() for path in tmp_path.iterdir()} == {'mine'}


def test_given_an_unknown_program_when_trained_then_refused_and_nothing_is_written(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError, match='known: '):
        train(options(tmp_path / 'net.safetensors', program='nominall'))
    assert list(tmp_path.iterdir()) == []


def test_given_no_gpu_when_trained_on_one_then_refused_before_any_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    with pytest.raises(UsageError, match='device cuda: torch finds no GPU here'):
        train(options(tmp_path / 'net.safetensors', device='cuda'))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UsageError, match="device 'gpu' is unknown; known: cpu, cuda"):
        options(tmp_path / 'net.safetensors', device='gpu')


@pytest.mark.parametrize(
    'change',
    [
        {'images': 0}, {'validation': 0}, {'epochs': 0}, {'batch': 0}, {'batch': 13},
        {'learning_rate': 0.0}, {'learning_rate': float('nan')},
        {'seed': -1}, {'workers': 0},
    ],
)  # fmt: skip
def test_given_a_number_out_of_range_when_stated_then_one_line_names_it(
    change: dict[str, float], tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=r'^train: ') as caught:
        options(tmp_path / 'net.safetensors', **change)
    assert next(iter(change)) in str(caught.value)
    assert '\n' not in str(caught.value)
