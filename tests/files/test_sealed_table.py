"""Tables with a checksum of their own: no flipped bit is accepted, wherever they are copied."""

from __future__ import annotations

import random

import pandas as pd
import pyarrow.parquet
import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.files.sealed_table import is_sealed_table, write_table
from taxinet_ros.trials.record.table import read_any_table, read_table

FRAME = pd.DataFrame({
    'run_id': pd.Series([f'r-{n}' for n in range(30)], dtype='string'), 'index': range(30),
    'program': 'taxinet_sha256 taxinet_sealed', 'outcome': ['PASS', 'FAIL'] * 15,
    'rho': [0.5, -0.5] * 15, 'rho_near': [0.5, -0.5] * 15,
})


def test_given_a_table_when_written_then_pandas_and_we_read_it_with_its_attributes(tmp_path):
    path, again = tmp_path / 'a.parquet', tmp_path / 'b.parquet'
    frame = FRAME.copy()
    frame.attrs['stacks'] = {'a': {'version': '1'}}
    for one in (path, again):
        write_table(one, frame)
    assert path.read_bytes() == again.read_bytes()
    assert is_sealed_table(path, path.read_bytes())
    for found in (pd.read_parquet(path), read_any_table(path)):
        assert found.attrs == frame.attrs
        assert found['rho'].tolist() == frame['rho'].tolist()
        assert list(found.columns) == list(frame.columns)


def test_given_any_flipped_bit_then_the_table_is_refused_by_name(tmp_path):
    path = tmp_path / 'runs.parquet'
    write_table(path, FRAME)
    sound = path.read_bytes()
    marks = [sound.rfind(b'taxinet_sha256\x18'), sound.rfind(b'taxinet_sealed\x18')]
    assert min(marks) > 0
    around = [bit for mark in marks for bit in range(8 * (mark - 16), 8 * (mark + 96))]
    drawn = random.Random(6).sample(range(8 * len(sound)), 4000)
    refused = 0
    for bit in (*around, *drawn):
        data = bytearray(sound)
        if bit // 8 >= len(data):
            continue
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        with pytest.raises(UsageError, match=r'runs\.parquet: (was modified|damaged)'):
            read_any_table(path)
        refused += 1
    assert refused > 5000


def test_given_a_table_alone_then_only_one_of_pandas_is_unverified(tmp_path, capsys):
    write_table(tmp_path / 'own.parquet', FRAME)
    assert len(read_table(tmp_path / 'own.parquet')) == 30
    assert capsys.readouterr().err == ''
    read_table(tmp_path / 'own.parquet').to_parquet(tmp_path / 'pandas.parquet')
    assert not is_sealed_table(tmp_path / 'p', (tmp_path / 'pandas.parquet').read_bytes())
    assert len(read_table(tmp_path / 'pandas.parquet')) == 30
    assert 'pandas.parquet: is unverified' in capsys.readouterr().err


def test_given_a_table_that_was_edited_and_kept_the_checksum_then_it_is_refused(tmp_path):
    path = tmp_path / 'own.parquet'
    write_table(path, FRAME)
    pyarrow.parquet.write_table(pyarrow.parquet.read_table(path).slice(0, 10), path)
    with pytest.raises(UsageError, match=r'own\.parquet: was modified \(its SHA-256 differs\)'):
        read_table(path)


@pytest.mark.parametrize(('row', 'changes', 'said'), [
    (0, {'rho': -0.5}, 'PASS, but rho is not above 0'),
    (0, {'rho': None}, 'rho is not rho_near'),
    (0, {'rho': 0.75}, 'rho is not rho_near'),
    (1, {'rho': 0.5}, 'rho is not rho_near'),
    (2, {'outcome': 'INFRA_ERROR', 'rho_near': None}, 'a robustness without a verdict'),
])
def test_given_a_rho_that_is_not_the_headlines_then_the_row_is_named(
    tmp_path, row, changes, said
):
    frame = FRAME.copy()
    for name, value in changes.items():
        frame.loc[row, name] = value
    frame.to_parquet(tmp_path / 't.parquet')
    with pytest.raises(UsageError, match=rf't\.parquet: row {row + 1}: {said}'):
        read_table(tmp_path / 't.parquet')


@pytest.mark.parametrize(('row', 'rho', 'said'), [
    (0, 0.0, 'PASS, but rho is not above 0'), (1, 0.5, 'FAIL, but rho is above 0'),
])
def test_given_rho_alone_then_it_fits_the_outcome(tmp_path, row, rho, said):
    frame = FRAME.drop(columns='rho_near')
    frame.to_parquet(tmp_path / 't.parquet')
    assert len(read_table(tmp_path / 't.parquet')) == 30
    frame.loc[row, 'rho'] = rho
    frame.to_parquet(tmp_path / 't.parquet')
    with pytest.raises(UsageError, match=rf'row {row + 1}: {said}'):
        read_table(tmp_path / 't.parquet')
