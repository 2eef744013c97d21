"""A recorded run on its topics again: whole, at the recorded pace, and listened to like a live one.

A perception that runs freely beside it answers as it did in the lockstep, to the bit.
"""

from __future__ import annotations

import signal
from pathlib import Path
from types import SimpleNamespace

import pytest
from graph_runs import parameters, spin, start_node
from mcap.writer import Writer
from playing import listening, make_player, playing
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool

from taxinet_ros.bag.playback import open_bag, portions, window
from taxinet_ros.bag.reader import read_messages
from taxinet_ros.bag.topics import is_type_name, message_definition
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface

pytestmark = pytest.mark.ros

STEPS = 21
STEP_NS = 100_000_000
ESTIMATE = interface.ESTIMATE
RENAMED = f'recorded/{ESTIMATE.name}'


def same(heard: list[bytes], recorded: list[bytes]) -> bool:
    """Whether these are the recorded bytes; on its way a message is filled up to four."""
    assert len(heard) == len(recorded) > 0
    return all(
        got.rstrip(b'\0') == sent.rstrip(b'\0') and 0 <= len(got) - len(sent) < 4
        for got, sent in zip(heard, recorded, strict=True)
    )


@pytest.mark.nightly
def test_given_a_perception_beside_the_player_then_its_estimates_are_the_recorded_ones(bag):
    renamed = {RENAMED: ESTIMATE}
    with listening(ESTIMATE, interface.CLOCK, **renamed) as (listener, executor, context):
        domain = context.get_domain_id()
        perception = start_node('taxinet_perception', domain)
        ear = next(e for e in listener.ears if e.topic_name == f'/{ESTIMATE.name}')
        try:
            spin(executor, lambda: ear.get_publisher_count() == 1)
            player = start_node('bag_player', domain, *parameters(
                f'bag:={bag}',
                'wait_for:=["camera/image_raw", "perception/tracking_error", "/clock"]',
            ), '-r', f'{ESTIMATE.name}:={RENAMED}')
            spin(executor, lambda: player.poll() is not None)
            _, said = player.communicate()
            spin(executor, lambda: len(listener.heard[ESTIMATE.name]) == STEPS)
        finally:
            perception.terminate()
            perception.communicate()
    assert player.returncode == 0, said
    assert 'played' in said
    recorded = [m.cdr for m in read_messages(bag, [f'/{ESTIMATE.name}'])]
    assert same(listener.heard[RENAMED], recorded)
    assert len(listener.heard[interface.CLOCK.name]) == STEPS
    fresh, old = (
        [deserialize_message(cdr, ESTIMATE.type) for cdr in cdrs]
        for cdrs in (listener.heard[ESTIMATE.name], recorded)
    )
    assert fresh == old
    assert len({estimate.cross_track_error for estimate in fresh}) == STEPS


def test_given_a_window_when_played_then_it_is_that_part_after_what_was_latched_before(bag):
    topics = (interface.SCENARIO, interface.ODOMETRY, interface.COMMAND)
    with (
        listening(*topics) as (listener, executor, context),
        playing(
            context, executor, bag, rate=10.0, start_offset=0.5, playback_duration=1.0,
            exclude=['taxi_command', '/camera/image_raw', '/clock'],
            wait_for=['scenario', '/ground_truth/odom'],
        ) as player,
    ):
        assert player.play(executor) == 0
        spin(executor, lambda: len(listener.heard['ground_truth/odom']) == 11)
        assert '/clock' not in dict(player.get_publisher_names_and_types_by_node(
            'bag_player', '/'
        ))
    recorded = list(read_messages(bag, ['/ground_truth/odom']))
    expected = [m.cdr for m in recorded if 5 * STEP_NS <= m.stamp_ns <= 15 * STEP_NS]
    assert same(listener.heard['ground_truth/odom'], expected)
    assert same(listener.heard['scenario'], [m.cdr for m in read_messages(bag, ['/scenario'])])
    assert listener.heard['taxi_command'] == []


