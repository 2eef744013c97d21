"""What a bag looks like to us and to others, and what the writer refuses.

Foxglove's own packages read one as well; that needs Node and, in ``NODE_PATH`` or an enclosing
``node_modules``: ``npm install @mcap/core @foxglove/rosmsg @foxglove/rosmsg2-serialization
fzstd``.
"""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import subprocess
from pathlib import Path

import bag_samples
import pytest
import yaml
from bag_samples import ATTACHMENTS, METADATA, STEP_NS, samples, topics, write_bag
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from whole_runs import STEPS, run_messages, write_run

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.reader import read_attachment, read_info, read_messages
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.topics import qos_profiles
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import dump_yaml

STEPS_WRITTEN = 4


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('bags') / 'campaign' / 'run_7'
    write_bag(folder, samples(STEPS_WRITTEN, shape=(120, 120)))
    return folder


def test_given_a_bag_when_read_back_then_every_message_is_there_in_order(bag: Path) -> None:
    read = [(m.topic, m.stamp_ns, m.cdr) for m in read_messages(bag)]
    assert len(read) == 1 + 6 * STEPS_WRITTEN
    assert read == samples(STEPS_WRITTEN, shape=(120, 120))
    assert {m.topic: m.type for m in read_messages(bag)} == bag_samples.TYPES
    names = [m.topic for m in read_messages(bag, ['/taxi_command'])]
    assert names == ['/taxi_command'] * STEPS_WRITTEN


def test_given_a_bag_when_its_contents_are_read_then_they_are_what_was_given(bag: Path) -> None:
    info = read_info(bag)
    assert (info.complete, info.trouble) == (True, '')
    assert info.topics == tuple(topics())
    assert info.counts == {
        name: 1 if name == '/scenario' else STEPS_WRITTEN for name in bag_samples.TYPES
    }
    assert (info.start_ns, info.end_ns) == (0, (STEPS_WRITTEN - 1) * STEP_NS)
    assert info.duration_s == pytest.approx(0.3)
    assert info.metadata['taxinet'] == METADATA
    assert info.attachments == ['manifest.json', *ATTACHMENTS]
    assert read_attachment(bag, 'scenario.scenic') == ATTACHMENTS['scenario.scenic']
    assert json.loads(read_attachment(bag, 'manifest.json'))['metadata'] == METADATA
    with pytest.raises(UsageError, match=r"no attachment 'x'; it has manifest\.json, scenario"):
        read_attachment(bag, 'x')


