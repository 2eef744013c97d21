"""Bags say on what they were recorded; equal runs of two checkouts are equal files all the same."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from bag_edits import GOLDEN
from bag_samples import samples, topics

from taxinet_ros.bag.checkup import check_bag
from taxinet_ros.bag.facts import made_on
from taxinet_ros.bag.golden import STACK_FILE, same_stack, stack_differences
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.recover import recover
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.cli.main import _exit_code, app
from taxinet_ros.core.provenance import COMMIT, provenance, without_commit

RECORD = {**without_commit(provenance()), 'taxinet_ros_version': provenance()['taxinet_ros']}


def write(folder: Path, commit: str, **changes: str) -> Path:
    """A bag that tells what it was made on."""
    with BagWriter(
        folder, topics(), metadata={**RECORD, **changes}, attachments={}, min_free_bytes=0,
        beside={COMMIT: commit},
    ) as bag:
        for topic, stamp_ns, cdr in samples(3):
            bag.write(topic, cdr, stamp_ns)
    return folder


def test_provenance_of_a_bag_is_read_back_with_its_commit(tmp_path):
    bag = write(tmp_path / 'run', 'c0ffee')
    assert made_on(read_info(bag)) == {**without_commit(provenance()), COMMIT: 'c0ffee'}
    assert made_on(read_info(GOLDEN / 'truth-nominal')) == {}, 'it is older than the record'
    description = next(c for c in check_bag(bag).checks if c.name == 'description')
    assert not description.findings


def test_provenance_two_checkouts_of_equal_code_write_equal_storage_files(tmp_path):
    one, other = (write(tmp_path / commit / 'run', commit) for commit in ('a', 'b'))
    assert (one / 'run_0.mcap').read_bytes() == (other / 'run_0.mcap').read_bytes()
    assert (one / METADATA_FILE).read_text() != (other / METADATA_FILE).read_text()


def test_provenance_outlives_recovery(tmp_path):
    bag = write(tmp_path / 'run', 'c0ffee')
    recover(bag, tmp_path / 'new' / 'run')
    assert made_on(read_info(tmp_path / 'new' / 'run')) == made_on(read_info(bag))


@pytest.mark.parametrize(('changes', 'said'), [
    ({}, ''),
    ({'numpy': '0.1', 'processor': 'Another One'}, 'processor'),
])
def test_provenance_of_bags_that_are_compared_is_told_where_it_differs(
    changes, said, tmp_path, capsys
):
    one, other = write(tmp_path / 'a' / 'run', 'c'), write(tmp_path / 'b' / 'run', 'c', **changes)
    code = _exit_code(lambda: app(['bag', 'compare', str(one), str(other)], standalone_mode=False))
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith('warning')]
    assert code == 0, 'the messages are the same'
    assert len(told) == bool(said)
    if said:
        assert f'processor {provenance()["processor"]} | Another One' in told[0]
        assert f'numpy {provenance()["numpy"]} | 0.1' in told[0]


def test_provenance_of_the_golden_bags_decides_whether_every_bit_counts(tmp_path):
    here = {'machine': provenance()['machine'], 'numpy': provenance()['numpy']}
    (tmp_path / STACK_FILE).write_text(json.dumps(here))
    assert same_stack(tmp_path)
    assert stack_differences(tmp_path) == ''
    (tmp_path / STACK_FILE).write_text(json.dumps({**here, 'numpy': '0.1'}))
    assert not same_stack(tmp_path)
    assert stack_differences(tmp_path) == f'numpy 0.1 | {provenance()["numpy"]}'
    shutil.rmtree(tmp_path)
    assert not same_stack(tmp_path)
