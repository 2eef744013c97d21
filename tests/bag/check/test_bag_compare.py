"""Two bags are the same, or the first differing topic, step and field is named.

Bags say on what they were recorded; equal runs of two checkouts are equal files all the same.
"""

from __future__ import annotations

import json
import math
import shutil
import struct
from pathlib import Path

import pytest
from bag_edits import SEEN, altered, unaltered
from bag_samples import STEP_NS, samples, serialise, step_messages, topics, write_bag
from mcap.writer import Writer

import taxinet_ros as tx
from taxinet_ros.bag.check.compare import (
    STACK_FILE,
    compare_bags,
    first_difference,
    same_stack,
    stack_differences,
)
from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.bag.run.facts import made_on
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.cli.main import _exit_code, app
from taxinet_ros.core.provenance import COMMIT, provenance, without_commit
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError

STEPS = 6


def bags(tmp_path: Path, topic: str, step: int, **fields) -> list[Path]:
    """Two sample bags; in the second one message has other fields."""
    messages = samples(STEPS)
    write_bag(tmp_path / 'one', messages)
    message = step_messages(step)[topic]
    for name, value in fields.items():
        setattr(message, name, value)
    changed = serialise(message)
    place = [(m[0], m[1]) for m in messages].index((topic, step * STEP_NS))
    messages[place] = (topic, step * STEP_NS, changed)
    write_bag(tmp_path / 'other', messages)
    return [tmp_path / 'one', tmp_path / 'other']


def differing(topics):
    return {topic.topic: topic for topic in topics if not topic.equal}


def test_given_one_number_changed_then_topic_step_and_field_are_named(tmp_path):
    topics = compare_bags(*bags(tmp_path, '/taxi_command', 4, speed=5.25))
    (found,) = differing(topics).values()
    assert (found.topic, found.differing, found.greatest) == ('/taxi_command', 1, 0.25)
    assert (found.first.number, found.first.seq, found.first.field) == (4, 4, 'speed')
    assert found.first.values == ('5.0', '5.25')
    assert first_difference(topics).seq == 4


def test_given_two_control_rates_then_messages_are_not_compared_by_their_number(tmp_path):
    for rate in (10.0, 20.0):
        run = tx.run(Scenario(duration_s=1.0, control_rate_hz=rate), perception='truth')
        run.save_bag(tmp_path / f'at{rate:g}', images=False)
    pair = [tmp_path / 'at10', tmp_path / 'at20']
    with pytest.raises(UsageError, match=r'at10 at 10 Hz, .*at20 at 20 Hz: messages are compared'):
        compare_bags(*pair)
    assert not differing(compare_bags(pair[1], pair[1]))


@pytest.mark.parametrize(('field', 'value', 'tolerance', 'equal'), [
    ('speed', 5.25, 0.0, False), ('speed', 5.25, 0.2, False), ('speed', 5.25, 0.25, True),
    ('speed', math.nextafter(5.0, 6.0), 0.0, False), ('speed', math.nan, 0.0, False),
    ('speed', math.inf, 0.0, False), ('steering_angle', -0.0, 0.0, False),
    ('steering_angle', -0.0, 1e-12, True), ('run_id', 'other', 0.0, True),
])
def test_given_a_field_changed_then_the_last_bit_counts_unless_tolerated(
    tmp_path, field, value, tolerance, equal
):
    pair = bags(tmp_path, '/taxi_command', 0, **{field: value})
    found = compare_bags(*pair, tolerance=tolerance)
    assert list(differing(found)) == ([] if equal else ['/taxi_command'])
    if value == 5.25:
        assert max(topic.greatest for topic in found) == 0.25


def foreign(path: Path, numbers, kind='x_msgs/msg/A') -> Path:
    """A bag of another recorder, with one message that holds an array of numbers."""
    with path.open('wb') as file:
        bag = Writer(file)
        bag.start(profile='ros2')
        schema = bag.register_schema(kind, 'ros2msg', b'float64[3] v')
        channel = bag.register_channel('/a', 'cdr', schema)
        bag.add_message(channel, 10, b'\0\1\0\0' + struct.pack('<3d', *numbers), 10)
        bag.finish()
    return path


def test_given_minus_zero_against_zero_in_an_array_then_it_differs_unless_tolerated(tmp_path):
    pair = [foreign(tmp_path / f'{x}.mcap', (1.0, x, math.nan)) for x in (0.0, -0.0)]
    (found,) = differing(compare_bags(*pair)).values()
    assert (found.first.field, found.first.values) == ('v[1]', ('0.0', '-0.0'))
    assert not differing(compare_bags(*pair, tolerance=1e-12))
    assert not differing(compare_bags(pair[0], pair[0]))


@pytest.mark.parametrize('tolerance', [0.0, 1e9])
def test_given_the_same_bytes_of_another_type_then_the_types_are_named(tmp_path, tolerance):
    pair = [
        foreign(tmp_path / f'{kind}.mcap', (0.0, 1.0, 2.0), f'x_msgs/msg/{kind}')
        for kind in ('A', 'B')
    ]
    (found,) = differing(compare_bags(*pair, tolerance=tolerance)).values()
    assert (found.first.field, found.first.values) == ('type', ('x_msgs/msg/A', 'x_msgs/msg/B'))


@pytest.mark.parametrize('tolerance', [0.0, 1e9])
def test_given_a_whole_number_or_a_word_changed_then_no_tolerance_helps(tmp_path, tolerance):
    pair = bags(tmp_path, '/monitor/robustness', 3, spec='phi_always', samples=9)
    (found,) = differing(compare_bags(*pair, tolerance=tolerance)).values()
    assert found.first.field == 'spec'
    assert found.first.values == ("'phi_eventually'", "'phi_always'")


def test_given_a_pixel_changed_then_its_place_is_named(tmp_path):
    pixels = step_messages(2)['/camera/image_raw'].data.copy()
    pixels[10] ^= 1
    pair = bags(tmp_path / 'pair', '/camera/image_raw', 2, data=pixels)
    (found,) = differing(compare_bags(*pair, tolerance=300.0)).values()
    assert (found.first.seq, found.first.field) == (2, 'data[10]')


def test_given_messages_or_a_topic_missing_then_the_counts_tell(tmp_path):
    assert not differing(same := compare_bags(SEEN, SEEN))
    assert (sum(topic.counts[0] for topic in same) > 900, first_difference(same)) == (True, None)
    short = altered(
        SEEN, tmp_path / 'short', unaltered,
        keep=lambda m: m.stamp_ns < 11_900_000_000 and m.topic.name != '/taxi_command',
    )
    found = differing(compare_bags(SEEN, short))
    assert found['/taxi_command'].counts == (121, 0)
    assert found['/ground_truth/odom'].counts == (121, 119)
    assert found['/ground_truth/odom'].first is None
    assert not found['/ground_truth/odom'].differing
    skipped = compare_bags(SEEN, short, skip=['/taxi_command'])
    assert '/taxi_command' not in [topic.topic for topic in skipped]


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
    structure = next(c for c in check_bag(bag).checks if c.name == 'structure')
    assert not structure.findings
    recover(bag, tmp_path / 'new' / 'run')
    assert made_on(read_info(tmp_path / 'new' / 'run')) == made_on(read_info(bag))


def test_provenance_two_checkouts_of_equal_code_write_equal_storage_files(tmp_path):
    one, other = (write(tmp_path / commit / 'run', commit) for commit in ('a', 'b'))
    assert (one / 'run_0.mcap').read_bytes() == (other / 'run_0.mcap').read_bytes()
    assert (one / METADATA_FILE).read_text() != (other / METADATA_FILE).read_text()


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
