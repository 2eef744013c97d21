"""``taxinet place``, and places of an apt.dat on the command line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image
from taxinet_process import taxinet

from taxinet_ros.core.place.catalogue import SHIPPED_PLACES, typed_place

APT_DAT = """\
I
1100 Version

1 328 0 0 XTST Test Field
100 30.00 1 0 0.25 0 2 0 09 50.0 8.0 0 0 2 0 0 0 27 50.0 8.028 0 0 3 0 0 0
110 1 0.25 150.29 apron
111 50.001 8.002
111 50.001 8.004
113 50.002 8.004
99
"""


@pytest.fixture
def apt_dat(tmp_path: Path) -> Path:
    path = tmp_path / 'apt.dat'
    path.write_text(APT_DAT)
    return path


def test_given_no_more_words_when_listed_then_every_shipped_place_has_a_line():
    done = taxinet('place')
    assert done.returncode == 0
    assert [line.split()[0] for line in done.stdout.splitlines()] == list(SHIPPED_PLACES)
    assert '; tracks runway, exit_left\n' in done.stdout


def test_given_a_shipped_place_when_shown_then_it_is_told_and_drawn(tmp_path):
    done = taxinet('place', 'nzqn_05', '--out', tmp_path / 'map.png')
    assert done.returncode == 0, done.stderr
    assert 'end 05      -45.020123 168.734924, threshold displaced by 59.7 m' in done.stdout
    assert 'clocks      Pacific/Auckland' in done.stdout
    assert 'track ' not in done.stdout
    with Image.open(tmp_path / 'map.png') as drawn:
        assert drawn.size[0] == 1100


def test_given_the_same_place_when_drawn_twice_then_the_bytes_are_the_same(tmp_path, apt_dat):
    words = ('place', f'{apt_dat}:XTST/27', '--out')
    outs = [tmp_path / name for name in ('one.png', 'two.png')]
    for out in outs:
        done = taxinet(*words, out)
        assert done.returncode == 0, done.stderr
    assert (
        'around it   1 paved areas (aprons, taxiways, other runways), 0 painted lines, 0 taxi '
        'routes\n') in done.stdout
    assert outs[0].read_bytes() == outs[1].read_bytes()


def test_given_an_airport_when_written_as_yaml_then_the_file_is_the_same_place(tmp_path, apt_dat):
    path = tmp_path / 'mine.yaml'
    done = taxinet(
        'place', f'{apt_dat}:XTST/27', '--out', tmp_path / 'map.png', '--yaml', path)
    assert (done.returncode, done.stderr) == (0, '')
    assert typed_place(str(path)) == typed_place(f'{apt_dat}:XTST/27')
    assert '  - [1864.1, -111.21]\n' in path.read_text(), 'a point in a line'
    path.write_text(path.read_text().replace('width_m: 30.0', 'width_m: 45'))
    assert typed_place(str(path)).runway.width_m == 45
    again = taxinet('place', 'nzqn_05', '--out', tmp_path / 'other.png', '--yaml', path)
    assert (again.returncode, f'--yaml {path}: ' in again.stderr) == (2, True)


def test_given_a_runway_without_markings_when_shown_then_one_line_says_how_it_is_painted(
    tmp_path, apt_dat
):
    apt_dat.write_text(APT_DAT.replace(' 0 0 2 0 0 0 27', ' 0 0 0 0 0 0 27').replace(
        ' 0 0 3 0 0 0', ' 0 0 0 0 0 0'))
    done = taxinet('place', f'{apt_dat}:XTST/9', '--out', tmp_path / 'map.png')
    assert done.returncode == 0
    assert done.stderr == (
        f'taxinet: warning: {apt_dat}: row 5: markings of code 0, none; the runway is painted as '
        'visual\n')
    assert 'paint       visual' in done.stdout


@pytest.mark.nightly
def test_given_an_airport_when_run_there_then_the_table_says_so(tmp_path, apt_dat, monkeypatch):
    monkeypatch.setenv('TAXINET_APT_DAT', str(apt_dat))
    done = taxinet(
        'run', 'nominal', '--perception', 'truth', '--set', 'place=XTST/9',
        '--set', 'distance_m=500', '--set', 'duration_s=1', '--out', tmp_path / 'out',
    )
    assert done.returncode == 0, done.stderr
    assert 'xtst_09@' in (tmp_path / 'out' / 'runs.csv').read_text()
    apt_dat.unlink()
    again = taxinet('run', '--from', tmp_path / 'out' / 'nominal-s0-00000', '--out', tmp_path / 'b')
    assert again.returncode == 0, again.stderr
    assert 'the same: ' in again.stdout


def test_given_a_track_when_run_then_it_is_in_the_table_and_the_run_can_be_repeated(tmp_path):
    done = taxinet(
        'run', 'nominal', '--perception', 'truth', '--set', 'track=exit_left',
        '--set', 'distance_m=200', '--set', 'duration_s=12', '--images', 'none',
        '--out', tmp_path / 'out',
    )
    assert done.returncode == 0, done.stderr
    assert 'scene: track exit_left\n' in done.stdout
    assert re.search(r'° +200 m  10:02 clear$', done.stdout, re.MULTILINE)
    assert ',exit_left,' in (tmp_path / 'out' / 'runs.csv').read_text()
    bag = tmp_path / 'out' / 'nominal-s0-00000'
    info = taxinet('bag', 'info', bag)
    assert '200 m along exit_left' in info.stdout
    seen = taxinet('bag', 'render', bag, '--out', tmp_path / 'seen')
    assert seen.returncode == 0, seen.stderr
    again = taxinet('run', '--from', bag, '--out', tmp_path / 'again')
    assert again.returncode == 0, again.stderr
    judged = taxinet('monitor', bag, '--spec', 'on_the_way=always(x >= 199 and abs(he) <= 0.5)')
    assert judged.returncode == 0, judged.stdout + judged.stderr
