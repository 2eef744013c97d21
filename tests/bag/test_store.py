"""Bags far away, in an S3-compatible server and on the local file system."""

from __future__ import annotations

import random
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import fsspec
import pytest
from far_store import KEYS, local_store, s3_server

from taxinet_ros.bag import store as store_module
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.bag.store import (
    STORED_NAME,
    bring_back,
    check_store,
    check_stored,
    store_bag,
    stored_bag,
)
from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.sealed_json import write_sealed

MCAP = random.Random(1).randbytes(300_000)
FILES = {'metadata.yaml': b'rosbag2: 1\n', 'r_0.mcap': MCAP}


@pytest.fixture(scope='module')
def s3() -> Iterator[str]:
    with s3_server() as address:
        yield address


@pytest.fixture(params=['file', 's3'])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == 'file':
        return check_store(local_store(tmp_path / 'far away'.replace(' ', '-')))
    request.getfixturevalue('s3')
    return check_store(f's3://taxi/{uuid.uuid4()}')


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    folder = tmp_path / 'c' / 'r'
    folder.mkdir(parents=True)
    for name, data in FILES.items():
        (folder / name).write_bytes(data)
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != STORED_NAME}


def far_content(url: str) -> dict[str, bytes]:
    files, place = fsspec.core.url_to_fs(url)
    files.invalidate_cache()
    return {name.rpartition('/')[2]: files.cat_file(name) for name in files.find(place)}


def test_given_a_stored_bag_then_it_is_there_and_comes_back_when_it_is_read(url, bag):
    assert store_bag(bag, url)
    assert [path.name for path in bag.iterdir()] == [STORED_NAME]
    assert far_content(f'{url}/r') == FILES
    assert stored_bag(bag).url == f'{url}/r'
    assert [path.name for path in storage_files(bag)] == ['r_0.mcap']
    assert content(bag) == FILES
    (bag / 'r_0.mcap').unlink()
    assert storage_files(bag / 'r_0.mcap') == (bag / 'r_0.mcap',)
    assert not store_bag(bag, url), 'nothing has to be uploaded again'
    assert content(bag) == {}
    assert not store_bag(bag, url)


def test_given_a_bag_to_keep_then_it_is_in_both_places(url, bag):
    assert store_bag(bag, url, keep=True)
    assert content(bag) == far_content(f'{url}/r') == FILES


def test_given_an_upload_that_is_interrupted_then_nothing_is_lost_and_it_goes_on(
    url, bag, monkeypatch
):
    put, done = store_module._Far.put, []

    def fails_at_second(far, path, *words, **named):
        if done:
            raise RecordError('connection reset')
        done.append(path.name)
        return put(far, path, *words, **named)

    with monkeypatch.context() as patch:
        patch.setattr(store_module._Far, 'put', fails_at_second)
        with pytest.raises(RecordError, match='connection reset'):
            store_bag(bag, url)
    assert content(bag) == FILES
    assert stored_bag(bag) is None
    assert list(far_content(f'{url}/r')) == ['metadata.yaml']
    uploads = counted_uploads(monkeypatch)
    assert store_bag(bag, url)
    assert uploads == ['r_0.mcap']
    assert far_content(f'{url}/r') == FILES


