"""The record in SQLite: whole entries or none, whatever happens to the process or the file."""

from __future__ import annotations

import errno
import fcntl
import os
import random
import re
import resource
import signal
import sqlite3
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.record import (
    Record,
    examine_record,
    read_entry,
    read_record,
    record_kinds,
    repair_record,
    repaired,
)

FACTS = {'program': 'nominal', 'runs': 40}
ROWS = {f'{index:08d}': {'index': index, 'rho': [0.1 * index] * 150} for index in range(40)}


def make(path: Path) -> Path:
    with Record(path) as record:
        record.put('facts', '', FACTS)
        for key, row in ROWS.items():
            record.put('row', key, row)
    return path


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return make(tmp_path_factory.mktemp('whole') / 'campaign.db').read_bytes()


def test_what_was_written_is_read_back(tmp_path: Path) -> None:
    path = make(tmp_path / 'new' / 'campaign.db')
    assert read_record(path) == {'facts': {'': FACTS}, 'row': ROWS}
    assert [file.name for file in path.parent.iterdir()] == ['campaign.db']
    assert examine_record(path) == read_record(path)
    with Record(path) as record:
        assert record.entries['row'] == ROWS
        record.put_all([('row', '00000000', 'another'), ('row', '00000040', None)])
        record.remove('facts')
    again = read_record(path)
    assert 'facts' not in again
    assert again['row'] == {**ROWS, '00000000': 'another', '00000040': None}