def test_given_a_pause_amid_the_run_when_it_goes_on_then_the_rest_follows(bag):
    odometry = interface.ODOMETRY
    with (
        listening(odometry) as (listener, executor, context),
        playing(context, executor, bag, rate=4.0, wait_for=[odometry.name]) as player,
    ):
        heard = listener.heard[odometry.name]
        client = listener.create_client(SetBool, '/bag_player/pause')
        spin(executor, client.service_is_ready)

        def pause() -> None:
            if heard:
                timer.cancel()
                client.call_async(SetBool.Request(data=True)).add_done_callback(
                    lambda _: client.call_async(SetBool.Request(data=False)))

        timer = listener.create_timer(0.01, pause)
        assert player.play(executor) == 0
        assert timer.is_canceled()
        spin(executor, lambda: len(heard) == STEPS)
        client.destroy()


def test_given_nobody_to_listen_when_the_time_is_up_then_that_is_said(bag, capfd):
    with (
        listening() as (_, executor, context),
        playing(context, executor, bag, wait_for=['taxi_command'], wait_timeout=0.1) as player,
    ):
        assert player.play(executor) == 4
    (line,) = capfd.readouterr().err.splitlines()[-1:]
    assert 'error: bag_player: no subscriber on /taxi_command within 0.1 s' in line


def test_given_a_loop_when_interrupted_after_the_second_round_then_the_player_ends_with_130(bag):
    with listening(interface.CLOCK) as (listener, executor, context):
        player = start_node('bag_player', context.get_domain_id(), *parameters(
            f'bag:={bag}', 'loop:=true', 'rate:=10.0', 'wait_for:=["/clock"]',
            'exclude:=["camera/image_raw"]',
        ))
        heard = listener.heard[interface.CLOCK.name]
        spin(executor, lambda: len(heard) > 2 * STEPS)
        player.send_signal(signal.SIGINT)
        _, said = player.communicate()
    assert player.returncode == 130
    assert 'Traceback' not in said
    assert same(heard[:STEPS], heard[STEPS : 2 * STEPS])


@pytest.mark.parametrize(
    ('given', 'words'),
    [
        ({'bag': ''}, 'is required'),
        ({'bag': 'nowhere'}, 'nowhere'),
        ({'rate': 0.0}, 'allowed: 0.01..1000.0'),
        ({'start_offset': 9.0}, 'is 2 s long'),
        ({'exclude': ['/taxi_comand']}, 'has no topic /taxi_comand; it has /camera'),
        ({'wait_for': ['/clock'], 'exclude': ['/clock']}, 'remove it from one'),
        ({'speed': 2.0}, "unknown parameter 'speed'"),
    ],
)
def test_given_a_bad_parameter_then_one_line_says_what_is_wrong(given, words, bag):
    with listening() as (_, _, context), pytest.raises(UsageError) as caught:
        make_player(context, **{'bag': bag, **given})
    assert words in str(caught.value)
    assert '\n' not in str(caught.value)


def test_given_a_damaged_bag_when_it_is_to_be_played_then_recovery_is_proposed(bag, tmp_path):
    file = next(bag.glob('*.mcap'))
    torn = tmp_path / 'torn.mcap'
    torn.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(UsageError, match='taxinet bag recover'):
        open_bag(str(torn))


def test_given_a_bag_when_cut_into_portions_then_all_messages_are_there_in_order(bag):
    info = open_bag(str(bag))
    names = {topic.name for topic in info.topics}
    cut = list(portions(bag, names, window(info, 0.0, 0.0), set()))
    assert [p.stamp_ns for p in cut] == [k * STEP_NS for k in range(STEPS)]
    assert [m.cdr for p in cut for m in p.messages] == [m.cdr for m in read_messages(bag)]


