"""Estimates that a perception published itself: their errors and delay are found, or refused."""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from bag_edits import GOLDEN
from rosbags.typesys import get_types_from_msg
from synthetic import BEGUN_NS, PERIOD_NS, TYPES, Drive, header, make, path, record

from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.topics import message_definition
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.recordings.frames import proposals
from taxinet_ros.recordings.reader import stamp_of
from taxinet_ros.recordings.report import score_report
from taxinet_ros.recordings.statistics import estimate_latency
from taxinet_ros.recordings.truth import Poses, Truth

OURS, VECTOR = 'taxinet_msgs/msg/TrackingError', 'geometry_msgs/msg/Vector3Stamped'
ARRAY = 'std_msgs/msg/Float64MultiArray'
TYPES.register(get_types_from_msg(message_definition(OURS), OURS))
LATE_NS = 300_000_000
BIAS = 0.5, math.radians(2.0)
NOISE = 0.2, math.radians(1.0)
LITTLE = 0.05, math.radians(0.2)


def vector(stamp_ns, x, y, z):
    return make(VECTOR, header=header(stamp_ns, 'runway'),
                vector=make('geometry_msgs/msg/Vector3', x=x, y=y, z=z))


def ours(stamp_ns, cte, he, valid=True):
    return make(OURS, header=header(stamp_ns, 'map'), run_id='', seq=0, cross_track_error=cte,
                heading_error=he, valid=valid, covariance=np.zeros(4))


def array(*values):
    return make(ARRAY, data=np.array(values), layout=make(
        'std_msgs/msg/MultiArrayLayout', dim=[], data_offset=0))


def heard(kind, message, *, topic='/seen', seconds=60, late_ns=LATE_NS, stamp=lambda ns: ns,
          bias=BIAS, noise=NOISE, seed=1):
    """Estimates of each picture with a known bias and noise, published ``late_ns`` after it.

    ``message`` makes one of its stamp [ns], cross-track [m] and heading error [rad].
    """
    rng = np.random.default_rng(seed)
    found = []
    for number in range(10 * seconds + 1):
        truth = path(number / 10)[1:]
        cte, he = (one + off + rng.normal(0, spread)
                   for one, off, spread in zip(truth, bias, noise, strict=True))
        shown_ns = BEGUN_NS + number * PERIOD_NS
        found.append((topic, kind, message(stamp(shown_ns), cte, he), shown_ns + late_ns))
    return found


def in_feet(stamp_ns, cte, he):
    """Cross-track error in feet, right positive, and heading error in degrees."""
    return vector(stamp_ns, 0.0, -cte / 0.3048, math.degrees(he))


def errors(found, network=0):
    """Mean errors with their signs [m], [deg]."""
    end = ('', '_2')[network]
    return tuple(found.table[found.scored][[f'cte_error_m{end}', f'he_error_deg{end}']].mean())


def images(topic, number):
    return topic != '/cam'


KINDS = {
    'ours': (OURS, ours, '/seen'),
    'fields': (VECTOR, in_feet, '/seen:-vector.y=ft,vector.z=deg'),
    'fields of ours': (OURS, lambda ns, cte, he: ours(ns, he, -cte),
                       '/seen:-heading_error=m,cross_track_error=rad'),
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('kind', 'message', 'word'), KINDS.values(), ids=KINDS)
def test_given_recorded_estimates_then_their_bias_and_noise_are_found_whenever_they_came(
    scored, kind, message, word
):
    found = scored(Drive(more=heard(kind, message)), perception=word)
    assert found.counts == {'scored': 601}
    assert found.notes == []
    assert list(found.networks) == [word]
    # Of 601 errors the mean is within three standard errors.
    assert errors(found) == pytest.approx((0.5, 2.0), abs=3 / math.sqrt(601))
    assert errors(found)[0] == pytest.approx(0.5, abs=0.2 * 3 / math.sqrt(601))
    off = found.table[['cte_error_m', 'he_error_deg']].std()
    assert off.tolist() == pytest.approx([0.2, 1.0], rel=0.1)
    # They have the stamps of their pictures, so when they were published does not matter.
    assert found.latency.low_s < 0 < found.latency.high_s
    low, high = found.slices[0].errors['cte'][0][1:3]
    assert low < 0.5 < high


