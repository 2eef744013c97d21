"""Parquet tables without their record: no flipped bit changes what is read."""

from __future__ import annotations

import random

import pandas as pd

from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_parquet
from taxinet_ros.trials.record.table import read_any_table

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
