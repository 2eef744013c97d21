from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from network_samples import card_of, random_weights, save_sample

from taxinet_ros.core.perception.network import ARCHITECTURES, DEFAULT_ARCHITECTURE
from taxinet_ros.core.perception.weights import (
    SHIPPED,
    card_path,
    digest,
    load_model,
    save_model,
    to_bytes,
)
from taxinet_ros.errors import UsageError


def rewrite(path: Path, data: bytes) -> None:
    """Other bytes under a card that agrees with them."""
    path.write_bytes(data)
    edit_card(path, weights_sha256=digest(data))


def edit_card(path: Path, **entries: object) -> None:
    card = card_path(path)
    card.write_text(json.dumps({**json.loads(card.read_text()), **entries}))


def test_given_saved_weights_when_loaded_then_weights_and_card_are_the_same(
    tmp_path: Path,
) -> None:
    weights = random_weights(5)
    model = load_model(save_sample(tmp_path, weights))
    assert model.weights.keys() == weights.keys()
    assert all(np.array_equal(model.weights[name], weights[name]) for name in weights)
    assert model.card == card_of(to_bytes(weights))
    assert sorted(path.name for path in tmp_path.iterdir()) == ['net.json', 'net.safetensors']


def test_given_equal_weights_in_any_order_when_saved_then_bytes_are_equal() -> None:
    weights = random_weights()
    backwards = {name: weights[name].copy() for name in reversed(weights)}
    assert to_bytes(backwards) == to_bytes(weights)
    assert to_bytes(random_weights(1)) != to_bytes(weights)