def foreign_bag(path: Path, messages: list[tuple[str, str, str, float, bytes]]) -> Path:
    """A file of another recorder: topic, type, encoding, time [s] and bytes of each message."""
    channels = {}
    with path.open('wb') as file:
        writer = Writer(file)
        writer.start('ros2', 'another')
        for name, kind, encoding, time_s, data in messages:
            if (name, kind, encoding) not in channels:
                ros = is_type_name(kind)
                text = message_definition(kind).encode() if ros else b'{}'
                schema = writer.register_schema(kind, 'ros2msg' if ros else 'jsonschema', text)
                channels[name, kind, encoding] = writer.register_channel(name, encoding, schema)
            stamp_ns = round(time_s * 1e9)
            writer.add_message(channels[name, kind, encoding], stamp_ns, data, stamp_ns)
        writer.finish()
    return path


def text(word: str) -> bytes:
    return serialize_message(String(data=word))


STRING = ('/words', 'std_msgs/msg/String', 'cdr')


def test_messages_that_are_not_recorded_in_the_order_of_time_are_played_in_it(tmp_path):
    times_s = [7200.0, 7199.9, 3.0, 3600.0, 3600.0, 1.0]
    bag = foreign_bag(tmp_path / 'back.mcap', [
        (*STRING, time_s, text(str(number))) for number, time_s in enumerate(times_s)
    ])
    info = open_bag(str(bag))
    cut = list(portions(bag, {'/words'}, window(info, 0.0, 0.0), set(), info.back_ns))
    words = [deserialize_message(m.cdr, String).data for p in cut for m in p.messages]
    assert words == ['5', '2', '3', '4', '1', '0']
    assert [p.stamp_ns / 1e9 for p in cut] == [1.0, 3.0, 3600.0, 7199.9, 7200.0]


def test_what_is_no_message_of_its_topics_type_is_skipped_with_one_line_each(tmp_path, capfd):
    padded = serialize_message(JointState())  # rclpy leaves room for what is not there
    bag = foreign_bag(tmp_path / 'mixed.mcap', [
        ('/json', 'chatter', 'json', 0.0, b'{"data": 1}'),
        ('/proto', 'foxglove.Log', 'protobuf', 0.0, b'\x08\x01'),
        ('/short', 'std_msgs/String', 'cdr', 0.0, text('x')),
        ('/service', 'std_srvs/srv/SetBool_Event', 'cdr', 0.0, text('x')),
        ('/joints', 'sensor_msgs/msg/JointState', 'cdr', 0.0, padded),
        (*STRING, 0.0, text('a')), (*STRING, 0.1, b''), (*STRING, 0.1, text('bcd')[:-6]),
        ('/words', 'std_msgs/msg/Float64', 'cdr', 0.1, serialize_message(Float64(data=1.0))),
        *[(*STRING, 0.2, text(str(number))) for number in range(10)],
    ])
    words = SimpleNamespace(name='words', type=String, qos=QoSProfile(depth=100))
    with (
        listening(words) as (listener, executor, context),
        playing(context, executor, bag, wait_for=['words']) as player,
    ):
        assert player.play(executor) == 0
        spin(executor, lambda: len(listener.heard['words']) == 11)
    heard = [deserialize_message(cdr, String).data for cdr in listener.heard['words']]
    assert heard == ['a', *map(str, range(10))]
    lines = [line.partition(']: ')[2] for line in capfd.readouterr().err.splitlines()]
    assert [line for line in lines if line.startswith('skipping ')] == [
        'skipping /json: chatter in json',
        'skipping /proto: foxglove.Log in protobuf',
        'skipping /short: std_msgs/String is not installed',
        'skipping /service: std_srvs/srv/SetBool_Event is not installed',
        'skipping messages: topic /words: not a std_msgs/msg/String: '
        'Invalid or unsupported CDR encapsulation.',
    ]
    assert any(line.startswith('played 12 messages') for line in lines)
