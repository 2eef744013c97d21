"""What other recorders may write is no damage: every command reads the run in it all the same."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Schema
from mcap.writer import IndexType, Writer
from whole_runs import STEPS, run_messages, write_run

from taxinet_ros.bag.check.compare import compare_bags
from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.check.judge import judge_runs
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.bag.run.judging import BagVerdict
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.files.plain_values import load_yaml


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp('whole') / 'run')


def rewritten(
    source: Path, path: Path, schema: Callable[[Schema], bytes] = lambda schema: schema.data,
    extra: Callable[[Writer], None] = lambda writer: None, **writer: object,
) -> Path:
    """The bag as MCAP's own writer writes it, with other definitions and more in it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with source.open('rb') as old, path.open('wb') as new:
        out = Writer(new, **writer)
        out.start(profile='ros2')
        extra(out)
        channels: dict[int, int] = {}
        for kind, channel, message in make_reader(old).iter_messages(log_time_order=False):
            assert kind is not None
            if channel.id not in channels:
                number = out.register_schema(kind.name, kind.encoding, schema(kind))
                channels[channel.id] = out.register_channel(
                    channel.topic, channel.message_encoding, number, channel.metadata)
            out.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time)
        out.finish()
    return path


def add(
    writer: Writer, topic: str, encoding: str, data: bytes,
    schema: tuple[str, str, bytes] | None = None,
) -> None:
    """One message of another form."""
    number = 0 if schema is None else writer.register_schema(*schema)
    writer.add_message(writer.register_channel(topic, encoding, number), 10**8, data, 10**8)