def test_given_a_bag_when_rosbags_reads_it_then_every_topic_yields_its_count(bag: Path) -> None:
    with Reader(bag) as reader:
        declared = {c.topic: c.msgcount for c in reader.connections}
        read = [(c.topic, stamp, bytes(raw)) for c, stamp, raw in reader.messages()]
    assert declared == read_info(bag).counts
    assert sorted(read) == sorted(samples(STEPS_WRITTEN, shape=(120, 120)))
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == '/taxi_command']
        angles = [
            reader.deserialize(raw, c.msgtype).steering_angle
            for c, _, raw in reader.messages(connections)
        ]
    assert angles == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_given_a_bag_when_mcap_ros2_decodes_it_then_values_and_frame_are_right(bag: Path) -> None:
    with (bag / 'run_7_0.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        header = reader.get_header()
        decoded = [(c.topic, m.sequence, d) for _, c, m, d in reader.iter_decoded_messages()]
        attachments = [a.name for a in reader.iter_attachments()]
        metadata = [m.name for m in reader.iter_metadata()]
    assert header.profile == 'ros2'
    assert header.library.startswith('taxinet_ros ')
    assert len(decoded) == 1 + 6 * STEPS_WRITTEN
    truth = [(n, d.cross_track_error) for t, n, d in decoded if t == '/ground_truth/tracking_error']
    assert truth == [(0, 0.0), (1, -0.5), (2, -1.0), (3, -1.5)]
    images = [d for t, _, d in decoded if t == '/camera/image_raw']
    assert bytes(images[2].data) == bag_samples.frame(2, (120, 120)).tobytes()
    assert attachments == ['manifest.json', *ATTACHMENTS]
    assert metadata == ['rosbag2', 'taxinet', 'rosbag2']


def test_given_a_bag_when_its_description_is_read_then_it_is_rosbag2_version_9(bag: Path) -> None:
    text = (bag / 'metadata.yaml').read_text()
    whole = yaml.safe_load(text)['rosbag2_bagfile_information']
    assert '&id' not in text
    assert dump_yaml(yaml.safe_load(text)) == text, 'as it is dumped whole'
    assert list(whole) == [
        'version', 'storage_identifier', 'duration', 'starting_time', 'message_count',
        'topics_with_message_count', 'compression_format', 'compression_mode',
        'relative_file_paths', 'files', 'custom_data', 'ros_distro',
    ]
    assert whole['version'] == 9
    assert whole['relative_file_paths'] == ['run_7_0.mcap']
    assert whole['custom_data'] == METADATA
    assert whole['files'] == [
        {
            'path': 'run_7_0.mcap',
            'starting_time': {'nanoseconds_since_epoch': 0},
            'duration': {'nanoseconds': (STEPS_WRITTEN - 1) * STEP_NS},
            'message_count': 1 + 6 * STEPS_WRITTEN,
        }
    ]
    profile = whole['topics_with_message_count'][0]['topic_metadata']['offered_qos_profiles'][0]
    assert (profile['durability'], profile['depth']) == ('transient_local', 1)
    assert profile['deadline'] == {'sec': 9223372036, 'nsec': 854775807}
    with (bag / 'run_7_0.mcap').open('rb') as stream:
        records = [m for m in make_reader(stream).iter_metadata() if m.name == 'rosbag2']
    first, last = (yaml.safe_load(m.metadata['serialized_metadata']) for m in records)
    assert last == whole
    assert (first['message_count'], first['version']) == (0, 9)
    told = [topic['topic_metadata'] for topic in whole['topics_with_message_count']]
    for outer, inner in zip(told, read_info(bag).topics, strict=True):
        assert outer['offered_qos_profiles'] == list(qos_profiles(inner.qos))
        assert outer['type_description_hash'] == inner.type_hash


def test_given_equal_runs_when_recorded_twice_then_the_files_are_equal(tmp_path: Path) -> None:
    one, two = (write_bag(tmp_path / k / 'run', samples(3)) for k in 'ab')
    assert one.read_bytes() == two.read_bytes()
    description = 'metadata.yaml'
    assert (one.parent / description).read_bytes() == (two.parent / description).read_bytes()
    other = write_bag(tmp_path / 'c' / 'run', samples(3)[:-1])
    assert one.read_bytes() != other.read_bytes()


def test_given_no_messages_when_closed_then_the_bag_is_whole_and_readable(tmp_path: Path) -> None:
    write_bag(tmp_path / 'empty', [])
    assert list(read_messages(tmp_path / 'empty')) == []
    assert read_info(tmp_path / 'empty').complete
    with Reader(tmp_path / 'empty') as reader:
        assert reader.message_count == 0


def test_given_stamps_out_of_order_when_recorded_then_range_and_order_hold(tmp_path: Path) -> None:
    (first, second, third) = [(t, s + 5, c) for t, s, c in samples(2)[1:4]]
    messages = [(second[0], 900, second[2]), first, (third[0], 7, third[2])]
    write_bag(tmp_path / 'run', messages)
    assert [m.stamp_ns for m in read_messages(tmp_path / 'run')] == [900, 5, 7]
    info = read_info(tmp_path / 'run')
    assert (info.start_ns, info.end_ns) == (5, 900)
    with Reader(tmp_path / 'run') as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == [5, 7, 900]


def test_given_late_words_when_closed_then_they_are_in_the_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'r', topics(), metadata={}, attachments={}, min_free_bytes=0) as bag:
        bag.attach('result.json', b'{"outcome": "PASS"}')
        bag.add_metadata('outcome', {'verdict': 'PASS'})
    assert read_info(tmp_path / 'r').metadata['outcome'] == {'verdict': 'PASS'}
    assert read_attachment(tmp_path / 'r', 'result.json') == b'{"outcome": "PASS"}'


def test_given_an_exception_when_recording_then_messages_stay_but_nothing_is_declared(
    tmp_path: Path,
) -> None:
    topic, stamp_ns, cdr = samples(1)[0]
    bag = BagWriter(tmp_path / 'r', topics(), metadata={}, attachments={}, min_free_bytes=0)

    def fail() -> None:
        with bag:
            bag.write(topic, cdr, stamp_ns)
            raise RuntimeError('simulator')

    with pytest.raises(RuntimeError, match='simulator'):
        fail()
    assert not (tmp_path / 'r' / 'metadata.yaml').exists()
    info = read_info(tmp_path / 'r')
    assert not info.complete
    assert 'no metadata.yaml' in info.trouble
    assert info.counts['/scenario'] == 1
    bag.abandon()
    with pytest.raises(BagError, match='closed'):
        bag.write(topic, cdr, stamp_ns)
    with pytest.raises(BagError, match='closed'):
        bag.close()