def truncate(path: Path) -> None:
    data = path.read_bytes()
    rewrite(path, data[: len(data) // 2])


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-100] ^= 4
    path.write_bytes(data)


def change(**arrays: object) -> Callable[[Path], None]:
    def break_it(path: Path) -> None:
        weights = {**random_weights(), **arrays}
        kept = {name: array for name, array in weights.items() if array is not None}
        rewrite(path, safetensors.numpy.save(kept))

    return break_it


def with_nan(path: Path) -> None:
    weights = random_weights()
    weights['hidden.weight'][3, 7] = np.nan
    rewrite(path, to_bytes(weights))


def entries(**values: object) -> Callable[[Path], None]:
    return lambda path: edit_card(path, **values)


def drop_entry(path: Path) -> None:
    card = json.loads(card_path(path).read_text())
    del card['seed']
    card_path(path).write_text(json.dumps(card))


LFS = b'version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 767000\n'
HUGE_HEADER = b'\xff' * 8 + b'{}'
CASES: dict[str, tuple[Callable[[Path], object], str]] = {
    'missing': (lambda path: path.unlink(), 'no such file'),
    'a folder': (lambda path: (path.unlink(), path.mkdir()), 'no such file'),
    'empty': (lambda path: rewrite(path, b''), 'not a complete safetensors file'),
    'truncated': (truncate, 'not a complete safetensors file'),
    'header of 2^64 bytes': (lambda path: rewrite(path, HUGE_HEADER), 'not a complete safetensors'),
    'bit flipped': (flip_a_bit, 'SHA-256'),
    'wrong checksum': (entries(weights_sha256='0' * 64), 'SHA-256'),
    'Git LFS pointer': (lambda path: rewrite(path, LFS), 'git lfs pull'),
    'pickle': (lambda path: rewrite(path, pickle.dumps({'a': 1})), 'pickle'),
    'zip of pickles': (lambda path: rewrite(path, b'PK\x03\x04' + bytes(90)), 'pickle'),
    'text': (lambda path: rewrite(path, b'hello world, no weights'), 'not a complete safetensors'),
    'wrong shape': (change(**{'conv0.bias': np.zeros(17, np.float32)}), 'conv0.bias is float32'),
    'wrong type': (change(**{'conv0.bias': np.zeros(16)}), 'conv0.bias is float64'),
    'array missing': (change(**{'output.bias': None}), 'output.bias is missing'),
    'array too many': (change(extra=np.zeros(1, np.float32)), 'extra does not belong'),
    'not a number': (with_nan, 'hidden.weight has values that are not finite'),
    'card missing': (lambda path: card_path(path).unlink(), 'model card beside it'),
    'card no JSON': (lambda path: card_path(path).write_text('{'), 'not JSON'),
    'card no text': (lambda path: card_path(path).write_bytes(b'\xff\xfe\x00'), 'not JSON'),
    'card deeply nested': (lambda path: card_path(path).write_text('[' * 99_999), 'not JSON'),
    'card a list': (lambda path: card_path(path).write_text('[]'), 'expected KEY: VALUE pairs'),
    'card with a gap': (drop_entry, "'seed' is missing"),
    'card with a surprise': (entries(licence='none'), 'licence: unknown key'),
    'unknown architecture': (entries(architecture='resnet'), f'known: {DEFAULT_ARCHITECTURE}'),
    'count a word': (
        entries(images='many'), "images: expected a whole number, 0 or more, got 'many'",
    ),
    'errors negative': (
        entries(errors={'cte_m': {'mae': -1}, 'he_deg': {}}), 'errors.cte_m.mae: expected',
    ),
    'date no text': (entries(date=20260131), 'date: expected a word, got 20260131'),
    'switch a count': (entries(varied=1), 'varied: expected true or false, got 1'),
    'nothing learnt from': (entries(training_data=[]), 'training_data: expected a list'),
    'source without digest': (
        entries(training_data=[{'kind': 'program', 'name': 'x'}]),
        "training_data[0]: the key 'sha256' is missing",
    ),
    'source of no kind': (
        entries(validation_data=[{'kind': 'dream', 'name': 'x', 'sha256': '0'}]),
        'validation_data[0].kind: expected one of program, folder, runs',
    ),
}


@pytest.mark.parametrize('case', CASES)
def test_given_bad_weights_when_loaded_then_one_line_says_what_is_wrong(
    case: str, tmp_path: Path
) -> None:
    path = save_sample(tmp_path)
    load_model(path)
    break_it, reason = CASES[case]
    break_it(path)
    with pytest.raises(UsageError) as caught:
        load_model(path)
    message = str(caught.value)
    assert message.startswith(f'weights: {tmp_path}')
    assert reason in message
    assert '\n' not in message


def test_given_a_file_far_too_large_when_loaded_then_it_is_not_even_read(tmp_path: Path) -> None:
    path = save_sample(tmp_path)
    with path.open('ab') as file:
        file.truncate(1 << 40)  # sparse: it takes no room on the disk
    with pytest.raises(UsageError, match='has more than 64 MiB; is it the right'):
        load_model(path)


def test_given_no_folder_when_saved_then_one_line_says_so(tmp_path: Path) -> None:
    data = to_bytes(random_weights())
    with pytest.raises(UsageError, match=r'^weights: .*cannot be written \(No such file'):
        save_model(tmp_path / 'none' / 'net.safetensors', data, card_of(data))


def test_given_saved_weights_when_saved_again_then_the_new_pair_replaces_the_old(
    tmp_path: Path,
) -> None:
    save_sample(tmp_path)
    path = save_sample(tmp_path, random_weights(9))
    assert np.array_equal(
        load_model(path).weights['output.bias'], random_weights(9)['output.bias']
    )
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(('word', 'programs', 'worst_m'), [
    ('taxinet', ('training_full', 'training_crossing'), 0.8), ('broad', ('training_full',), 0.6),
    ('original', ('training_original',), 0.6), ('generic', ('s_falsif',), 0.6),
    ('halton', ('s_falsif',), 0.6), ('specialised', ('runway_position',), 0.6),
    ('iterative-generic', ('s_falsif', 's_falsif'), 0.6),
    ('iterative-crossing', ('s_falsif', 'crossing'), 0.6),
    ('iterative-verifai', ('s_falsif', 'learned'), 0.6),
    ('iterative-learned', ('s_falsif', 'learned'), 0.6),
])
def test_given_the_shipped_weights_when_loaded_then_they_are_small_and_their_card_is_complete(
    word: str, programs: tuple[str, ...], worst_m: float
) -> None:
    model = load_model(SHIPPED[word])
    assert SHIPPED[word].stat().st_size < 2_000_000
    assert model.weights.keys() == ARCHITECTURES[model.card.architecture].shapes().keys()
    assert [(data.kind, data.name) for data in model.card.training_data] == [
        ('program', program) for program in programs
    ]
    assert model.card.command_line.startswith(f'taxinet train {programs[0]} ')
    # On held-back scenes of the training's own world, other looks and rims included.
    assert model.card.errors['cte_m']['mae'] <= worst_m
    assert model.card.errors['he_deg']['mae'] <= 1.5


def test_given_the_weights_for_any_place_when_loaded_then_the_card_says_where_they_were_trained(
) -> None:
    card = load_model(SHIPPED['anywhere']).card
    assert SHIPPED['anywhere'].stat().st_size < 2_000_000
    assert [(data.kind, data.name) for data in (*card.training_data, *card.validation_data)] == [
        ('places', 'random:0-599'), ('program', 'training_full'), ('places', 'random:validation'),
    ]
    assert card.view == 'ahead'
    assert card.domain is not None
    assert not {'place', 'camera'} & set(card.domain)  # any
    assert card.domain['runway_width_m'] == (18, 60)
    assert card.errors['cte_m']['mae'] <= 0.8
    assert card.errors['he_deg']['mae'] <= 0.8


def test_given_the_chain_of_trainings_when_read_then_each_link_is_shipped() -> None:
    cards = {word: load_model(path).card for word, path in SHIPPED.items()}
    assert cards['taxinet'].start_sha256 == cards['broad'].weights_sha256
    assert ' --start broad ' in cards['taxinet'].command_line
    for kind in ('generic', 'crossing', 'verifai', 'learned'):
        assert cards[f'iterative-{kind}'].start_sha256 == cards['generic'].weights_sha256
    for word in ('broad', 'original', 'generic', 'halton', 'specialised'):
        assert cards[word].start_sha256 is None