def test_given_topics_of_numbers_then_they_are_proposed_with_the_form_of_their_word(tmp_path):
    stamp = make('builtin_interfaces/msg/Time', sec=0, nanosec=0)
    bag = record(tmp_path / 'drive', Drive(seconds=1, more=[
        *heard(OURS, ours, seconds=1), *heard(VECTOR, in_feet, topic='/feet', seconds=1),
        *heard(ARRAY, lambda ns, cte, he: array(cte, he), topic='/array', seconds=1),
        ('/time', 'builtin_interfaces/msg/Time', stamp, BEGUN_NS)]))
    assert {row['topic']: row['use'] for row in proposals(bag)} == {
        '/cam': 'image', '/fix': 'truth', '/imu': 'heading', '/seen': 'perception',
        '/feet': 'perception /feet:FIELD=m,FIELD=rad',
        '/array': 'perception /array:FIELD=m,FIELD=rad', '/time': ''}


@pytest.mark.nightly
def test_given_late_pictures_then_recorded_estimates_tell_their_latency(scored):
    late = Drive(late_s=0.25, noise_m=0.1, more=heard(
        OURS, ours, noise=LITTLE, stamp=lambda ns: ns + 250_000_000))
    # They belong to pictures by the headers' stamps also where the times of recording count.
    for more in ({}, {'by_log': True}):
        found = scored(late, perception='/seen', latency='estimated', **more)
        assert found.latency.value_s == pytest.approx(0.25, abs=0.03)
        assert found.latency.low_s < 0.25 < found.latency.high_s
        assert errors(found) == pytest.approx((0.5, 2.0), abs=0.04)


def test_given_a_short_drive_then_the_line_says_that_it_is_the_path_and_what_would_tell(scored):
    much = 0.3, math.radians(1.5)
    found = scored(Drive(seconds=30, more=heard(OURS, ours, seconds=30, noise=much)),
                   perception='/seen')
    assert re.fullmatch(
        r'on a path so short or even, any from -[\d.]+ to \+[\d.]+ s fits about as well; a longer '
        'one with uneven turns would tell', found.latency.why)


@pytest.mark.parametrize(('kind', 'message', 'word', 'late_ns', 'more'), [
    pytest.param(
        OURS, ours, '/seen', 0, {'by_log': True, 'keep': images}, marks=pytest.mark.nightly,
    ),
    (OURS, ours, '/seen', LATE_NS, {'image': 'none'}),
    (ARRAY, lambda ns, cte, he: array(cte, he), '/seen:data.0=m,data.1=rad', 0, {
        'by_log': True, 'image': 'none'}),
], ids=['times of recording', 'stamps of publishing', 'without header'])
def test_given_estimates_without_pictures_then_each_counts_at_its_time_and_the_delay_is_found(
    scored, kind, message, word, late_ns, more
):
    sent = heard(kind, message, noise=LITTLE, stamp=lambda ns: ns + late_ns)
    found = scored(Drive(more=sent), perception=word, latency='estimated', **more)
    assert len(found.table) == 601
    assert found.setup.image == ''
    assert found.latency.value_s == pytest.approx(0.3, abs=0.03)
    assert found.latency.low_s < 0.3 < found.latency.high_s
    assert errors(found) == pytest.approx((0.5, 2.0), abs=0.04)
    assert found.notes == []