EXTRA = {
    'JSON without schema': lambda w: add(w, '/chatter', 'json', b'{}'),
    'JSON': lambda w: add(w, '/chatter', 'json', b'{}', ('thing', 'jsonschema', b'{}')),
    'Protobuf': lambda w: add(w, '/chatter', 'protobuf', b'\1', ('a.B', 'protobuf', b'\1')),
    'JSON on a topic of ours': lambda w: add(w, '/left/taxi_command', 'json', b'{}'),
    'an empty type': lambda w: add(
        w, '/trigger', 'cdr', b'\0\1\0\0\0', ('std_msgs/msg/Empty', 'ros2msg', b'')),
    'a type that nobody has': lambda w: add(
        w, '/odd', 'cdr', b'\0\1\0\0\0', ('odd_msgs/msg/Odd', 'ros2idl', b'module odd')),
}
FORMS: dict[str, dict[str, object]] = {
    **{name: {'extra': extra} for name, extra in EXTRA.items()},
    'CRLF': {'schema': lambda schema: schema.data.replace(b'\n', b'\r\n')},
    'empty definitions': {'schema': lambda schema: b''},
    'no summary': {'use_statistics': False, 'use_summary_offsets': False, 'repeat_channels': False},
    'no index': {'index_types': IndexType.NONE},
    'no chunks': {'use_chunking': False},
    'none': {},
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize('form', FORMS)
def test_given_a_legal_form_then_the_run_is_whole_judged_and_compared_as_before(
    form: str, whole: Path, tmp_path: Path
) -> None:
    bag = rewritten(whole, tmp_path / 'x.mcap', **FORMS[form])
    assert [(one.where, one.what) for one in check_bag(bag).findings] == []
    (judged,), (expected,) = judge_runs(bag), judge_runs(whole)
    assert judged.verdicts == expected.verdicts
    assert judged.sound
    others = {'/chatter', '/trigger', '/odd', '/left/taxi_command'}
    assert all(one.equal for one in compare_bags(whole, bag) if one.topic not in others)
    assert len(open_recording(bag).one.trace) == STEPS


@pytest.mark.one_in(3)
@pytest.mark.parametrize('form', EXTRA)
def test_given_topics_of_another_form_then_no_command_refuses_the_bag(
    form: str, whole: Path, tmp_path: Path, taxinet: Callable[..., tuple[int, str, str]]
) -> None:
    bag = rewritten(whole, tmp_path / 'x.mcap', extra=EXTRA[form])
    for words in (
        ('bag', 'info', bag), ('monitor', bag), ('doctor', bag),
        ('bag', 'compare', bag, bag), ('bag', 'split', bag, '--out', tmp_path / 'runs'),
        ('bag', 'export', bag, '--out', tmp_path / 'table.csv'),
        ('bag', 'export', bag, '--out', tmp_path / 'tables'),
    ):
        assert taxinet(*words)[0] == 0, words
    code, out, _ = taxinet('bag', 'recover', bag, '--out', tmp_path / 'new')
    kept = form == 'an empty type'
    assert (code, 'damage: left out: ' in out) == (0 if kept else 3, not kept)


def test_given_a_recorder_without_checksums_then_every_command_says_so(
    whole: Path, tmp_path: Path, taxinet: Callable[..., tuple[int, str, str]]
) -> None:
    assert open_recording(whole).info.unchecked == ''
    bag = rewritten(whole, tmp_path / 'x.mcap', enable_crcs=False)
    for words in (
        ('monitor', bag), ('bag', 'info', bag), ('doctor', bag),
        ('bag', 'recover', bag, '--out', tmp_path / 'saved'),
    ):
        code, out, _ = taxinet(*words)
        assert (code, '168 of 168 messages have no checksum' in out) == (0, True), words
        assert 'under the checksums' not in out


def test_given_an_empty_definition_of_another_version_then_no_message_is_made_up(
    whole: Path, tmp_path: Path
) -> None:
    def odd(writer: Writer) -> None:
        number = writer.register_schema('taxinet_msgs/msg/TaxiCommand', 'ros2msg', b'')
        channel = writer.register_channel(
            '/taxi_command', 'cdr', number, {'topic_type_hash': f'RIHS01_{"0" * 64}'})
        writer.add_message(channel, 0, b'\0\1\0\0' + bytes(60), 0)

    bag = rewritten(whole, tmp_path / 'x.mcap', extra=odd)
    assert any('carries no ros2msg definition' in one.what for one in check_bag(bag).findings)
    (judged,) = judge_runs(bag)
    assert not judged.sound


def test_given_a_whole_bag_without_metadata_yaml_then_folder_and_file_are_judged_alike(
    whole: Path, tmp_path: Path
) -> None:
    bag = shutil.copytree(whole.parent, tmp_path / 'run')
    (bag / 'metadata.yaml').unlink()
    (by_folder,), (by_file,) = judge_runs(bag), judge_runs(bag / whole.name)
    assert by_folder.verdicts == by_file.verdicts
    assert by_folder.sound
    (found,) = check_bag(bag).findings
    assert 'no metadata.yaml' in found.what
    assert 'recover' in found.fix


@pytest.mark.parametrize(('name', 'content', 'reason'), [
    ('run_2.mcap', b'', 'run_2.mcap: has no bytes'),
    ('run_0.mcap', b'', 'run_0.mcap: has no bytes'),
    ('run_2.mcap', b'something else', 'run_2.mcap: not an MCAP file'),
])
def test_given_a_split_bag_with_an_unreadable_file_then_the_others_are_read_and_it_is_named(
    name: str, content: bytes, reason: str, whole: Path, tmp_path: Path,
    taxinet: Callable[..., tuple[int, str, str]],
) -> None:
    bag = tmp_path / 'run'
    bag.mkdir()
    (bag / 'run_1.mcap').write_bytes(whole.read_bytes())
    (bag / name).write_bytes(content)
    expected = read_info(whole).count
    info = read_info(bag)
    assert (info.count, info.complete) == (expected, False)
    assert reason in info.trouble
    (found,) = check_bag(bag).findings
    assert f'{found.where}: {found.what}' == reason
    (judged,) = judge_runs(bag)
    assert reason in judged.trouble
    assert not judged.sound
    saved = recover(bag, tmp_path / 'saved')
    assert (saved.saved, len(saved.damage)) == (expected, 1)
    assert read_info(tmp_path / 'saved').complete
    code, out, _ = taxinet('bag', 'info', bag, '--json')
    assert (code, reason in json.loads(out)['trouble']) == (3, True)


def test_given_a_bag_renamed_or_described_anew_then_nothing_is_wrong(
    whole: Path, tmp_path: Path
) -> None:
    """As by ``ros2 bag reindex``, which keeps no words of the recorder's."""
    bag = tmp_path / 'other'
    bag.mkdir()
    shutil.copy(whole, bag / 'other_0.mcap')
    text = (whole.parent / 'metadata.yaml').read_text().replace('run_0.mcap', 'other_0.mcap')
    words = load_yaml(text)['rosbag2_bagfile_information']['custom_data']
    assert words
    for name, value in words.items():
        text = text.replace(f'    {name}: {value}\n', '')
    (bag / 'metadata.yaml').write_text(text.replace('custom_data:\n', 'custom_data: {}\n'))
    assert check_bag(bag).findings == ()


def test_given_an_odometry_that_cannot_be_decoded_then_nothing_that_reads_it_is_judged(
    whole: Path, tmp_path: Path
) -> None:
    messages = [
        (name, stamp, cdr[:40] if (name, stamp) == ('/ground_truth/odom', 3 * 10**8) else cdr)
        for name, stamp, cdr in run_messages()
    ]
    bag = write_run(tmp_path / 'run', messages)
    (judged,) = judge_runs(bag, [parse_spec('always(speed <= 30)')])
    assert 'not a nav_msgs/msg/Odometry' in judged.trouble
    assert [one.verdict for one in judged.verdicts] == [BagVerdict.INCOMPLETE]
