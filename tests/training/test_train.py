from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from taxinet_ros import __version__
from taxinet_ros.campaign.programs import find_program, program_digest
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.perception import make_perception
from taxinet_ros.core.weights import digest, load_model
from taxinet_ros.training.train import TrainOptions, train


def options(out: Path, **changes: object) -> TrainOptions:
    tiny = TrainOptions(
        program='nominal', out=out, images=12, validation=4, epochs=2, batch=4, workers=1, seed=7
    )
    return dataclasses.replace(tiny, **changes)


def test_given_a_tiny_training_when_done_twice_then_weights_are_equal_and_the_card_complete(
    tmp_path: Path,
) -> None:
    stages: list[str] = []
    first = tmp_path / 'first.safetensors'
    card = train(options(first), progress=lambda stage, done, total: stages.append(stage))
    again = tmp_path / 'again.safetensors'
    train(options(again))
    assert again.read_bytes() == first.read_bytes()
    assert stages == ['scenes'] * 16 + ['images'] * 16 + ['epochs'] * 2
    assert load_model(first).card == card
    assert make_perception(str(first)).fingerprint == card.weights_sha256
    assert card.weights_sha256 == digest(first.read_bytes())
    assert card.program_sha256 == program_digest(find_program('nominal'))
    assert (card.program, card.seed, card.images, card.validation) == ('nominal', 7, 12, 4)
    assert (card.epochs, card.batch, card.package_version) == (2, 4, __version__)
    assert card.command_line == (
        'taxinet train nominal --images 12 --validation 4 --epochs 2 --batch 4 '
        '--learning-rate 0.003 --seed 7 --out first.safetensors'
    )
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [
        'again.json', 'again.safetensors', 'first.json', 'first.safetensors'
    ]  # fmt: skip


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('net.pt', 'has to end in .safetensors'),
        ('none/net.safetensors', 'is no folder'),
        ('file/net.safetensors', 'is no folder'),
        ('old.safetensors', 'exists'),
        ('only_card.safetensors', 'exists'),
    ],
)
def test_given_an_out_that_cannot_be_when_trained_then_refused_before_any_work(
    name: str, reason: str, tmp_path: Path
) -> None:
    for existing in ('file', 'old.safetensors', 'only_card.json'):
        (tmp_path / existing).write_text('mine')
    started: list[str] = []
    with pytest.raises(UsageError) as caught:
        train(options(tmp_path / name), progress=lambda stage, *_: started.append(stage))
    assert reason in str(caught.value)
    assert str(caught.value).startswith('train: --out ')
    assert '\n' not in str(caught.value)
    assert started == []
    assert {path.read_text() for path in tmp_path.iterdir()} == {'mine'}


def test_given_an_unknown_program_when_trained_then_refused_and_nothing_is_written(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError, match='known: '):
        train(options(tmp_path / 'net.safetensors', program='nominall'))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    'change',
    [
        {'images': 0}, {'validation': 0}, {'epochs': 0}, {'batch': 0}, {'batch': 13},
        {'learning_rate': 0.0}, {'learning_rate': float('nan')}, {'seed': -1}, {'workers': 0},
    ],
)  # fmt: skip
def test_given_a_number_out_of_range_when_stated_then_one_line_names_it(
    change: dict[str, float], tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=r'^train: ') as caught:
        options(tmp_path / 'net.safetensors', **change)
    assert next(iter(change)) in str(caught.value)
    assert '\n' not in str(caught.value)
