"""``taxinet aircraft`` and ``camera``; the aircraft and the camera of a scene."""

from __future__ import annotations

import shutil
from pathlib import Path

import jsbsim
import pytest
from PIL import Image
from taxinet_process import taxinet

from taxinet_ros.core.rig.catalogue import AIRCRAFT, CAMERAS

CAMERA = """\
name: mine
offset_m: [2.0, 0, 0.8]
pitch_deg: 8
size_px: [480, 270]
field_of_view_deg: 80
"""


@pytest.mark.parametrize(('words', 'names'), [
    (('aircraft',), AIRCRAFT.shipped), (('camera',), CAMERAS.shipped),
])
def test_given_no_more_words_when_listed_then_every_shipped_one_has_a_line(words, names):
    done = taxinet(*words)
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()] == list(names)


def test_given_a_model_when_shown_then_what_its_file_leaves_out_is_measured(tmp_path):
    shutil.copytree(Path(jsbsim.__file__).parent / 'aircraft' / 'J3Cub', tmp_path / 'J3Cub')
    (tmp_path / 'own.yaml').write_text('name: own\nmodel: ./J3Cub\n')
    done = taxinet('aircraft', tmp_path / 'own.yaml')
    assert done.returncode == 0, done.stderr
    assert 'model       J3Cub (JSBSim), 4 files carried by scenarios' in done.stdout
    assert 'settled     {height_m: 1.16' in done.stdout
    assert done.stdout.count('(measured)') == 2
    assert 'outline     none: it casts no shadow' in done.stdout


@pytest.mark.nightly
def test_given_an_aircraft_when_shown_twice_then_it_is_drawn_in_the_same_bytes(tmp_path):
    outs = [tmp_path / name for name in ('one.png', 'two.png')]
    for out in outs:
        done = taxinet('aircraft', 'c172p', '--out', out)
        assert done.returncode == 0, done.stderr
    assert '40 convex parts cast its shadow' in done.stdout
    assert outs[0].read_bytes() == outs[1].read_bytes()


def test_given_a_camera_when_shown_then_its_lens_is_told_and_its_view_drawn(tmp_path):
    (tmp_path / 'mine.yaml').write_text(CAMERA)
    done = taxinet(
        'camera', tmp_path / 'mine.yaml', '--aircraft', 'c172p', '--out',
        tmp_path / 'view.png',
    )
    assert done.returncode == 0, done.stderr
    assert 'picture     480 x 270 px, field of view 80.0 x 50.5 deg' in done.stdout
    assert 'networks    take 360x200' in done.stdout
    with Image.open(tmp_path / 'view.png') as drawn:
        assert drawn.size == (1100, 860)


def test_a_shipped_camera_written_as_yaml_makes_the_same_frame_and_a_changed_one_is_warned_of(
    tmp_path
):
    own, frames = tmp_path / 'own.yaml', []
    show = 'camera', 'wing', '--out', tmp_path / 'view.png', '--yaml', own
    done = taxinet(*show)
    assert done.returncode == 0, done.stderr
    assert 'mount       0.085 m forward, 2.17 m right, 0.5 m up from the centre' in done.stdout
    assert 'aircraft_parts: by_hand' in done.stdout
    for camera in ('wing', own):
        frames.append(tmp_path / f'{len(frames)}.png')
        done = taxinet('frame', '--set', f'camera={camera}', '--out', frames[-1])
        assert (done.returncode, done.stderr) == (0, '')
    assert frames[0].read_bytes() == frames[1].read_bytes()
    own.write_text(own.read_text().replace('by_hand', 'outline').replace('10.42', '10.4'))
    done = taxinet('frame', '--set', f'camera={own}', '--out', tmp_path / 'covered.png')
    assert 'the aircraft itself (caravan) covers 94 % of the picture' in done.stderr
    assert done.stderr.count('\n') == 1
    (tmp_path / 'view.png').unlink()
    assert 'File exists' in taxinet(*show).stderr


def test_given_a_camera_when_a_frame_is_rendered_then_it_is_as_large_as_the_camera_makes_it(
    tmp_path
):
    (tmp_path / 'mine.yaml').write_text(CAMERA)
    done = taxinet(
        'frame', '--set', f'camera={tmp_path / "mine.yaml"}', '--set', 'aircraft=c172p',
        '--out', tmp_path / 'frame.png',
    )
    assert done.returncode == 0, done.stderr
    with Image.open(tmp_path / 'frame.png') as frame:
        assert frame.size == (480, 270)


def test_given_files_when_run_then_the_table_has_their_digests_and_the_bag_needs_none(tmp_path):
    (tmp_path / 'mine.yaml').write_text(CAMERA)
    (tmp_path / 'own.yaml').write_text('name: own\nmodel: c172p\nmost_wind_mps: 4\n')
    done = taxinet(
        'run', 'nominal', '--perception', 'truth', '--set', f'aircraft={tmp_path / "own.yaml"}',
        '--set', f'camera={tmp_path / "mine.yaml"}', '--set', 'duration_s=1',
        '--out', tmp_path / 'out',
    )
    assert done.returncode == 0, done.stderr
    table = (tmp_path / 'out' / 'runs.csv').read_text()
    assert 'own@' in table
    assert 'mine@' in table
    for name in ('mine.yaml', 'own.yaml'):
        (tmp_path / name).unlink()
    again = taxinet('run', '--from', tmp_path / 'out' / 'nominal-s0-00000', '--out', tmp_path / 'b')
    assert again.returncode == 0, again.stderr
    assert 'the same: ' in again.stdout


def test_given_an_aircraft_that_cannot_taxi_when_run_then_one_line_says_why(tmp_path):
    (tmp_path / 'own.yaml').write_text('name: own\nmodel: F450\n')
    done = taxinet(
        'run', 'nominal', '--set', f'aircraft={tmp_path / "own.yaml"}', '--out', tmp_path / 'o')
    assert done.returncode == 2
    assert 'aircraft own: no wheel of the model F450 steers' in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_given_a_camera_that_fits_the_aircraft_only_when_both_are_named_then_it_is_taken(tmp_path):
    (tmp_path / 'high.yaml').write_text(
        'name: high\nmodel: c172p\nsettled: {height_m: 1.328, pitch_deg: -2.5}\n'
    )
    (tmp_path / 'low.yaml').write_text(CAMERA.replace('[2.0, 0, 0.8]', '[-8.0, 0, -1.5]'))
    done = taxinet(
        'run', 'nominal', '--set', f'camera={tmp_path / "low.yaml"}',
        '--set', f'aircraft={tmp_path / "high.yaml"}', '--out', tmp_path / 'out',
    )
    assert done.returncode == 2
    assert 'camera mine on aircraft high is -' in done.stderr, 'not on the usual Caravan'