def test_it_is_read_while_it_is_written_and_in_a_folder_without_write_permission(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'campaign.db'
    with Record(path) as record:
        for count in range(1, 4):
            record.put('row', str(count), count)
            assert len(read_record(path)['row']) == count
    path.chmod(0o444)
    tmp_path.chmod(0o555)
    try:
        assert len(read_record(path)['row']) == 3
    finally:
        tmp_path.chmod(0o755)


def test_one_command_writes_at_a_time(tmp_path: Path) -> None:
    with Record(tmp_path / 'campaign.db'):
        for other in (lambda: Record(tmp_path / 'campaign.db'),
                      lambda: repair_record(tmp_path / 'campaign.db')):
            with pytest.raises(UsageError, match='another command is writing to it'):
                other()
    Record(tmp_path / 'campaign.db').close()
    assert [file.name for file in tmp_path.iterdir()] == ['campaign.db']


def test_the_lock_is_one_of_a_file_as_network_file_systems_pass_on_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On NFS, CIFS and FUSE a lock of a folder holds on one machine only."""
    locked: list[int] = []
    monkeypatch.setattr(fcntl, 'flock', lambda descriptor, how: locked.append(
        os.fstat(descriptor).st_mode
    ))
    make(tmp_path / 'campaign.db')
    assert [stat.S_ISREG(mode) for mode in locked] == [True]


@pytest.mark.parametrize('number', [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL])
def test_a_file_system_without_locks_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuse(descriptor: int, how: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, 'flock', refuse)
    with pytest.raises(UsageError, match=r'campaign\.db: its file system locks no files \('):
        Record(tmp_path / 'campaign.db')
    assert list(tmp_path.iterdir()) == []


def test_a_change_is_whole_or_not_there(tmp_path: Path) -> None:
    path = make(tmp_path / 'campaign.db')
    with Record(path) as record, pytest.raises(TypeError):
        record.put_all([('row', '00000000', 'another'), ('row', '00000001', object())])
    assert read_record(path)['row'] == ROWS


_WRITER = """
import sys
from pathlib import Path
from taxinet_ros.files.record import Record
with Record(Path(sys.argv[1])) as record:
    done = len(record.entries.get('row', {}))
    for index in range(done, 100_000):
        record.put_all([('run', f'{index:08d}', index), ('row', f'{index:08d}', 'x' * 3000)])
        print(index, flush=True)
"""


def test_a_killed_writer_loses_nothing_that_it_had_confirmed(tmp_path: Path) -> None:
    path = tmp_path / 'campaign.db'
    chance = random.Random(5)
    for _ in range(8):
        command = [sys.executable, '-c', _WRITER, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            child.stdout.readline()
            time.sleep(chance.uniform(0.0, 0.05))
            child.send_signal(signal.SIGKILL)
            confirmed = [int(line) for line in child.stdout.read().splitlines()]
        entries = read_record(path)
        assert entries['row'].keys() == entries['run'].keys()
        assert len(entries['row']) > max(confirmed, default=0)


def damages(whole: bytes) -> list[bytes]:
    """Flipped bits, blocks of zeros, exchanged pages and torn ends, 500 in all."""
    chance, found = random.Random(7), []
    for _ in range(300):
        data = bytearray(whole)
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        found.append(bytes(data))
    pages = len(whole) // 4096
    for _ in range(100):
        data = bytearray(whole)
        one, other = chance.sample(range(pages), 2)
        page = bytes(4096) if chance.random() < 0.5 else whole[4096 * other:4096 * (other + 1)]
        data[4096 * one:4096 * (one + 1)] = page
        found.append(bytes(data))
    found += [whole[:chance.randrange(1, len(whole))] for _ in range(100)]
    return found


def test_damage_is_refused_or_harmless(tmp_path: Path, whole: bytes) -> None:
    path, refused = tmp_path / 'campaign.db', 0
    expected = {'facts': {'': FACTS}, 'row': ROWS}
    for data in damages(whole):
        path.write_bytes(data)
        try:
            assert read_record(path) == expected
        except UsageError:
            refused += 1
            with pytest.raises(UsageError):
                examine_record(path)
    assert refused > 350


@pytest.mark.nightly
def test_a_repaired_record_has_true_entries_only_and_says_that_some_are_lost(
    tmp_path: Path, whole: bytes
) -> None:
    repairs = 0
    for number, data in enumerate(damages(whole)[::5]):
        path = tmp_path / str(number) / 'campaign.db'
        path.parent.mkdir()
        path.write_bytes(data)
        try:
            why = repair_record(path)
        except UsageError:
            assert path.read_bytes() == data
            continue
        if not why:
            continue
        repairs += 1
        assert path.with_name('campaign.db.damaged-1').read_bytes() == data
        with pytest.raises(UsageError, match='was damaged'):
            read_record(path)
        with Record(path) as record:
            kept = {kind: values for kind, values in record.entries.items() if kind != 'lost'}
            repaired(record)
        assert read_record(path) == kept
        assert kept.get('row', {}).items() <= ROWS.items()
        assert kept.get('facts', {'': FACTS}) == {'': FACTS}
    assert repairs > 30


def test_a_journal_of_an_earlier_state_is_refused_and_undoes_nothing(tmp_path: Path) -> None:
    """As a running campaign's is that was copied, and the file once more after its end."""
    path, copied = make(tmp_path / 'campaign.db'), b''
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute('PRAGMA cache_size = 1')  # so that the journal is on the disk at once
    connection.execute('BEGIN IMMEDIATE')
    for row in range(40):
        connection.execute("INSERT INTO entries VALUES ('row', ?, ?, x'00')", (row, 'x' * 9000))
    copied = Path(f'{path}-journal').read_bytes()
    connection.execute('ROLLBACK')
    connection.close()
    with Record(path) as record:
        for index in range(3):
            record.put('row', f'more {index}', index)
    assert copied
    now = path.read_bytes()
    Path(f'{path}-journal').write_bytes(copied)
    for attempt in (read_record, Record, record_kinds):
        with pytest.raises(UsageError, match='-journal: is of an earlier state'):
            attempt(path)
    assert path.read_bytes() == now
    Path(f'{path}-journal').unlink()
    assert len(read_record(path)['row']) == 43


def test_what_a_journal_has_behind_its_own_pages_is_of_no_account(tmp_path: Path) -> None:
    """One journal serves all changes, so that of a short one ends with pages of a longer one."""
    path = make(tmp_path / 'campaign.db')
    header, first = bytes.fromhex('d9d505f920a163d7'), bytearray(path.read_bytes()[:4096])
    first[24:28] = bytes(4)  # changed 0 times
    behind = (1).to_bytes(4) + bytes(first) + bytes(4)
    for pages in (1, 0):
        sizes = [pages, 0, len(path.read_bytes()) // 4096, 512, 4096]
        start = header + b''.join(size.to_bytes(4) for size in sizes)
        Path(f'{path}-journal').write_bytes(start.ljust(512, b'\0') + behind)
        if pages:
            with pytest.raises(UsageError, match='-journal: is of an earlier state'):
                read_record(path)
        else:
            assert read_record(path)['row'] == ROWS


def test_one_journal_serves_all_changes_and_is_removed_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / 'campaign.db'
    journal = Path(f'{path}-journal')
    with Record(path) as record:
        record.put('facts', '', FACTS)
        one = journal.stat().st_ino
        for key, row in ROWS.items():
            record.put('row', key, row)
            assert journal.stat().st_ino == one
        left = journal.read_bytes()
    assert not journal.exists()
    journal.write_bytes(left)  # as a killed command leaves it
    assert read_record(path) == {'facts': {'': FACTS}, 'row': ROWS}


def test_a_change_by_another_program_is_noticed_at_the_next_entry(tmp_path: Path) -> None:
    path = make(tmp_path / 'campaign.db')
    with Record(path) as record:
        connection = sqlite3.connect(path, isolation_level=None)
        connection.execute('UPDATE total SET number = 7')
        connection.close()
        with pytest.raises(RecordError, match='changed by another program'):
            record.put('row', 'more', 1)


def test_entries_behind_a_damaged_index_are_seen(tmp_path: Path) -> None:
    path = make(tmp_path / 'campaign.db')
    data, hidden = path.read_bytes(), 0
    for found in re.finditer(b'facts', data):
        damaged = bytearray(data)
        damaged[found.start()] ^= 2
        path.write_bytes(damaged)
        try:
            there = read_entry(path, 'facts')
        except UsageError:
            continue
        if there is None:
            hidden += 1
            assert 'facts' in record_kinds(path)
        else:
            assert there == FACTS
    assert hidden


def test_lost_and_exchanged_entries_are_found(tmp_path: Path) -> None:
    for statement in (
        "DELETE FROM entries WHERE key = '00000003'",
        "UPDATE entries SET key = '00000099' WHERE key = '00000003'",
        "UPDATE entries SET value = '{}' WHERE key = '00000003'",
        'UPDATE total SET number = 3',
        'DELETE FROM total',
    ):
        path = make(tmp_path / f'{abs(hash(statement))}' / 'campaign.db')
        connection = sqlite3.connect(path)
        connection.execute(statement)
        connection.commit()
        connection.close()
        with pytest.raises(UsageError, match='damaged'):
            read_record(path)


@pytest.mark.parametrize('data', [b'', b'not a database', b'{"json": 1}\n' * 500])
def test_other_files_are_named(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / 'campaign.db'
    path.write_bytes(data)
    with pytest.raises(UsageError, match=r'campaign\.db: '):
        read_record(path)


def test_another_version_is_refused_by_name_and_left_as_it_is(tmp_path: Path) -> None:
    path = make(tmp_path / 'campaign.db')
    connection = sqlite3.connect(path)
    connection.execute('PRAGMA user_version = 2')
    connection.close()
    before = path.read_bytes()
    for attempt in (read_record, Record, repair_record):
        with pytest.raises(UsageError, match='format 2, expected 1'):
            attempt(path)
    assert path.read_bytes() == before


def test_a_full_disk_ends_the_change_and_keeps_what_was_there(tmp_path: Path) -> None:
    path = make(tmp_path / 'campaign.db')
    code = f"""
import resource
from pathlib import Path
from taxinet_ros.files.record import Record
import signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
with Record(Path({str(path)!r})) as record:
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
    try:
        record.put('row', 'long', 'x' * 100_000)
    except OSError as error:
        print(error.filename, error.errno)
"""
    told = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert told.stdout.startswith(f'{path} ')
    assert read_record(path)['row'] == ROWS
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 20_000


@pytest.mark.parametrize('how', ['moved', 'deleted', 'replaced', 'folder'])
def test_a_file_that_is_gone_is_noticed_at_the_next_entry(tmp_path: Path, how: str) -> None:
    path = make(tmp_path / 'one' / 'campaign.db')
    with Record(path) as record:
        if how == 'folder':
            path.parent.rename(tmp_path / 'other')
        elif how == 'moved':
            path.rename(path.with_name('other.db'))
        else:
            data = path.read_bytes()
            path.unlink()
            if how == 'replaced':
                path.write_bytes(data)
        with pytest.raises(RecordError, match='was moved, deleted or replaced'):
            record.put('row', 'more', 1)
    there = {'moved': path.with_name('other.db'), 'folder': tmp_path / 'other' / path.name}
    if how in there:
        assert read_record(there[how])['row'] == ROWS, 'nothing is written where it is now'

