"""Indices of experiments, analyses and data sets: damage of them or of what they name is found."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.files.sealed_json import read_sealed, write_sealed
from taxinet_ros.trials.doctor import examine


def test_given_any_flipped_bit_of_a_sealed_index_then_it_is_refused(tmp_path: Path) -> None:
    path, table = tmp_path / 'experiment.json', tmp_path / 'pairs.parquet'
    table.write_bytes(b'pairs')
    values = {'name': 'e', 'arms': {}, 'share': 0.25, 'none': None}
    write_sealed(path, values, [table])
    assert read_sealed(path).values == values
    data, chance = path.read_bytes(), random.Random(2)
    for _ in range(500):
        changed = bytearray(data)
        changed[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        path.write_bytes(changed)
        with pytest.raises(UsageError, match='damaged or edited') as caught:
            read_sealed(path)
        assert '\n' not in str(caught.value)
    path.write_bytes(data)
    assert not examine(tmp_path).findings
    table.write_bytes(b'qairs')
    (found,) = examine(tmp_path).findings
    assert found.what == 'is not the file recorded in experiment.json'
    with pytest.raises(UsageError, match='do it again'):
        read_sealed(path).check_file(table, 'do it again')
