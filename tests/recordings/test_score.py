"""Recordings with known errors, latency and offsets: they are found within stated bounds."""

import math
import re
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from synthetic import BEGUN_NS, Drive, path, pixels_of, record

from taxinet_ros.analysis.report.pictures import LIGHT
from taxinet_ros.errors import UsageError
from taxinet_ros.recordings.frames import NO_TRUTH, OFF_PLACE, OUT_OF_ORDER, STANDING
from taxinet_ros.recordings.reader import Recording, picture
from taxinet_ros.recordings.report import score_report
from taxinet_ros.recordings.score import ScoreOptions, score, worst_rows
from taxinet_ros.recordings.statistics import BEYOND
from taxinet_ros.recordings.truth import TruthSource

SLIPS = """

def aside(image):
    cte, he = see(image)
    return cte + 3 * (image[0, 0, 2] % 8 == 0), he

def askew(image):
    cte, he = see(image)
    return cte, he + 0.1 * (image[0, 0, 2] % 8 == 0)
"""
"""Of frames here and there one quantity is far off."""


def errors(found, network=0):
    """Mean absolute errors of all frames [m], [deg]."""
    rows = found.slices[0].errors
    return rows['cte'][network].value, rows['heading'][network].value


@pytest.mark.parametrize(('encoding', 'more'), [
    ('bgr8', {'compression': CompressionMode.MESSAGE}),
    ('png', {'storage': StoragePlugin.SQLITE3}),
    *(pytest.param(*case, marks=pytest.mark.nightly) for case in [
        ('rgb8', {}),
        ('rgb8', {'storage': StoragePlugin.SQLITE3, 'compression': CompressionMode.FILE}),
        ('bgr8', {'compression': CompressionMode.FILE}),
    ]),
], ids=['by message', 'sqlite3', 'mcap', 'sqlite3 by file', 'mcap by file'])
def test_given_any_storage_and_encoding_then_the_errors_are_those_of_the_network(
    scored, encoding, more
):
    found = scored(Drive(seconds=20, encoding=encoding), perception='biased', **more)
    assert found.counts == {'scored': 201}
    # The pictures hold a millionth; latitude and longitude come back to a tenth of a millimetre.
    assert errors(found) == pytest.approx((0.5, 1.0), abs=1e-4)
    assert found.notes == []


@pytest.mark.nightly
def test_given_noisy_positions_and_late_pictures_then_noise_and_latency_are_found(scored):
    drive = Drive(seconds=120, noise_m=0.3, late_s=0.25)
    found = scored(drive)
    assert found.latency.value_s == pytest.approx(0.25, abs=0.01)
    assert found.latency.low_s < 0.26
    assert found.latency.high_s > 0.24
    assert found.applied_s == 0.0
    assert errors(found)[1] == pytest.approx(0.4, abs=0.05)
    off = scored(drive, latency='estimated')
    assert off.applied_s == found.latency.value_s
    # What is left is the noise of the truth: the mean of |N(0, 0.3)| is 0.239.
    assert errors(off) == pytest.approx((0.239, 0.0), abs=0.02)
    low, high = off.slices[0].errors['cte'][0][1:3]
    assert low < 0.239 < high
    assert errors(scored(drive, latency='0.25'))[1] < 0.01


def test_given_a_straight_drive_then_latency_is_unknown_and_cannot_be_taken_off(scored):
    drive = Drive(seconds=30, late_s=0.25, noise_m=0.1, along=lambda t: (500 + 5 * t, 0.0, 0.0))
    found = scored(drive)
    assert math.isnan(found.latency.value_s)
    assert found.latency.why == 'the aircraft hardly turns or drifts'
    with pytest.raises(UsageError, match='cannot be estimated here'):
        scored(drive, latency='estimated')


def test_given_estimates_that_do_not_follow_the_path_then_the_path_is_not_blamed(scored):
    found = scored(Drive(seconds=60), perception='elsewhere')
    assert found.latency.why == 'the estimates hardly follow the path'


def test_given_clocks_that_differ_by_seconds_then_no_range_of_latencies_is_named(scored):
    found = scored(Drive(seconds=60, stamp=lambda kind, ns: ns + 1_300_000_000 * (kind == 'image')))
    assert found.latency.why == BEYOND


@pytest.mark.nightly
def test_given_an_antenna_beside_then_its_offset_turns_heading_into_cross_track(scored):
    drive = Drive(antenna_m=(3.0, -1.0))
    found = scored(drive)
    y, yaw = np.array([path(t / 10)[1:] for t in range(601)]).T
    shift = np.abs(np.sin(yaw) * 3.0 - np.cos(yaw) * 1.0)
    assert errors(found)[0] == pytest.approx(float(shift.mean()), abs=1e-3)
    assert errors(scored(drive, antenna_m=(3.0, -1.0))) == pytest.approx((0, 0), abs=1e-3)
    assert len(y) == len(found.table)


