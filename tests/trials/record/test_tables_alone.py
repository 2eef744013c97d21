"""Parquet tables without their record: no flipped bit changes what is read."""

from __future__ import annotations

import random

import pandas as pd
import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_parquet
from taxinet_ros.trials.record.table import read_any_table, read_table

FRAME = pd.DataFrame({
    'run_id': pd.Series([f'r-{n}' for n in range(30)], dtype='string'), 'index': range(30),
    'program': 'nominal', 'outcome': ['PASS', 'FAIL'] * 15,
    'rho': [0.5, -0.5] * 15, 'rho_near': [0.5, -0.5] * 15,
})


def test_given_a_table_when_written_then_pandas_and_we_read_it_with_its_attributes(tmp_path):
    path, again = tmp_path / 'a.parquet', tmp_path / 'b.parquet'
    frame = FRAME.copy()
    frame.attrs['stacks'] = {'a': {'version': '1'}}
    for one in (path, again):
        write_parquet(one, frame)
    assert path.read_bytes() == again.read_bytes()
    frame.to_parquet(again, index=False, write_page_checksum=True)
    assert path.read_bytes() == again.read_bytes()
    for found in (pd.read_parquet(path), read_any_table(path)):
        assert found.attrs == frame.attrs
        assert found['rho'].tolist() == frame['rho'].tolist()
        assert list(found.columns) == list(frame.columns)


@pytest.mark.nightly
def test_given_any_flipped_bit_then_the_table_is_refused_by_name_or_the_same(tmp_path):
    path = tmp_path / 'runs.parquet'
    write_parquet(path, FRAME)
    sound, frame, refused = path.read_bytes(), read_any_table(path), 0
    for bit in random.Random(6).sample(range(8 * len(sound)), 4000):
        data = bytearray(sound)
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        try:
            found = read_any_table(path)
        except UsageError:
            refused += 1
        else:
            pd.testing.assert_frame_equal(found, frame)
    assert refused > 2000


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
