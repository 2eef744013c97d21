"""Frames that a bag was recorded without come back bit for bit, or not at all."""

import shutil

import numpy as np
import pytest
from bag_edits import PERIOD_NS, STEPS, altered, driven_here, unaltered
from bag_samples import make, samples, serialise, write_bag
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from taxinet_ros.bag.cdr.image import image_cdr
from taxinet_ros.bag.errors import BagForeign
from taxinet_ros.bag.reader import read_info, stored_messages
from taxinet_ros.bag.rewrite.frames import (
    IMAGE,
    frame_messages,
    missing_frames,
    restore_frames,
    restore_in_place,
)
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.resimulation import WorldDiffers
from taxinet_ros.core.motion.controller import gains_text, is_steering_law, parse_gains
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.world import SimulatedWorld
from taxinet_ros.errors import UsageError

FRAMES = arrays.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3)))


@pytest.fixture(scope='module')
def blind(tmp_path_factory):
    """A bag without frames."""
    return driven_here(tmp_path_factory.mktemp('blind') / 'run')


@pytest.fixture(scope='module')
def rendered(blind, tmp_path_factory):
    folder = tmp_path_factory.mktemp('rendered') / 'run'
    assert list(restore_frames(open_recording(blind), folder)) == list(range(STEPS))
    return folder


@settings(deadline=None)  # the first example waits for the types
@given(FRAMES, st.integers(0, 2**31 * 10**9 - 1), st.text('abc_', max_size=9))
def test_given_pixels_when_serialised_then_the_bytes_are_those_of_ros(pixels, stamp_ns, frame):
    height, width, _ = pixels.shape
    message = make(
        'sensor_msgs/msg/Image', header__stamp__sec=stamp_ns // 10**9, header__frame_id=frame,
        header__stamp__nanosec=stamp_ns % 10**9, height=height, width=width, encoding='rgb8',
        step=3 * width, data=pixels.reshape(-1),
    )
    assert image_cdr(pixels, stamp_ns, frame) == serialise(message)


def test_given_a_bag_without_frames_when_rendered_then_they_are_those_of_the_world(
    blind, rendered
):
    trace = open_recording(blind).columns
    world = SimulatedWorld(open_recording(blind).scenario)
    frames = [frame.image for frame in open_recording(rendered).frames(render=False)]
    assert len(frames) == STEPS
    for seq, frame in enumerate(frames):
        assert frame.tobytes() == world.observe().image.tobytes(), seq
        world.advance(TaxiCommand(
            steering_rad=trace['steering_rad'][seq], speed_mps=trace['speed_cmd_mps'][seq]
        ))
    assert frames[0].tobytes() != frames[-1].tobytes()


def test_given_a_bag_without_frames_when_rendered_then_all_else_is_as_before(blind, rendered):
    before = [message[1:] for message in stored_messages(blind)]
    after = [m[1:] for m in stored_messages(rendered, lambda name: name != IMAGE)]
    assert before == after
    info = read_info(rendered)
    assert info.complete
    assert missing_frames(info) == 0
    assert {**info.metadata, 'rosbag2': 0} == {**read_info(blind).metadata, 'rosbag2': 0}


def test_given_some_frames_lost_when_rendered_then_those_come_back(rendered, tmp_path):
    lost = altered(
        rendered, tmp_path / 'lost', unaltered,
        keep=lambda m: m.topic.name != IMAGE or m.stamp_ns % (3 * PERIOD_NS) != 0,
    )
    assert missing_frames(read_info(lost)) == 7
    found = list(frame_messages(open_recording(lost)))
    assert found == list(frame_messages(open_recording(rendered)))
    list(restore_in_place(lost))
    assert [m.cdr for m in stored_messages(lost)] == [m.cdr for m in stored_messages(rendered)]


def test_given_another_command_in_the_bag_then_no_frame_is_made_up(blind, tmp_path):
    def harder(stored, message):
        if stored.topic.name != '/taxi_command' or stored.stamp_ns != 10 * PERIOD_NS:
            return False
        message.steering_angle += 1e-3
        return True

    bag = altered(blind, tmp_path / 'bag', harder)
    with pytest.raises(WorldDiffers, match='step 11: ') as error:
        list(restore_in_place(bag))
    assert '\n' not in str(error.value)
    assert sorted(path.name for path in bag.iterdir()) == ['bag_0.mcap', 'metadata.yaml']
    assert missing_frames(read_info(bag)) == STEPS
    with pytest.raises(WorldDiffers, match='step 11: '):
        list(restore_frames(open_recording(bag), tmp_path / 'elsewhere'))
    assert not (tmp_path / 'elsewhere').exists()


def test_given_a_rendering_given_up_then_the_bag_is_as_it_was(blind, tmp_path):
    bag = tmp_path / 'run'
    shutil.copytree(blind, bag)
    steps = restore_in_place(bag)
    assert next(steps) == 0
    steps.close()
    for file in blind.iterdir():
        assert (bag / file.name).read_bytes() == file.read_bytes()
    assert len(list(bag.iterdir())) == 2


def test_given_a_run_that_broke_before_a_command_then_what_there_was_is_rendered(blind, tmp_path):
    torn = altered(
        blind, tmp_path / 'torn', unaltered,
        keep=lambda m: m.stamp_ns < 500_000_000
        or (m.stamp_ns == 500_000_000 and m.topic.name in ('/clock', '/camera/camera_info')),
    )
    assert [now.seq for now in open_recording(torn).observations()] == [0, 1, 2, 3, 4]
    list(restore_in_place(torn))
    assert read_info(torn).counts[IMAGE] == 5


def test_given_a_damaged_bag_when_rendered_then_recovery_comes_first(blind, tmp_path):
    bag = tmp_path / 'run'
    shutil.copytree(blind, bag)
    (bag / 'metadata.yaml').unlink()
    with pytest.raises(UsageError, match='taxinet bag recover'):
        list(restore_in_place(bag))


def test_given_a_bag_of_somebody_else_then_it_is_refused(tmp_path):
    write_bag(tmp_path / 'other', samples(3))
    with pytest.raises(BagForeign, match='camera_info'):
        list(restore_frames(open_recording(tmp_path / 'other'), tmp_path / 'new'))
    assert not (tmp_path / 'new').exists()


@given(st.floats(0, 1), st.floats(0, 10))
def test_given_gains_when_told_in_words_and_read_then_every_bit_is_there(cte_gain, speed):
    gains = {'cte_gain_rad_per_m': cte_gain, 'speed_mps': speed}
    assert parse_gains(gains_text(gains)) == gains


@pytest.mark.parametrize('words', ['speed_mps', 'speed_mps=fast', 'other_gain=1.0', 'a=b=c'])
def test_given_words_that_are_no_gains_then_they_are_refused(words):
    with pytest.raises(ValueError, match=r'gain|convert|unpack'):
        parse_gains(words)


@pytest.mark.parametrize(('words', 'ours'), [
    ('', True), ('heading_gain=1.5', True), ('heading_gain=1.5 speed_mps=4.0', True),
    ('my_pid', False), ('my_pid kp=1.0', False), ('heading_gain', False),
    ('speed_mps=fast', False), ('heading_gain=1.5 and more', False),
])
def test_given_how_a_controller_names_itself_then_only_gains_are_those_of_the_law(words, ours):
    assert is_steering_law(words) is ours
    if ours:
        assert len(parse_gains(words)) == len(words.split())