@pytest.mark.nightly
def test_given_other_sources_of_truth_then_they_tell_the_same(scored):
    for drive, source in (
        (Drive(seconds=20, truth='odometry'), {
            'topic': '/odom', 'frame': '47.196736,-119.332917'}),
        (Drive(seconds=20, truth='tf'), {'topic': '/tf:map:base_link', 'frame': 'runway'}),
        (Drive(seconds=20, heading=lambda h: h), {'compass': True}),
        (Drive(seconds=20, heading=lambda h: math.pi / 2 - h - 0.2), {'heading_offset_rad': -0.2}),
    ):
        found = scored(drive, perception='biased', **source)
        assert errors(found) == pytest.approx((0.5, 1.0), abs=1e-3), source
        assert found.notes == []


def test_given_the_heading_of_the_track_then_it_is_that_of_the_motion_when_it_moves(scored):
    cte, heading = errors(scored(Drive(seconds=40), heading=''))
    # A straight line through two seconds of a weaving path.
    assert cte == pytest.approx(0.0, abs=1e-3)
    assert 0 < heading < 0.15


def test_given_positions_once_a_second_then_they_are_interpolated_within_its_bound(scored):
    assert errors(scored(Drive(seconds=40, hz=1.0))) == pytest.approx((0, 0), abs=0.7)
    assert errors(scored(Drive(seconds=40, hz=1.0)))[0] < 0.05


def test_given_frames_that_cannot_be_compared_then_each_is_counted_and_none_guessed(scored):
    def stops(t):
        return path(min(t, 15.0))

    def leaves(t):
        return 500 + 5 * t, 2.5 * t, math.atan2(2.5, 5)

    def back(kind, stamp_ns):
        return stamp_ns - 300_000_000 * (kind == 'image' and stamp_ns == BEGUN_NS + 10**9)

    stood = scored(Drive(seconds=20, along=stops))
    assert stood.counts[STANDING] == pytest.approx(45, abs=5)
    assert scored(Drive(seconds=20, along=leaves)).counts[OFF_PLACE] > 50
    assert scored(Drive(seconds=20, stamp=back)).counts[OUT_OF_ORDER] == 1
    gap = scored(Drive(seconds=20), keep=lambda topic, number: topic == '/cam' or not (
        50 <= number < 80))
    assert gap.counts[NO_TRUTH] == pytest.approx(30, abs=2)
    for found in (stood, gap):
        assert sum(found.counts.values()) == 201
        assert errors(found)[0] < 1e-3


def test_given_two_networks_then_they_are_compared_frame_by_frame(scored):
    found = scored(Drive(seconds=60, noise_m=0.4), perception='biased', against='see')
    better = found.slices[0].better
    assert better['heading'].low > 0.9
    assert better['cte'].low > 0
    # Frame by frame the noise that both share is not in the difference.
    one = found.slices[0].errors['cte'][0]
    assert errors(found)[0] - errors(found, 1)[0] == pytest.approx(better['cte'].value)
    assert one.frames == better['cte'].frames == 601


def test_given_requirements_then_the_recorded_path_is_judged(scored):
    found = scored(Drive(seconds=30), specs=('phi_always', 'wide=always(abs(cte) <= 4)'))
    always, wide = found.verdicts
    most = max(abs(path(t / 10)[1]) for t in range(301))
    assert (always.verdict, wide.verdict) == ('VIOLATED', 'SATISFIED')
    assert always.lower == always.upper == pytest.approx(1.5 - most, abs=1e-3)
    with pytest.raises(UsageError, match='reads steering, which a recording does not tell'):
        scored(Drive(seconds=5), specs=('always(abs(steering) < 1)',))


def test_given_errors_then_the_worst_frames_are_apart_and_by_size(scored):
    found = scored(Drive(seconds=60, noise_m=0.5))
    rows = worst_rows(found.table)
    assert len(rows) == 8
    sizes = found.table['cte_error_m'].abs().to_numpy()
    assert sizes[rows[0]] > np.percentile(sizes, 95)
    assert np.diff(sorted(found.table['t_s'].to_numpy()[rows])).min() >= 1.0