def test_given_estimates_that_are_missing_invalid_or_strange_then_each_is_counted(scored):
    more = heard(OURS, ours)
    del more[100:120]
    more[0] = (*more[0][:2], ours(BEGUN_NS, 0.0, 0.0, valid=False), more[0][3])
    more[1] = (*more[1][:2], ours(BEGUN_NS + PERIOD_NS, math.nan, 0.0), more[1][3])
    again = BEGUN_NS + 5 * PERIOD_NS
    more.append(('/seen', OURS, ours(again, 99.0, 0.0), again + 10**9))
    more.append(('/seen', OURS, ours(again + 50_000, 99.0, 0.0), again + 10**9))
    found = scored(Drive(more=more), perception='/seen')
    assert [note.partition('/seen: ')[2] for note in found.notes] == [
        '20 pictures on /cam have no estimate',
        '1 estimates have the stamp of none of the pictures on /cam',
        '2 estimates are not valid, or no numbers',
        '1 estimates have the stamp of an earlier one and are not used',
    ]
    assert found.slices[0].errors['cte'][0].frames == 579
    assert errors(found)[0] == pytest.approx(0.5, abs=0.03)


def test_given_stamps_that_went_through_seconds_then_they_are_those_of_the_pictures(scored):
    sent = heard(OURS, ours, seconds=5, stamp=lambda ns: (
        ns // 10**9 * 10**9 + int(ns / 1e9 % 1 * 1e9)))
    assert sum(stamp_of(one[2]) % 1000 != 0 for one in sent) > 30
    found = scored(Drive(seconds=5, more=sent), perception='/seen')
    assert found.notes == []
    assert found.slices[0].errors['cte'][0].frames == 51


def test_given_an_estimate_alone_then_it_belongs_to_its_picture(scored):
    found = scored(Drive(seconds=5, more=heard(OURS, ours, seconds=5)[3:4]), perception='/seen')
    assert np.flatnonzero(np.isfinite(found.table['est_cte_m'])).tolist() == [3]


def test_given_arrays_that_are_empty_where_nothing_was_seen_then_these_are_counted(scored):
    more = heard(ARRAY, lambda ns, cte, he: array(cte, he), seconds=5)
    more[0] = (*more[0][:2], array(), more[0][3])
    found = scored(Drive(seconds=5, more=more), perception='/seen:data.0=m,data.1=rad',
                   by_log=True, keep=images)
    assert [note.partition('/seen: ')[2] for note in found.notes] == [
        '1 estimates are not valid, or no numbers']
    assert found.slices[0].errors['cte'][0].frames == 50


@pytest.mark.nightly
def test_given_a_network_beside_recorded_estimates_then_they_are_compared_frame_by_frame(scored):
    drive = Drive(seconds=30, more=heard(OURS, ours, seconds=30) + heard(
        VECTOR, in_feet, topic='/other', bias=(1, 0), seconds=30))
    found = scored(drive, perception='/seen', against='see')
    assert errors(found, 1) == pytest.approx((0, 0), abs=1e-3)
    assert found.slices[0].better['cte'].low > 0.3
    assert {one.frames for one in found.slices[0].errors['cte']} == {301}
    for more in ({}, {'keep': images}):
        found = scored(drive, perception='/seen', against='/other:-vector.y=ft,vector.z=deg',
                       **more)
        assert errors(found)[0] == pytest.approx(0.5, abs=0.04)
        assert errors(found, 1)[0] == pytest.approx(1.0, abs=0.04)


@pytest.mark.nightly
def test_given_estimates_whose_errors_drift_then_the_other_network_keeps_its_interval(scored):
    drive = Drive(seconds=60, noise_m=0.4, more=heard(
        OURS, lambda ns, cte, he: ours(ns, cte, he + 0.1 * math.sin(ns / 2e10)), noise=(0, 0)))
    alone = scored(drive, perception='see').slices[0].errors['cte'][0]
    assert alone.low < alone.value < alone.high
    found = scored(drive, perception='see', against='/seen')
    first, second = found.slices[0].errors['cte']
    assert first == alone
    assert math.isnan(second.low)
    lines = [one for one in score_report(found).summary if one.startswith(('No int', 'Intervals'))]
    assert lines[0].startswith('No interval of /seen: neighbouring errors are so alike')


@pytest.mark.parametrize(('image', 'line'), [
    ('none', 'dataset: without pictures it has no effect'), ('', 'exists; choose a new folder'),
])
def test_given_images_that_cannot_be_written_then_that_is_said_before_scoring(
    scored, tmp_path, monkeypatch, image, line
):
    monkeypatch.setattr('taxinet_ros.recordings.score.read_frames', None)
    for number in range(4):
        (tmp_path / f'images/drive{number}').mkdir(parents=True)
    drive = Drive(seconds=2, more=heard(OURS, ours, seconds=2))
    with pytest.raises(UsageError, match=line):
        scored(drive, perception='/seen', image=image, dataset=tmp_path / 'images')


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('word', 'line'), [
    ('/seen:vector.y=m,vector.z=deg', r'signs of estimates or truth \(.* a minus before a field of '
     r'/seen turns it\), or they are as wrong as that'),
    ('/seen:-vector.y=m,vector.z=deg', 'its cross-track error is in feet, expected m'),
    ('/seen:-vector.y=ft,vector.z=rad', 'its heading error is in degrees, expected rad'),
], ids=['sign', 'feet', 'degrees'])
def test_given_a_wrong_unit_or_sign_then_a_line_names_it(scored, word, line):
    notes = scored(Drive(more=heard(VECTOR, in_feet)), perception=word).notes
    assert any(re.search(line, note) for note in notes), notes


REFUSED = {
    'another topic': ('/sen', {}, '/sen is not in it; did you mean /seen.; taxinet score --topics'),
    'another type': (
        '/feet', {}, r'/feet is a geometry_msgs/msg/Vector3Stamped: name its .* left positive .*, '
        r'/feet:FIELD=m,FIELD=rad; its numbers are vector.x, vector.y, vector.z$'),
    'no such field': ('/feet:y=m,vector.z=deg', {}, 'y is no number of it; those are vector.x'),
    'a field that is no number': ('/feet:vector=m,vector.z=deg', {}, 'vector is no number of it'),
    'one field': ('/feet:vector.y=m', {}, 'expected two fields with their units'),
    'no unit': ('/feet:vector.y,vector.z', {}, 'expected two fields with their units'),
    'another unit': (
        '/feet:vector.y=deg,vector.z=deg', {}, r'vector.y is the cross-track error, and its unit '
        r'deg; expected a length \(m, km, '),
    'an unknown unit': ('/feet:vector.y=m,vector.z=grad', {}, r'unit grad; expected an angle'),
    'no header': ('/array:data.0=m,data.1=rad', {}, 'no header, .* image none with stamps log'),
    'no header, no pictures': (
        '/array:data.0=m,data.1=rad', {'keep': images}, 'no header, .* stamps log'),
    'stamps of publishing': (
        '/published', {}, r'none of 51 estimates has the stamp of one of 51 pictures on /cam \(the '
        r'nearest is \+0.030 s off\): .* image none'),
    'no estimate': ('/invalid', {}, 'TrackingError: 51 messages, none with an estimate'),
    'a camera without pictures': (
        '/seen', {'image': 'none', 'camera': 'wing'}, 'camera: without pictures it has no'),
    'a monitor without pictures': (
        '/seen', {'keep': images, 'monitor': 'taxinet'}, 'monitor: without pictures it has no'),
    'a network without pictures': ('see', {'image': 'none'}, 'image none: no such topic'),
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('word', 'more', 'line'), REFUSED.values(), ids=REFUSED)
def test_given_estimates_that_cannot_be_scored_then_one_line_says_why(scored, word, more, line):
    sent = [
        *heard(OURS, ours, seconds=5), *heard(VECTOR, in_feet, topic='/feet', seconds=5),
        *heard(ARRAY, lambda ns, cte, he: array(cte, he), topic='/array', seconds=5),
        *heard(OURS, ours, topic='/published', seconds=5, stamp=lambda ns: ns + 30_000_000),
        *heard(OURS, lambda *one: ours(*one, valid=False), topic='/invalid', seconds=5),
    ]
    with pytest.raises(UsageError, match=line) as caught:
        scored(Drive(seconds=5, more=sent), perception=word, **more)
    assert '\n' not in str(caught.value)


def test_given_pictures_that_cannot_be_read_then_the_line_says_how_to_do_without(scored):
    drive = Drive(seconds=5, encoding='mono16', more=heard(OURS, ours, seconds=5))
    with pytest.raises(UsageError, match=r'mono16.*; image none does without pictures'):
        scored(drive, perception='/seen')
    assert scored(drive, perception='/seen', image='none').counts['scored'] == 51


def test_given_a_run_of_ours_without_pictures_then_its_estimates_are_scored_as_it_judged_them(
    taxinet, tmp_path
):
    bag = GOLDEN / 'taxinet-midday'
    uses = {row['topic']: row['use'] for row in proposals(bag)}
    assert uses['/perception/tracking_error'] == 'perception'
    words = 'score', bag, '--perception', '/perception/tracking_error'
    code, out, err = taxinet(*words, '--out', 'found', '--json')
    assert (code, err) == (0, '')
    found, run = json.loads(out), open_recording(bag)
    off = (run.trace['est_cte_m'] - run.trace['cte_m']).abs()
    assert found['frames'] == len(run.trace) == 121
    assert found['cte_mae_m'] == pytest.approx(off.mean(), rel=1e-12)
    table = pd.read_parquet(tmp_path / 'found/frames.parquet')
    assert table['est_cte_m'].tolist() == run.trace['est_cte_m'].tolist()
    page = (tmp_path / 'found/score.html').read_text()
    assert '/perception/tracking_error' in page
    assert 'Worst frames of' in page
    assert found['sentences'][0].startswith('/perception/tracking_error: mean absolute error')
    for more, line in (
        ('--simulate', 'are not of rendered frames; name their network'),
        ('--dataset=images', 'dataset: without pictures it has no effect'),
    ):
        code, out, err = taxinet(*words, more)
        assert (code, out, err.count('\n'), line in err) == (2, '', 1, True)


@pytest.mark.nightly
def test_given_runs_steered_by_what_is_scored_then_no_latency_is_made_up():
    # Steering makes turns follow from offset and heading, so that shifts look like scales.
    trace = open_recording(GOLDEN / 'taxinet-midday').trace
    stamps_ns, cte, he = (trace[name].to_numpy() for name in ('t_ns', 'cte_m', 'he_rad'))
    still = np.zeros(len(cte))
    truth = Truth(stamps_ns=stamps_ns, poses=Poses(
        trace['x_m'].to_numpy(), trace['y_m'].to_numpy(), he, still + 5, still))
    track = Scenario().line
    for late_s, noise in ((0.0, (0, 0)), (0.0, LITTLE), (0.0, NOISE), (0.2, LITTLE)):
        found = []
        for seed in range(10):
            errors = np.random.default_rng(seed).normal(BIAS, noise, (len(cte), 2))
            shown = truth.at(stamps_ns - round(late_s * NS_PER_S))
            seen = np.column_stack([shown.y_m, shown.yaw_rad]) + errors
            found.append(estimate_latency([(truth, stamps_ns, seen)], track))
        told = [one for one in found if not math.isnan(one.value_s)]
        missed = [one for one in told if not one.low_s - 0.005 < late_s < one.high_s + 0.005]
        assert len(missed) <= 1, missed
        assert len(told) >= 5 or noise == NOISE
