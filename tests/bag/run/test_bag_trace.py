"""Decoding, traces and frames: values come back, and nothing a bag says can do harm."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_samples import STEP_NS, drain, frame, make, samples, serialise, topics, write_bag
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.bag.writer import BagWriter

STEPS = 4
TOPICS = {topic.name: topic for topic in topics()}


@pytest.mark.parametrize('namespace', ['', '/worker_3'])
def test_given_a_run_when_traced_then_columns_hold_its_numbers(
    tmp_path: Path, namespace: str
) -> None:
    write_bag(tmp_path / 'run', samples(STEPS, namespace), namespace)
    trace = open_recording(tmp_path / 'run').columns
    k = np.arange(STEPS)
    expected: dict[str, Any] = {
        'seq': k, 't_ns': k * STEP_NS, 'x_m': 10.0 * k, 'y_m': -0.5 * k, 'distance_m': 10.0 * k,
        'speed_mps': 5.0 + k,
        'cte_m': -0.5 * k, 'he_rad': 0.01 * k, 'est_valid': k != 1,
        'est_cte_m': np.where(k == 1, np.nan, -0.4 * k),
        'est_he_rad': np.where(k == 1, np.nan, 0.02 * k),
        'steering_rad': 0.1 * k, 'speed_cmd_mps': np.full(STEPS, 5.0),
        'rho_lower.phi_eventually': -1.0 * k, 'rho_upper.phi_eventually': 8.0 - k,
    }
    assert set(trace) == set(expected)
    for name, column in expected.items():
        np.testing.assert_array_equal(trace[name], column, err_msg=name)
        assert trace[name].dtype == (np.asarray(column).dtype), name


def test_given_late_or_missing_answers_when_traced_then_matched_by_step_and_else_nan(
    tmp_path: Path,
) -> None:
    kept = [m for m in samples(3) if m[:2] not in {
        ('/taxi_command', STEP_NS), ('/ground_truth/odom', 0),
        ('/ground_truth/tracking_error', 2 * STEP_NS),
    }]
    write_bag(tmp_path / 'run', kept[::-1])
    trace = open_recording(tmp_path / 'run').columns
    assert trace['seq'].tolist() == [0, 1]
    np.testing.assert_array_equal(trace['steering_rad'], [0.0, np.nan])
    np.testing.assert_array_equal(trace['x_m'], [np.nan, 10.0])


def test_given_several_formulas_when_traced_then_each_has_its_columns(tmp_path: Path) -> None:
    messages = samples(2)
    for seq in range(2):
        other = make('taxinet_msgs/msg/Robustness', run_id='r', seq=seq, spec='phi_always',
                     rho_lower=-np.inf, rho_upper=3.0 - seq)
        messages.append(('/monitor/robustness', seq * STEP_NS, serialise(other)))
    write_bag(tmp_path / 'run', messages)
    trace = open_recording(tmp_path / 'run').columns
    assert trace['rho_upper.phi_always'].tolist() == [3.0, 2.0]
    assert trace['rho_lower.phi_always'].tolist() == [-np.inf, -np.inf]
    assert trace['rho_upper.phi_eventually'].tolist() == [8.0, 7.0]


def test_given_no_trace_or_more_than_one_when_traced_then_the_error_says_why(
    tmp_path: Path,
) -> None:
    path = write_bag(tmp_path / 'empty', samples(2)[:2])
    with pytest.raises(BagEmpty, match='no messages on ground_truth/tracking_error'):
        _ = open_recording(path).columns
    path = write_bag(tmp_path / 'damaged', samples(2))
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(BagError, match='13 intact messages before'):
        _ = open_recording(path).columns
    both = topics('/a') + topics('/b')
    with BagWriter(tmp_path / 'both', both, metadata={}, attachments={}, min_free_bytes=0) as bag:
        for topic, stamp, cdr in samples(1, '/a') + samples(1, '/b'):
            bag.write(topic, cdr, stamp)
    with pytest.raises(BagForeign, match='holds several runs, a/r and b/r; split it'):
        _ = open_recording(tmp_path / 'both').columns
    odd = dataclasses.replace(TOPICS['/camera/image_raw'], name='/ground_truth/tracking_error')
    with BagWriter(tmp_path / 'odd', [odd], metadata={}, attachments={}, min_free_bytes=0) as bag:
        bag.write(odd.name, _image()[2], 0)
    with pytest.raises(BagForeign, match='topics of the trace: '):
        _ = open_recording(tmp_path / 'odd').columns


def test_given_frames_when_read_then_pixels_and_stamps_are_right(tmp_path: Path) -> None:
    write_bag(tmp_path / 'run', samples(3))
    recording = open_recording(tmp_path / 'run')
    frames = [(frame.stamp_ns, frame.image) for frame in recording.frames(render=False)]
    assert [stamp for stamp, _ in frames] == [0, STEP_NS, 2 * STEP_NS]
    for step, (_, pixels) in enumerate(frames):
        assert pixels.dtype == np.uint8
        np.testing.assert_array_equal(pixels, frame(step))


def _image(stamp_ns: int = 7, **fields: Any) -> tuple[str, int, bytes]:
    values: dict[str, Any] = {
        'header__stamp__nanosec': stamp_ns, 'height': 2, 'width': 2, 'encoding': 'rgb8', 'step': 6,
        'data': np.arange(12, dtype=np.uint8), **fields,
    }
    return ('/camera/image_raw', stamp_ns, serialise(make('sensor_msgs/msg/Image', **values)))


def test_given_padded_rows_or_bgr_when_read_then_pixels_are_rgb(tmp_path: Path) -> None:
    padded = np.arange(16, dtype=np.uint8)
    write_bag(tmp_path / 'run', [_image(step=8, data=padded), _image(8, encoding='bgr8')])
    recording = open_recording(tmp_path / 'run')
    first, second = (frame.image for frame in recording.frames(render=False))
    assert first.tolist() == [[[0, 1, 2], [3, 4, 5]], [[8, 9, 10], [11, 12, 13]]]
    assert second[0].tolist() == [[2, 1, 0], [5, 4, 3]]
    write_bag(tmp_path / 'twice', [_image(8), _image(8)])
    with pytest.raises(BagForeign, match='image at 8 ns: comes behind one of 8 ns'):
        list(open_recording(tmp_path / 'twice').frames(render=False))


@pytest.mark.parametrize(('fields', 'kind'), [
    ({'height': 3}, BagCorrupt), ({'step': 5}, BagCorrupt), ({'width': 2**31}, BagCorrupt),
    ({'encoding': 'mono16'}, BagForeign),
])
def test_given_an_image_that_contradicts_itself_when_read_then_refused(
    tmp_path: Path, fields: dict[str, Any], kind: type[BagError]
) -> None:
    write_bag(tmp_path / 'run', [_image(**fields)])
    with pytest.raises(kind, match='image at 7 ns'):
        list(open_recording(tmp_path / 'run').frames(render=False))


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(sorted(TOPICS)), st.data())
def test_given_mangled_messages_when_decoded_then_only_typed_errors(
    name: str, data: st.DataObject
) -> None:
    sound = next(cdr for topic, _, cdr in samples(1) if topic == name)
    place = data.draw(st.integers(0, len(sound)))
    mangled = sound[:place] + data.draw(st.binary(max_size=8)) + sound[place + 4:]
    _, error = drain(decode(TOPICS[name], cdr) for cdr in [mangled])
    if error is not None:
        assert isinstance(error, BagCorrupt)
        assert f'topic {name}' in str(error)
        assert '\n' not in str(error)


def test_given_a_message_that_cannot_be_decoded_when_read_then_the_error_names_it(
    tmp_path: Path,
) -> None:
    messages = samples(2)
    messages[4] = (*messages[4][:2], b'\0\1\0\0nonsense')
    write_bag(tmp_path / 'run', messages)
    recording = open_recording(tmp_path / 'run')
    with pytest.raises(BagCorrupt, match=f'run: at 0 ns: topic {messages[4][0]}: not a taxinet_ms'):
        _ = recording.columns
    assert len(recording.damage) == 1


def test_given_a_package_that_a_bag_names_when_decoded_then_it_is_not_imported() -> None:
    topic = TopicInfo(
        name='/t', type='antigravity/msg/This', qos='', type_hash='',
        definition='uint8 PWNED=1\nstring TEXT="\'+__import__(\'this\')+\'"\nuint8 x\n',
    )
    before = set(sys.modules)
    assert decode(topic, b'\0\1\0\0\x2a').x == 42
    assert {'antigravity', 'this'}.isdisjoint(set(sys.modules) - before)