def test_given_two_networks_then_the_worst_frames_of_each_say_what_is_off(scored, see):
    with Path(see).open('a') as file:
        file.write(SLIPS)
    found = scored(Drive(seconds=30, noise_m=0.1), perception='aside', against='askew')
    assert [len(rows) for rows in found.worst] == [8, 8]
    assert found.worst == [worst_rows(found.table), worst_rows(found.table, '_2')]
    [section] = [one for one in score_report(found).sections if one.name == 'worst']
    assert [one.title for one in section.pictures] == [
        'Worst frames of see.py:aside', 'Worst frames of see.py:askew']
    for one, words in zip(section.pictures, (
        r'[\d.]+ s: cross-track ([-+][\d.]+), ([-+][\d.]+) m',
        r'[\d.]+ s: heading ([-+][\d.]+), ([-+][\d.]+) deg',
    ), strict=True):
        figure = Figure()
        one.draw(figure, LIGHT)
        titles = [re.fullmatch(words, axes.get_title()) for axes in figure.axes]
        assert len(titles) == 8
        assert all(title and abs(float(title[1]) - float(title[2])) > 1 for title in titles), one


def test_given_patterns_of_a_bayer_sensor_then_colours_come_out(tmp_path):
    from types import SimpleNamespace

    for pattern, corner in (('rggb', (0, 0)), ('bggr', (1, 1)), ('gbrg', (1, 0)), ('grbg', (0, 1))):
        raw = np.zeros((8, 8), np.uint8)
        raw[corner[0]::2, corner[1]::2] = 200  # only red pixels see anything
        message = SimpleNamespace(
            encoding=f'bayer_{pattern}8', height=8, width=8, step=8, data=raw.ravel())
        seen = picture(message)[3:5, 3:5].mean(axis=(0, 1))
        assert seen[0] > 150, pattern
        assert seen[1:].max() == 0, pattern
    grey = SimpleNamespace(encoding='mono8', height=2, width=3, step=5,
                           data=np.arange(10, dtype=np.uint8))
    assert picture(grey)[1].tolist() == [[5] * 3, [6] * 3, [7] * 3]
    for encoding, bytes_of_red in (('yuv422', (90, 82, 240, 82)), ('uyvy', (90, 82, 240, 82)),
                                   ('yuv422_yuy2', (82, 90, 82, 240)), ('yuyv', (82, 90, 82, 240))):
        red = SimpleNamespace(encoding=encoding, height=2, width=2, step=4,
                              data=np.array(bytes_of_red * 2, np.uint8))
        assert np.abs(picture(red) - np.array([255.0, 0, 0])).max() <= 1, encoding
        with pytest.raises(ValueError, match='image is 1 x 2'):
            picture(SimpleNamespace(**{**red.__dict__, 'width': 1, 'step': 2}))
    for wrong in ({'encoding': '32FC1'}, {'step': 2}, {'height': 3}):
        with pytest.raises(ValueError, match='image'):
            picture(SimpleNamespace(**{**grey.__dict__, **wrong}))


def test_given_a_bag_that_was_cut_off_then_it_is_scored_up_to_the_damage(scored, tmp_path, see):
    bag = record(tmp_path / 'cut', Drive(seconds=20, size=(40, 60)))
    file = next(bag.glob('*.mcap'))
    file.write_bytes(file.read_bytes()[:-file.stat().st_size // 3])
    found = score(ScoreOptions(
        bags=(bag,), perception=f'{see}:see', place='kmwh_04',
        source=TruthSource(topic='/fix', heading='/imu')))
    assert 20 < found.counts['scored'] < 201
    assert any('what lies before it is used' in note for note in found.notes)


def test_given_a_drive_then_its_table_has_one_row_a_frame_and_slices_add_up(scored):
    found = scored(Drive(seconds=60))
    assert isinstance(found.table, pd.DataFrame)
    assert len(found.table) == found.table['number'].nunique() == 601
    for kind in ('distance', 'picture', 'offset', 'heading', 'sun'):
        parts = [one.errors['cte'][0].frames for one in found.slices if one.kind == kind]
        assert sum(parts) == 601, kind
    assert Recording(found.bags[0].recording.path).counts['/cam'] == 601
    assert pixels_of(0, 0, (2, 2)).shape == (2, 2, 3)


@pytest.mark.nightly
def test_given_frames_of_our_size_then_two_hundred_a_second_are_scored_on_one_core(tmp_path):
    bag = record(tmp_path / 'drive', Drive(seconds=20, size=(200, 360)))
    options = ScoreOptions(
        bags=(bag,), perception='taxinet', place='kmwh_04',
        source=TruthSource(topic='/fix', heading='/imu'))
    score(options)
    begun_s = time.process_time()
    found = score(options)
    assert len(found.table) / (time.process_time() - begun_s) > 200