def counted_uploads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that are uploaded from now on."""
    seen: list[str] = []
    make = fsspec.filesystem

    def counting(kind: str):
        files = make(kind)
        if not hasattr(files, '_put_file_before'):
            files._put_file_before = files.put_file

        def put_file(here: str, there: str) -> None:
            seen.append(Path(here).name)
            files._put_file_before(here, there)

        files.put_file = put_file
        return files

    monkeypatch.setattr(fsspec, 'filesystem', counting)
    return seen


def test_given_a_store_that_changes_what_it_gets_then_that_is_seen_and_nothing_is_removed(
    url, bag, monkeypatch
):
    def torn(files, here: str, there: str) -> None:
        files.pipe_file(there, Path(here).read_bytes()[:-1])

    with_put_file(monkeypatch, torn)
    with pytest.raises(RecordError, match=r'metadata.yaml: reads back differently from what was'):
        store_bag(bag, url)
    assert content(bag) == FILES
    assert stored_bag(bag) is None


def with_put_file(monkeypatch: pytest.MonkeyPatch, put_file: Callable[..., None]) -> None:
    make = fsspec.filesystem

    def changed(kind: str):
        files = make(kind, skip_instance_cache=True)
        files.put_file = lambda here, there: put_file(files, here, there)
        return files

    monkeypatch.setattr(fsspec, 'filesystem', changed)


def test_given_another_file_under_the_same_name_then_it_is_never_overwritten(url, bag):
    store_bag(bag, url, keep=True)
    (bag / STORED_NAME).unlink()
    (bag / 'r_0.mcap').write_bytes(b'another run')
    with pytest.raises(UsageError, match=r'r_0.mcap: another file is there already; recordings'):
        store_bag(bag, url)
    assert far_content(f'{url}/r') == FILES
    assert (bag / 'r_0.mcap').read_bytes() == b'another run'


def test_given_a_stored_bag_that_was_changed_here_then_its_new_files_replace_the_old(url, bag):
    store_bag(bag, url)
    bring_back(bag)
    (bag / 'r_0.mcap').write_bytes(b'with frames')
    (bag / 'metadata.yaml').unlink()  # as if only one file had been brought back
    asked = []

    def replaces(before: Path, now: Path, names: frozenset[str]) -> bool:
        asked.append((content(before), now, names))
        return True

    assert store_bag(bag, url, replaces=replaces)
    assert asked == [(FILES, bag, {'r_0.mcap'})]
    assert far_content(f'{url}/r') == {**FILES, 'r_0.mcap': b'with frames'}
    bring_back(bag)
    assert content(bag) == {**FILES, 'r_0.mcap': b'with frames'}


@pytest.mark.parametrize('name', sorted(FILES))
def test_given_a_stored_bag_that_was_edited_here_then_the_stored_one_is_never_overwritten(
    name, url, bag
):
    store_bag(bag, url)
    bring_back(bag)
    (bag / name).write_bytes(FILES[name] + b'# a remark')
    with pytest.raises(UsageError, match=rf'{bag}/{name}: differs from the stored one, {url}/r/'):
        store_bag(bag, url)
    assert far_content(f'{url}/r') == FILES
    assert content(bag) == {**FILES, name: FILES[name] + b'# a remark'}


def test_given_a_replacement_that_was_interrupted_then_it_goes_on(url, bag, monkeypatch):
    store_bag(bag, url)
    bring_back(bag)
    new = {'metadata.yaml': b'rosbag2: 2\n', 'r_0.mcap': b'with frames'}
    for name, data in new.items():
        (bag / name).write_bytes(data)
    put = store_module._Far.put

    def fails_at_last(far, path, *words, **named):
        if path.name == 'r_0.mcap':
            raise RecordError('connection reset')
        return put(far, path, *words, **named)

    with monkeypatch.context() as patch:
        patch.setattr(store_module._Far, 'put', fails_at_last)
        with pytest.raises(RecordError, match='connection reset'):
            store_bag(bag, url, replaces=lambda *words: True)
    assert content(bag) == new
    assert store_bag(bag, url, replaces=lambda *words: True)
    assert far_content(f'{url}/r') == new
    bring_back(bag)
    assert content(bag) == new


@pytest.mark.parametrize('here', [[], ['metadata.yaml']])
@pytest.mark.parametrize('damage', ['gone', 'shorter'])
def test_given_a_stored_file_that_is_neither_there_nor_here_then_storing_again_names_it(
    here, damage, url, bag
):
    store_bag(bag, url)
    for name in here:
        (bag / name).write_bytes(FILES[name])
    files, place = fsspec.core.url_to_fs(f'{url}/r/r_0.mcap')
    files.rm(place)
    if damage == 'shorter':
        files.pipe_file(place, MCAP[:9])
    said = 'is missing in the store and here' if damage == 'gone' else 'is not the file that was'
    for look in (lambda: store_bag(bag, url), lambda: check_stored(bag)):
        with pytest.raises(UsageError, match=rf'{url}/r/r_0.mcap: {said}'):
            look()
    assert sorted(content(bag)) == here


def test_given_a_stored_bag_when_stored_elsewhere_then_it_is_moved_there(url, bag, tmp_path):
    store_bag(bag, url)
    other = check_store(local_store(tmp_path / 'other'))
    assert store_bag(bag, other)
    assert stored_bag(bag).url == f'{other}/r'
    assert far_content(f'{other}/r') == FILES
    assert content(bag) == {}


def test_given_a_store_that_lost_a_bag_that_is_here_then_it_is_uploaded_again_before_it_goes(
    url, bag
):
    store_bag(bag, url)
    bring_back(bag)
    files, place = fsspec.core.url_to_fs(f'{url}/r/r_0.mcap')
    files.rm(place)
    assert store_bag(bag, url)
    assert content(bag) == {}
    assert far_content(f'{url}/r') == FILES


@pytest.mark.parametrize('values', [
    {'url': 'https://host/x', 'files': {'r_0.mcap': [1, 'ab']}},
    {'url': 'zip://x::s3://taxi/x', 'files': {'r_0.mcap': [1, 'ab']}},
    {'url': 's3://taxi/x', 'files': {'../r_0.mcap': [1, 'ab']}},
    {'url': 's3://taxi/x', 'files': {'/etc/passwd': [1, 'ab']}},
    {'url': 3, 'files': {}}, {'url': 's3://taxi/x'},
])
def test_given_a_record_of_somebody_else_then_nothing_odd_is_contacted_or_written(values, bag):
    write_sealed(bag / STORED_NAME, values)
    with pytest.raises(UsageError, match=rf'{STORED_NAME}: damaged'):
        bring_back(bag)
    assert content(bag) == FILES


@pytest.mark.parametrize('damage', ['gone', 'bit', 'longer', 'shorter'])
def test_given_a_stored_file_that_is_gone_or_changed_then_it_is_named_and_not_taken(
    damage, url, bag
):
    store_bag(bag, url)
    files, place = fsspec.core.url_to_fs(f'{url}/r/r_0.mcap')
    if damage == 'gone':
        files.rm(place)
    else:
        flipped = bytes([MCAP[0] ^ 1]) + MCAP[1:]
        files.pipe_file(place, {'bit': flipped, 'longer': MCAP * 40, 'shorter': MCAP[:9]}[damage])
    said = 'is missing in the store' if damage == 'gone' else 'is not the file that was stored'
    with pytest.raises(UsageError, match=rf'{url}/r/r_0.mcap: {said}'):
        storage_files(bag)
    assert sorted(path.name for path in bag.iterdir()) == ['metadata.yaml', STORED_NAME]


def test_given_any_flipped_bit_of_the_record_then_it_is_refused(bag, tmp_path):
    store_bag(bag, check_store(local_store(tmp_path / 'far')))
    sound = (bag / STORED_NAME).read_bytes()
    for bit in range(0, 8 * len(sound), 37):
        damaged = bytearray(sound)
        damaged[bit // 8] ^= 1 << bit % 8
        (bag / STORED_NAME).write_bytes(damaged)
        with pytest.raises(UsageError, match=STORED_NAME):
            bring_back(bag)


@pytest.mark.parametrize(('address', 'said'), [
    ('bags', 'expected an address such as'),
    ('file://bags', 'with three slashes'),
    ('s3://key:word@bucket/x', 'must not contain credentials'),
    ('abfs://host/x?sig=word', 'must not contain credentials'),
    ('https://host/x?sig=word', 'expected an address such as'),
    ('zip::s3://bucket/x', 'expected an address such as'),
    ('nowhere://bucket/x', 'known: s3, file, gs, abfs, sftp, hdfs'),
    ('gs://bucket/x', r'--store gs://: .*pip install .taxinet_ros\[store\]'),
])
def test_given_no_address_or_one_with_credentials_then_it_is_refused_without_showing_them(
    address, said
):
    with pytest.raises(UsageError, match=said) as caught:
        check_store(address)
    assert 'word' not in str(caught.value)


def test_given_no_bucket_or_no_server_then_it_is_said_at_the_start(s3, monkeypatch):
    with pytest.raises(UsageError, match=r'--store s3://nobody/x: no such bucket, or no access'):
        check_store('s3://nobody/x')
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    monkeypatch.setenv('AWS_ENDPOINT_URL', 'http://127.0.0.1:9')
    monkeypatch.setenv('AWS_MAX_ATTEMPTS', '1')
    with pytest.raises(UsageError, match=r'--store s3://taxi/x'):
        check_store('s3://taxi/x')
    s3fs.S3FileSystem.clear_instance_cache()


def test_given_an_error_that_quotes_a_secret_then_it_is_left_out(bag, tmp_path, monkeypatch):
    secret = KEYS['AWS_SECRET_ACCESS_KEY']
    monkeypatch.setenv('AWS_SECRET_ACCESS_KEY', secret)

    def refuse(*words: object) -> None:
        raise ValueError(f'signature of\n{secret} does not match')

    url = check_store(local_store(tmp_path / 'far'))
    with_put_file(monkeypatch, refuse)
    with pytest.raises(RecordError) as caught:
        store_bag(bag, url)
    assert str(caught.value) == f'{url}/r: ValueError: signature of … does not match'
