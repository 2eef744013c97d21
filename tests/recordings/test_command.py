"""``taxinet score`` at the command line, also on a run of ours."""

import json
import math
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import recordings
from PIL import Image
from rosbags.rosbag2 import StoragePlugin
from synthetic import Drive, pixels_of, record

import taxinet_ros as tx
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.perception.network import ARCHITECTURES, TaxiNet
from taxinet_ros.core.perception.weights import load_model, weights_path
from taxinet_ros.training.data.image_folder import load_folders

KNOWN = '--place', 'kmwh_04', '--truth', '/fix', '--heading', '/imu'


@pytest.fixture
def drive(tmp_path):
    return record(tmp_path / 'drive', Drive(seconds=30, noise_m=0.2))


def test_given_a_recording_when_scored_then_json_page_and_table_are_written(taxinet, drive, see):
    code, out, err = taxinet('score', drive, *KNOWN, '--perception', f'{see}:biased', '--against',
                             f'{see}:see', '--out', 'found', '--json')
    assert (code, err) == (0, '')
    values = json.loads(out)
    assert values['frames'] == 301
    assert values['cte_mae_m'] == pytest.approx(0.5, abs=0.1)
    assert values['heading_mae_deg'] == pytest.approx(1.0, abs=0.01)
    assert values == json.loads((drive.parent / 'found/score.json').read_text())
    table = pd.read_parquet(drive.parent / 'found/frames.parquet')
    assert len(table) == 301
    assert {'est_cte_m', 'est_cte_m_2', 'cte_error_m', 'sun_elevation_deg'} <= set(table)
    assert table['he_error_deg'].abs().mean() == pytest.approx(values['heading_mae_deg'])
    assert not any('error_error' in name for name in table)
    page = (drive.parent / 'found/score.html').read_text()
    assert 'Worst frames of see.py:biased' in page
    assert 'Worst frames of see.py:see' in page
    assert 'is better in heading' in page
    assert page.count('data:image/webp') >= 6
    code, _, err = taxinet('score', drive, *KNOWN, '--out', 'found')
    assert (code, 'already exists' in err) == (2, True)


def test_given_a_latency_then_what_is_said_to_be_taken_off_is_what_was(taxinet, tmp_path, see):
    bag = record(tmp_path / 'late', Drive(seconds=60, late_s=0.25))
    words = 'score', bag, *KNOWN, '--perception', f'{see}:biased', '--latency'
    own = taxinet(*words, 'estimated')[1]
    assert 's (0.' in own
    assert '), taken off.' in own
    assert '(on average +0.50 m and +1.00 deg, left positive, with' in ' '.join(own.split())
    assert 'within 1.5 m of the centreline all the time.' in own
    for given, said in (('0.25', 'Taken off, as given: 0.250 s.\n'), (
            '-0.25', 'Taken off, as given: −0.250 s, which does not fit: positive is late.\n')):
        out = taxinet(*words, given)[1]
        assert said in out
        assert '), taken off.' not in out


def test_given_functions_when_scored_then_lines_have_their_names(taxinet, drive, see):
    # To a terminal ``:feet:`` is a pictogram.
    _, out, _ = taxinet('score', drive, *KNOWN, '--perception', f'{see}:biased', '--against',
                        f'{see}:feet')
    assert '\nsee.py:feet: mean absolute error' in out
    assert '\nsee.py:feet is better in heading' in out


def test_given_a_requirement_that_is_asked_for_then_its_violation_is_the_exit_code(
    taxinet, drive, see
):
    words = 'score', drive, *KNOWN, '--perception', f'{see}:see'
    assert taxinet(*words)[0] == 0
    code, out, _ = taxinet(*words, '--spec', 'phi_always')
    assert (code, 'phi_always on the recorded path: 1 VIOLATED of 1 stretch' in out) == (1, True)
    beyond = '--spec', 'beyond=always[40:50](abs(cte) <= 9)'
    code, out, _ = taxinet(*words, *beyond)
    assert (code, 'beyond on the recorded path: 1 UNCLEAR of 1 stretch' in out) == (3, True)
    assert taxinet(*words, *beyond, '--spec', 'phi_always')[0] == 1


