"""The recorded path in our world: the same poses, hour and weather; and a run that starts there."""

import json

import pandas as pd
import pytest
import yaml
from synthetic import Drive, record

from taxinet_ros.core.place.catalogue import PLACES, find_place
from taxinet_ros.errors import UsageError
from taxinet_ros.recordings.rendered import metar_weather


@pytest.mark.parametrize(('text', 'clouds', 'rain', 'unshown'), [
    ('KMWH 201855Z 05006KT 10SM CLR 10/02 A3001', 'clear', 0, []),
    ('BIKF 271200Z 20025G40KT 9999 -RA FEW012 BKN025 OVC060 05/04 Q0985', 'overcast', 20, []),
    ('NZQN 270000Z AUTO 00000KT 3000 +SHRA OVC006 08/08 Q1002', 'stratus', 90, []),
    ('EDDF 271220Z 24010KT 9999 FEW250 12/07 Q1021', 'cirrus', 0, []),
    ('EDDF 271220Z 24010KT 9999 SCT030 RA 12/07 Q1021', 'broken', 50, []),
    ('KSEA 271253Z 00000KT 1/4SM FG VV002 08/08 A3012 RMK AO2 RA', 'stratus', 0, ['FG']),
    ('CYUL 271300Z 36010KT 2SM -SN BLSN OVC010 M05/M07', 'overcast', 0, ['-SN', 'BLSN']),
])
def test_given_a_metar_then_clouds_and_rain_are_those_it_names(text, clouds, rain, unshown):
    assert metar_weather(text) == ({'clouds': clouds, 'rain_percent': rain}, unshown)


def test_given_a_metar_without_clouds_then_it_is_refused():
    with pytest.raises(UsageError, match='names no clouds'):
        metar_weather('KMWH 201855Z 05006KT')


@pytest.mark.nightly
def test_given_a_run_of_ours_then_rendered_frames_are_like_the_recorded_and_a_run_starts_there(
    taxinet, tmp_path
):
    code, *_ = taxinet(
        'run', 'nominal', '--engine', 'loop', '--images', 'all', '--set', 'duration=3',
        '--set', 'cross_track=0.5', '--set', 'heading=0', '--set', 'distance=1000',
        '--set', 'time_of_day=16:00', '--set', 'clouds=cirrus', '--perception', 'taxinet',
        '--out', 'ours', '--exit-zero')
    assert code == 0
    bag = next((tmp_path / 'ours').glob('nominal-*'))
    code, out, _ = taxinet('score', bag, '--simulate', '--out', 'scored', '--json')
    assert code == 0
    values = json.loads(out)
    assert any('31 frames and the same poses in our world' in one for one in values['sentences'])
    table = pd.read_parquet(tmp_path / 'scored/frames.parquet')
    off = (table['rendered_est_cte_m'] - table['est_cte_m']).abs()
    # The pose is that of a settled aircraft; where it rolls and pitches, frames differ.
    assert off.max() < 0.5
    assert off.iloc[0] < 0.05
    assert values['start']['clouds'] == 'cirrus'
    assert values['start']['time_of_day_h'] == 16
    (tmp_path / 'shy.yaml').write_text(
        'objects: [{kind: vehicle, x_m: 1020, y_m: 9, starts_within_m: 9, '
        'path: [{x_m: 1020, y_m: -9, speed_mps: 3}]}]')
    code, _, err = taxinet('score', bag, '--simulate', '--set', 'traffic=shy.yaml')
    assert (code, 'simulate: objects[0] of traffic reacts to the aircraft' in err) == (2, True)
    # Another hour is another picture.
    code, out, _ = taxinet('score', bag, '--simulate', '--set', 'time_of_day=9:00', '--json')
    assert json.loads(out)['start']['time_of_day_h'] == 9
    code, out, _ = taxinet('run', '--from', 'scored', '--engine', 'loop', '--out', 'again',
                           '--set', 'duration=1', '--exit-zero')
    assert code == 0
    assert '  1000 m' in out
    assert '16:00 cirrus' in out


@pytest.mark.nightly
def test_given_a_place_of_ones_own_then_a_run_starts_there_in_another_process(taxinet, tmp_path):
    place = {**yaml.safe_load(find_place('kmwh_04').document), 'name': 'mine'}
    (tmp_path / 'mine.yaml').write_text(yaml.safe_dump(place))
    bag = record(tmp_path / 'drive', Drive(seconds=3, size=(200, 360)))
    code, *_ = taxinet('score', bag, '--place', 'mine.yaml', '--heading', '/imu', '--camera',
                       'wing', '--simulate', '--out', 'scored')
    assert code == 0
    PLACES._known.clear()
    PLACES.find.cache_clear()
    code, out, err = taxinet('run', '--from', 'scored', '--engine', 'loop', '--set', 'duration=1',
                             '--out', 'again', '--exit-zero')
    assert (code, err) == (0, '')
    assert 'place mine' in out


def test_given_bright_pictures_at_night_then_a_line_names_the_clock(taxinet, tmp_path):
    night = Drive(seconds=1, size=(200, 360), stamp=lambda kind, ns: ns + 9 * 3600 * 10**9)
    words = ('score', record(tmp_path / 'drive', night), '--place', 'kmwh_04', '--heading', '/imu',
             '--camera', 'wing', '--simulate', '--json')
    notes = json.loads(taxinet(*words)[1])['notes']
    [note] = [one for one in notes if one.startswith('simulate: ')]
    assert note.startswith('simulate: on 2023-11-14 at 23:13 the sun is ')
    assert 'deg below the horizon, but the recorded pictures are bright (mean grey 1' in note
    assert 'local time instead of UTC, the time_zone of the place, or the date' in note
    assert json.loads(taxinet(*words, '--set', 'time_of_day=14:13')[1])['notes'] == []


@pytest.mark.parametrize(('words', 'line'), [
    (('--metar', 'CLR'), '--metar: needs --simulate'),
    (('--set', 'clouds=clear'), '--set: needs --simulate'),
])
def test_given_what_needs_rendering_without_it_then_it_is_refused(taxinet, words, line):
    code, _, err = taxinet('score', 'nowhere', *words)
    assert (code, line in err) == (2, True)
