"""An interrupted training: what it keeps, and that it ends with the same weights."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from training_samples import foreign_folder

from taxinet_ros.core.perception import weights
from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.record import Record, read_record
from taxinet_ros.training import fit as fitting
from taxinet_ros.training import train as training
from taxinet_ros.training.data import dataset as datasets
from taxinet_ros.training.data import unfinished
from taxinet_ros.training.data.portions import parse_portion
from taxinet_ros.training.data.unfinished import NAME
from taxinet_ros.training.options import TrainOptions
from taxinet_ros.training.train import IMAGES, train


def options(out: Path, **changes: object) -> TrainOptions:
    tiny = TrainOptions(
        program='nominal', out=out, images=12, validation=4, epochs=4, batch=4, workers=1, seed=7,
        augment=True,
    )
    return dataclasses.replace(tiny, **changes)


def at(stage: str, number: int) -> Callable[[str, int, int], None]:
    """A progress callback that is interrupted there."""
    def interrupt(now: str, done: int, total: int) -> None:
        if (now, done) == (stage, number):
            raise KeyboardInterrupt
    return interrupt


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp('whole') / 'net.safetensors'
    train(options(out))
    return out


@pytest.mark.parametrize(
    'moments', [
        [('epochs', 2)], [('epochs', 4)], *(
            pytest.param(moments, marks=pytest.mark.nightly)
            for moments in ([(IMAGES, 5)], [(IMAGES, 16), ('epochs', 1)])
        ),
    ]
)
def test_an_interrupted_training_ends_with_the_same_weights_to_the_bit(
    moments: list[tuple[str, int]], undisturbed: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / 'net.safetensors'
    for number, moment in enumerate(moments):
        with pytest.raises(KeyboardInterrupt):
            train(options(out, resume=number > 0), at(*moment))
        assert [path.name for path in tmp_path.iterdir()] == ['net.part']
    rendered, epochs = [], []
    take, epoch = datasets._shrunk, fitting._Trainer.epoch
    monkeypatch.setattr(datasets, '_shrunk', lambda *one: (rendered.append(1), take(*one))[1])
    monkeypatch.setattr(fitting._Trainer, 'epoch', lambda self, number: (
        epochs.append(number), epoch(self, number))[1])
    train(options(out, resume=True))
    for suffix in ('.safetensors', '.json', '.csv', '.png'):
        assert out.with_suffix(suffix).read_bytes() == undisturbed.with_suffix(suffix).read_bytes()
    assert not (tmp_path / 'net.part').exists()
    stage, done = moments[-1]
    assert len(rendered) == (16 - done if stage == IMAGES else 0)
    assert epochs == list(range(1 if stage == IMAGES else done + 1, 5))


@pytest.mark.parametrize(('last', 'overwrite'), [
    ('.json', False), *(pytest.param(*case, marks=pytest.mark.nightly) for case in [
        ('.json', True), ('.safetensors', False), ('.png', False),
    ]),
])
def test_a_training_that_was_killed_while_its_result_was_written_is_resumed(
    last: str, overwrite: bool, undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / 'net.safetensors'

    def killed(path: Path = Path('after.png'), data: bytes = b'') -> None:
        if data:
            write_atomically(path, data)
        if path.suffix == last:
            raise KeyboardInterrupt

    monkeypatch.setattr(weights, 'write_atomically', killed)
    monkeypatch.setattr(training, 'history_csv', lambda history: killed())
    with pytest.raises(KeyboardInterrupt):
        train(options(out))
    monkeypatch.undo()
    assert out.with_suffix(last).exists()
    with pytest.raises(UsageError, match='begun with seed 7, not 8'):
        train(options(out, resume=True, seed=8, overwrite=overwrite))
    monkeypatch.setattr(fitting._Trainer, 'epoch', None)
    train(options(out, resume=True, overwrite=overwrite))
    for suffix in ('.safetensors', '.json', '.csv', '.png'):
        assert out.with_suffix(suffix).read_bytes() == undisturbed.with_suffix(suffix).read_bytes()
    assert not (tmp_path / 'net.part').exists()


def test_an_unfinished_folder_without_its_request_is_no_interrupted_training(
    tmp_path: Path
) -> None:
    out, folder = tmp_path / 'net.safetensors', tmp_path / 'net.part'
    folder.mkdir()
    (folder / 'epochs.pt').write_bytes(b'of another')
    with pytest.raises(UsageError, match='so there is nothing to resume; leave resume out'):
        train(options(out, resume=True))
    with pytest.raises(KeyboardInterrupt):
        train(options(out), at(IMAGES, 1))
    assert {path.name for path in folder.iterdir()} == {NAME}


def test_a_folder_of_something_else_in_the_place_of_the_unfinished_one_is_kept(
    tmp_path: Path
) -> None:
    own = tmp_path / 'net.part' / 'notes.txt'
    own.parent.mkdir()
    own.write_text('mine')
    for overwrite in (False, True):
        with pytest.raises(UsageError, match=r'folder .*net\.part, which is there with something'):
            train(options(tmp_path / 'net.safetensors', overwrite=overwrite))
    assert own.read_text() == 'mine'


@pytest.mark.nightly
def test_a_damaged_picture_is_rendered_again(
    undisturbed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'net.safetensors'
    with pytest.raises(KeyboardInterrupt):
        train(options(out), at(IMAGES, 5))
    record = tmp_path / 'net.part' / NAME
    with contextlib.closing(sqlite3.connect(record)) as file, file:
        file.execute('UPDATE entries SET value = replace(value, "cte_m", "cte") '
                     'WHERE key = "00000002"')
    train(options(out, resume=True))
    assert "damaged (entry picture '00000002')" in capsys.readouterr().err
    assert out.read_bytes() == undisturbed.read_bytes()


def test_a_full_disk_loses_no_picture(
    undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, put_all, written = tmp_path / 'net.safetensors', Record.put_all, []

    def full(self: Record, entries: list[tuple[str, str, object]]) -> None:
        if len(written) > 5:
            raise OSError(errno.ENOSPC, 'No space left on device', NAME)
        written.extend(entries)
        put_all(self, entries)

    monkeypatch.setattr(unfinished, 'FLUSH_S', 0.0)
    monkeypatch.setattr(Record, 'put_all', full)
    with pytest.raises(RecordError, match=r'No space left.*fix that, then resume it'):
        train(options(out))
    monkeypatch.undo()
    assert len(read_record(tmp_path / 'net.part' / NAME)['picture']) == 5
    train(options(out, resume=True))
    assert out.read_bytes() == undisturbed.read_bytes()


def test_changed_arguments_are_refused_by_name(tmp_path: Path) -> None:
    out = tmp_path / 'net.safetensors'
    with pytest.raises(UsageError, match='so there is nothing to resume'):
        train(options(out, resume=True))
    with pytest.raises(KeyboardInterrupt):
        train(options(out), at(IMAGES, 1))
    for changes, expected in (
        ({'seed': 8}, 'begun with seed 7, not 8'),
        ({'epochs': 5}, 'begun with epochs 4, not 5'),
        ({'add': (parse_portion('crossing=6', 'program'),)}, 'begun with add none, not crossing=6'),
        ({'program': 'crossing'}, 'begun with program nominal, not crossing'),
    ):
        with pytest.raises(UsageError, match=expected) as caught:
            train(options(out, resume=True, **changes))
        assert '\n' not in str(caught.value)
    with pytest.raises(UsageError, match='an interrupted training; resume to go on'):
        train(options(out))
    assert len(read_record(tmp_path / 'net.part' / NAME)['picture']) == 1


def test_a_changed_folder_of_pictures_is_refused(tmp_path: Path) -> None:
    out, folder = tmp_path / 'net.safetensors', foreign_folder(tmp_path / 'photos', images=8)
    asked = options(out, program=None, data=(folder,), validation=2)
    with pytest.raises(KeyboardInterrupt):
        train(asked, at('epochs', 1))
    labels = folder / 'labels.csv'
    labels.write_text('\n'.join([*labels.read_text().splitlines()[:-1], '']))
    with pytest.raises(UsageError, match=r'begun with folder photos \(sha256\)'):
        train(dataclasses.replace(asked, resume=True))


@pytest.mark.nightly
def test_a_file_in_the_way_is_named_and_not_destroyed_by_overwrite(tmp_path: Path) -> None:
    picture = tmp_path / 'edny.png'
    picture.write_bytes(b'a place')
    for overwrite in (False, True):
        with pytest.raises(UsageError) as caught:
            train(options(tmp_path / 'edny.safetensors', overwrite=overwrite))
        assert f'would also write {picture} (learning curves), which exists' in str(caught.value)
    assert picture.read_bytes() == b'a place'
    (tmp_path / 'edny.safetensors').write_bytes(b'')
    with pytest.raises(UsageError, match='already exists; choose another file, or overwrite it'):
        train(options(tmp_path / 'edny.safetensors'))
    train(options(tmp_path / 'edny.safetensors', overwrite=True, epochs=1))
    assert picture.read_bytes().startswith(b'\x89PNG')