def test_given_a_recording_then_its_topics_are_proposed(taxinet, drive):
    code, out, _ = taxinet('score', '--topics', drive, '--json')
    assert code == 0
    rows = {row['topic']: row for row in json.loads(out)[str(drive)]}
    assert {name: row['use'] for name, row in rows.items()} == {
        '/cam': 'image', '/fix': 'truth', '/imu': 'heading'}
    assert rows['/cam']['messages'] == 301
    assert 'heading' in taxinet('score', '--topics', drive)[1]


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('words', 'line'), [
    ((), 'place is missing'),
    ((*KNOWN, 'drive'), 'a recording is named twice'),
    ((*KNOWN, '--simulate', '--perception', 'cmd:true'), '--simulate: not with'),
    ((*KNOWN, '--perception', 'truth'), 'uses no camera image'),
    ((*KNOWN, '--latency', 'soon'), "latency 'soon': expected seconds"),
    ((*KNOWN, '--antenna', '3'), "--antenna '3': expected X,Y"),
    ((*KNOWN, '--stamps', 'wall'), '--stamps wall: expected header or log'),
    ((*KNOWN, '--heading-is', 'ned'), '--heading-is ned: expected enu or compass'),
    ((*KNOWN, '--against', 'taxinet'), 'is the perception itself'),
    ((*KNOWN, '--aircraft', 'c172p'), 'without a camera it has no effect'),
    ((*KNOWN, '--camera', 'wing'), 'the pictures are 12 x 8, camera wing has 360 x 200'),
    ((*KNOWN, '--monitor', 'taxinet'), 'needs to know the camera'),
    ((*KNOWN[:2], '--truth', '/fix', '--heading', 'track', '--heading-offset', '3'),
     'no convention or offset'),
])
def test_given_a_mistake_then_one_line_says_it_and_nothing_is_written(taxinet, drive, words, line):
    code, out, err = taxinet('score', drive, *words)
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert line in err
    assert sorted(one.name for one in drive.parent.iterdir()) == ['drive']


def test_given_a_folder_of_recordings_then_it_asks_for_those_in_it(taxinet, drive):
    for name in ('a', 'b', 'c'):
        record(drive.parent / name, Drive(seconds=1), storage=StoragePlugin.SQLITE3)
    code, out, err = taxinet('score', '.', *KNOWN)
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert '.: is no recording, but a folder with 4; name one or several' in err
    assert err.endswith(': a b c …\n')


def test_given_a_folder_with_one_recording_then_that_is_scored(taxinet, drive, see):
    words = '--perception', f'{see}:see', '--json', '--dataset', 'images'
    found = [json.loads(taxinet('score', bag, *KNOWN, *words[:3])[1])
             for bag in (drive, drive.parent)]
    assert found[0]['bags'] == found[1]['bags'] == [str(drive)]
    assert found[0]['cte_mae_m'] == found[1]['cte_mae_m']
    code, _, err = taxinet('score', drive.parent, drive, *KNOWN, *words)
    assert (code, err) == (2, 'taxinet: error: score: a recording is named twice; leave one out\n')


def test_given_a_run_of_ours_then_place_truth_and_robustness_are_its_own(taxinet, tmp_path):
    code, *_ = taxinet(
        'run', 'nominal', '--engine', 'loop', '--images', 'all', '--set', 'duration=3',
        '--perception', 'original', '--seed', '3', '--out', 'ours', '--runs', '1', '--spec',
        'phi_always')
    assert code == 0
    bag = next((tmp_path / 'ours').glob('nominal-*'))
    code, out, err = taxinet('score', bag, '--perception', 'original', '--monitor', 'original',
                             '--json')
    assert (code, err) == (0, '')
    found, run = json.loads(out), open_recording(bag)
    assert found['frames'] == len(run.trace) == 31
    errors = (run.trace['est_cte_m'] - run.trace['cte_m']).abs()
    assert found['cte_mae_m'] == pytest.approx(errors.mean(), rel=1e-12)
    always = next(one for one in found['verdicts'] if one['spec'] == 'phi_always')
    assert always['lower'] == run.judge('phi_always').interval.lower
    assert found['alarms']['frames'] == 31
    assert found['notes'] == []
    # The same as `ros2 bag record` makes it: logged by the wall clock, with topics of others.
    again = recordings.record(tmp_path / 'recorded', recordings.heard([bag]), files=3)
    code, out, err = taxinet('score', again, '--perception', 'original', '--json')
    assert (code, err) == (0, '')
    other = json.loads(out)
    for key in ('frames', 'cte_mae_m', 'heading_mae_deg', 'latency', 'place', 'notes'):
        assert other[key] == found[key], key


