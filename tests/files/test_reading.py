"""Files that somebody names: no reader hangs at a pipe, or reads a device without an end."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from taxinet_ros.bag.reader import read_info
from taxinet_ros.bench.report import load_report
from taxinet_ros.core.assurance.monitor import read_calibration
from taxinet_ros.core.perception.onnx.network import NetworkFiles
from taxinet_ros.core.perception.onnx.nnet import description_of, read_nnet
from taxinet_ros.core.perception.weights import load_card, load_model
from taxinet_ros.core.place.apt_dat import read_airport_place
from taxinet_ros.core.place.catalogue import PLACES
from taxinet_ros.core.user_code import find_user_code
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import read_yaml
from taxinet_ros.files.reading import UnfitFileError, open_regular, read_file, read_text
from taxinet_ros.files.sealed_json import file_sha256, read_sealed
from taxinet_ros.scenes.programs import stored_text
from taxinet_ros.training.data.image_folder import open_folder
from taxinet_ros.trials.cluster.pool import check_cluster
from taxinet_ros.trials.learned_program import learned_program

PACKAGE = Path(__file__).parents[2] / 'taxinet_ros'
READERS: dict[str, Callable[[Path], Any]] = {
    'a.mcap': read_info,
    'apt.dat': lambda path: read_airport_place(path, 'KMWH', '4'),
    'apt.dat.gz': lambda path: read_airport_place(path, 'KMWH', '4'),
    'calibration.npz': read_calibration,
    'card.json': load_card,
    'description.yaml': lambda path: description_of(str(path)),
    'labels.csv': lambda path: open_folder(path.parent),
    'mine.py': lambda path: find_user_code(f'{path}:steer', 'controller'),
    'net.nnet': read_nnet,
    'net.onnx': NetworkFiles.read,
    'place.json': lambda path: PLACES.typed(str(path)),
    'place.yaml': lambda path: PLACES.typed(str(path)),
    'program.scenic': lambda path: stored_text({path.name: path}),
    'learned.scenic': lambda path: learned_program(path, SimpleNamespace(choices=()), {}, ''),
    'report.json': load_report,
    'requirements.yaml': read_yaml,
    'scheduler.json': lambda path: check_cluster(str(path)),
    'sealed.json': read_sealed,
    'sum.bin': file_sha256,
    'weights.npz': load_model,
}
NAMED = '(is (a pipe|a device), )?not a regular file'


@pytest.mark.parametrize('name', READERS)
@pytest.mark.parametrize('kind', ['pipe', 'device'])
def test_given_what_may_never_end_then_every_reader_refuses_it_by_name(name, kind, tmp_path):
    path = tmp_path / name
    if kind == 'pipe':
        os.mkfifo(path)
    else:
        path.symlink_to('/dev/zero')
    with pytest.raises((UsageError, UnfitFileError), match=NAMED) as caught:
        READERS[name](path)
    assert name in str(caught.value)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('name', sorted(set(READERS) - {
    'a.mcap', 'apt.dat', 'apt.dat.gz', 'labels.csv', 'sealed.json', 'sum.bin',
    'trials.csv',
}))
def test_given_a_file_beyond_every_limit_then_it_is_refused_by_its_size(name, tmp_path):
    path = tmp_path / name
    with path.open('wb') as file:
        file.truncate(257 << 20)
    with pytest.raises(UsageError, match=r'has more than \d+ [KM]iB; is it the right file'):
        READERS[name](path)


def test_given_a_limit_then_no_more_than_that_is_read(tmp_path):
    path = tmp_path / 'file'
    path.write_bytes(b'x' * 2048)
    assert read_file(path, 2048) == read_file(path) == b'x' * 2048
    with pytest.raises(UnfitFileError, match='has more than 1 KiB; is it the right file'):
        read_file(path, 2047)
    path.write_bytes('ä\r\nb\r'.encode())
    assert read_text(path, 100) == 'ä\nb\n'
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / 'nowhere', 1)
    with pytest.raises(IsADirectoryError):
        read_file(tmp_path, 1)


def test_given_what_a_shell_offers_then_it_is_read_up_to_the_limit():
    ours, its = os.pipe()
    os.write(its, b'words\n')
    os.close(its)
    try:
        assert read_file(Path(f'/dev/fd/{ours}'), 6) == b'words\n'
    finally:
        os.close(ours)
    assert read_file(Path('/dev/null'), 1) == b''
    for name in ('zero', 'urandom', 'full'):
        with pytest.raises(UnfitFileError, match='is a device, not a regular file'):
            open_regular(Path('/dev') / name)


def test_given_the_package_then_no_size_is_trusted_before_a_whole_file_is_read():
    trusting = [
        path.relative_to(PACKAGE).as_posix() for path in sorted(PACKAGE.rglob('*.py'))
        if re.search(r'st_size > [^\n]*\n[^\n]*raise', path.read_text(encoding='utf-8'))
    ]
    assert trusting == []