def test_given_an_existing_folder_when_opened_then_refused_and_left_alone(tmp_path: Path) -> None:
    before = write_bag(tmp_path / 'run', samples(1)).read_bytes()
    with pytest.raises(UsageError, match='already exists; nothing recorded'):
        write_bag(tmp_path / 'run', samples(2))
    assert (tmp_path / 'run' / 'run_0.mcap').read_bytes() == before


def test_given_too_little_space_when_opened_then_refused_and_no_folder_made(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match='GB free on the disk'):
        BagWriter(
            tmp_path / 'run', topics(), metadata={}, attachments={}, min_free_bytes=10**18
        )
    assert not (tmp_path / 'run').exists()


def test_given_bad_messages_when_written_then_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'r', topics(), metadata={}, attachments={}, min_free_bytes=0) as bag:
        with pytest.raises(UsageError, match="'/nowhere' is not in bag"):
            bag.write('/nowhere', b'', 0)
        for stamp in (-1, 2**63):
            with pytest.raises(UsageError, match=f'stamp {stamp} ns'):
                bag.write('/taxi_command', b'', stamp)
        with pytest.raises(UsageError, match='give text for both'):
            bag.add_metadata('m', {'seed': 7})


@pytest.mark.parametrize(('change', 'reason'), [
    (None, 'no topics given'),
    ({}, 'given twice'),
    ({'name': 'taxi_command'}, 'not an absolute ROS name'),
    ({'type': 'taxinet_msgs/TaxiCommand'}, 'not of the form package/msg/Name'),
    ({'qos': 'reliable'}, 'not a YAML list'),
    ({'qos': '['}, 'not a YAML list'),
    ({'type_hash': ''}, 'not RIHS01_'),
])
def test_given_a_malformed_topic_when_opened_then_refused(
    tmp_path: Path, change: dict[str, str] | None, reason: str
) -> None:
    first = topics()[0]
    chosen = [] if change is None else [first, dataclasses.replace(first, **change)]
    with pytest.raises(UsageError, match=reason):
        BagWriter(tmp_path / 'run', chosen[-1:] if change else chosen, metadata={}, attachments={})
    assert not (tmp_path / 'run').exists()


READER = Path(__file__).with_name('read_with_mcap_core.cjs')
NODE = shutil.which('node')


def has_packages() -> bool:
    words = ['node', '-e', "require('@mcap/core'); require('@foxglove/rosmsg2-serialization')"]
    return NODE is not None and subprocess.run(
        words, capture_output=True, cwd=READER.parent, check=False
    ).returncode == 0


@pytest.mark.skipif(NODE is None, reason='no Node on this machine')
def test_given_a_run_when_foxgloves_packages_read_it_then_values_are_the_same(
    tmp_path: Path,
) -> None:
    if not has_packages():
        pytest.skip('no @mcap/core; see the head of this file for what to install')
    bag = write_run(tmp_path / 'run')
    done = subprocess.run(
        ['node', str(READER), str(bag)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, '')
    read = json.loads(done.stdout)
    assert read['profile'] == 'ros2'
    assert sum(read['counts'].values()) == len(run_messages())
    assert read['counts']['/camera/image_raw'] == STEPS
    assert read['angles'] == open_recording(bag).columns['steering_rad'].tolist()
    assert read['attachments'] == ['manifest.json', 'scenario.json']


@pytest.mark.skipif(shutil.which('rerun') is None, reason='no rerun-sdk on this machine')
def test_given_a_run_when_rerun_checks_it_then_every_topic_is_in_order(tmp_path: Path) -> None:
    done = subprocess.run(
        ['rerun', 'mcap', 'check', str(write_run(tmp_path / 'run'))],
        capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = re.findall(r'^(\w+) +\d+ +\d+ +(/\S+)', done.stdout, re.MULTILINE)
    assert {result for result, _ in rows} == {'ok'}
    assert {topic for _, topic in rows} == {topic for topic, _, _ in run_messages()}