def test_given_a_run_of_ours_at_another_rate_then_a_monitor_sees_each_step_and_its_command(
    taxinet, tmp_path,
):
    (tmp_path / 'watch.py').write_text(
        'def turned(seen):\n    return abs(seen.command.steering_rad)\n')
    run = tx.run(
        tx.Scenario(cross_track_m=2.0, duration_s=1.0, control_rate_hz=8), perception='truth')
    run.save_bag(tmp_path / 'ours')
    code, out, err = taxinet('score', 'ours', '--perception', 'original', '--json', '--monitor',
                             f'{tmp_path / "watch.py"}:turned')
    assert (code, err) == (0, '')
    alarms = json.loads(out)['alarms']
    assert alarms['frames'] == len(run.trace) == 9
    assert alarms['largest']['turned'] == run.trace['steering_rad'][:-1].abs().max() > 0


@pytest.mark.ros
def test_given_a_node_of_ones_own_then_it_gets_every_picture_in_lockstep(taxinet, tmp_path):
    example = Path(__file__).parents[2] / 'examples'
    node = shlex.join([sys.executable, str(
        example / 'my_perception_package/my_perception_package/perception.py')])
    drive = record(tmp_path / 'drive', Drive(
        seconds=3, size=(200, 360), picture=lambda pixels: pixels // 2))
    found = []
    for _ in range(2):
        code, out, err = taxinet(
            'score', drive, *KNOWN, '--perception', f'cmd:{node}', '--json', '--out',
            f'out{len(found)}',
        )
        assert (code, err) == (0, ''), err
        found.append(json.loads(out))
    assert found[0]['counts'] == {'scored': 31}
    tables = [pd.read_parquet(tmp_path / f'out{n}/frames.parquet') for n in range(2)]
    pd.testing.assert_frame_equal(*tables)
    function = f'{example}/perception_function.py:bright_paint'
    assert 'perception.py' in next(iter(found[0]['networks']))
    assert taxinet('score', drive, *KNOWN, '--perception', function)[0] == 0
    code, _, err = taxinet('score', drive, *KNOWN, '--perception', 'cmd:no-such-program')
    assert (code, 'no such program' in err) == (2, True)


@pytest.mark.nightly
def test_given_recordings_then_labelled_images_are_thinned_and_trained_on(taxinet, see, tmp_path):
    from taxinet_ros.core.perception.weights import load_card

    drive = Drive(seconds=12, size=(100, 200))
    drives = [record(tmp_path / name, drive) for name in ('one', 'two')]
    words = 'score', *drives, *KNOWN, '--perception', f'{see}:see', '--dataset', 'images'
    code, out, _ = taxinet(*words)
    assert code == 0
    labels = pd.read_csv(tmp_path / 'images/one/labels.csv')
    assert f'{len(labels)} labelled images: images/one' in out
    steps = labels[['distance_m', 'cte_m', 'heading_error_deg']].diff().abs().iloc[1:]
    assert (steps.to_numpy() >= [1.0, 1.0, 2.0]).any(axis=1).all()
    assert 40 < len(labels) < 121
    # The images say what the labels say.
    code, out, _ = taxinet(
        'evaluate', 'images/two', '--perception', f'{see}:see', '--json')
    assert code == 0
    assert json.loads(out)['slices'][0]['errors']['cte_m']['mae'] < 0.001
    assert taxinet(*words)[0] == 2
    code, _, err = taxinet(
        'train', 'training_original', '--images', '8', '--validation', '4', '--epochs', '1',
        '--batch', '4', '--workers', '1', '--add', 'images/one', '--out', 'mixed.safetensors')
    assert code == 0, err
    card = load_card(tmp_path / 'mixed.json')
    assert card.images == 8 + len(labels)
    assert [(one.kind, one.name) for one in card.training_data] == [
        ('program', 'training_original'), ('folder', 'one')]
    assert '--add images/one' in card.command_line
    assert card.domain is None


@pytest.mark.nightly
def test_given_a_known_camera_then_labelled_images_name_it_and_a_view_shows_them_as_in_the_run(
    taxinet, tmp_path
):
    (tmp_path / 'mine.yaml').write_text('{base: nose, dx_m: 0.2, dyaw_deg: 2}')
    code, *_ = taxinet(
        'run', 'nominal', '--engine', 'loop', '--images', 'all', '--set', 'duration=3', '--set',
        'camera=mine.yaml', '--perception', 'anywhere', '--seed', '3', '--out', 'ours',
        '--exit-zero')
    assert code == 0
    bag = next((tmp_path / 'ours').glob('nominal-*'))
    code, _, err = taxinet('score', bag, '--perception', 'anywhere', '--dataset', 'images')
    assert (code, err) == (0, '')
    folder, run = tmp_path / 'images' / bag.name, open_recording(bag)
    labels = pd.read_csv(folder / 'labels.csv')
    assert set(zip(labels['camera'], labels['aircraft'], strict=True)) == {
        ('camera.yaml', 'caravan')}
    pictures = load_folders([folder], workers=1, view='ahead')[0].pictures
    anywhere = load_model(weights_path('anywhere'))
    network = TaxiNet(ARCHITECTURES[anywhere.card.architecture], anywhere.weights)
    shown = run.trace.set_index('cte_m').loc[labels['cte_m'], ['est_cte_m', 'est_he_rad']]
    assert len(pictures) == len(shown) > 5
    assert network.infer(pictures).tolist() == shown.to_numpy().tolist()
    code, _, err = taxinet(
        'train', 'training_original', '--images', '8', '--validation', '4', '--epochs', '1',
        '--batch', '4', '--workers', '1', '--start', 'anywhere', '--add', folder, '--out',
        'mixed.safetensors')
    assert code == 0, err
    card = load_model(tmp_path / 'mixed.safetensors').card
    assert (card.view, card.images) == ('ahead', 8 + len(labels))
    assert [(one.kind, one.name) for one in card.training_data] == [
        ('program', 'training_original'), ('folder', bag.name)]


@pytest.mark.nightly
def test_given_labelled_frames_when_laid_into_a_bag_then_their_labels_are_the_truth(
    taxinet, see, tmp_path
):
    folder = tmp_path / 'frames'
    folder.mkdir()
    rows = ['image,cte_m,heading_error_deg,distance_m']
    for number in range(40):
        distance, cte, he = 50 + 0.6 * (number % 20), 3 * math.sin(number / 5), number / 200
        Image.fromarray(pixels_of(cte, he, (64, 192))).save(folder / f'{number}.png')
        rows.append(f'{number}.png,{cte},{math.degrees(he)},{distance}')
    (folder / 'labels.csv').write_text('\n'.join(rows))
    script = Path(__file__).parents[2] / 'examples/labelled_frames_to_bag.py'
    subprocess.run(
        [sys.executable, script, folder, tmp_path / 'laid', '--distance-offset', '29.5'],
        check=True, capture_output=True)
    code, out, _ = taxinet('score', 'laid', *KNOWN, '--perception', f'{see}:biased', '--out',
                           'found', '--json')
    assert code == 0
    values = json.loads(out)
    assert values['frames'] == 40
    assert (values['cte_mae_m'], values['heading_mae_deg']) == pytest.approx((0.5, 1.0), abs=1e-3)
    table = pd.read_parquet(tmp_path / 'found/frames.parquet')
    assert table['distance_m'].iloc[0] == pytest.approx(79.5, abs=1e-3)
    assert 10 < table['sun_elevation_deg'].iloc[0] < 30
