"""``taxinet frame``: frames and sheets as people ask for them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taxinet_ros.analysis.camera.sheets import scene_picture
from taxinet_ros.cli.main import main
from taxinet_ros.core.scenario import Scenario, scenario_from_human

pytestmark = pytest.mark.nightly

Output = tuple[int, str, str]


@pytest.fixture
def taxinet(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Type words after ``taxinet frame`` in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('COLUMNS', '80')

    def call(*words: str) -> Output:
        monkeypatch.setattr(sys, 'argv', ['taxinet', 'frame', *words])
        with pytest.raises(SystemExit) as left:
            main()
        code = left.value.code
        assert isinstance(code, int)
        return code, *capsys.readouterr()

    return call


def picture_of(path: str) -> np.ndarray:
    return np.asarray(Image.open(path))


def test_given_a_scene_when_framed_then_the_file_is_what_the_camera_sees(taxinet):
    code, out, err = taxinet('--set', 'heading=10', '--set', 'time_of_day=15', '--out', 'f.png')
    assert (code, out, err) == (0, 'picture: f.png\n', '')
    scene = Scenario(heading_rad=float(np.radians(10)), time_of_day_s=15 * 3600)
    np.testing.assert_array_equal(picture_of('f.png'), scene_picture(scene))


def test_given_no_file_when_framed_twice_then_both_are_new_files(taxinet):
    for name in ('camera-frame.png', 'camera-frame-2.png'):
        assert taxinet()[:2] == (0, f'picture: bags/{name}\n')
        assert picture_of(f'bags/{name}').shape == (200, 360, 3)


def test_given_hours_and_skies_when_a_sheet_is_asked_for_then_it_holds_just_those(taxinet):
    code, out, err = taxinet('--hours', '10, 15', '--clouds', 'clear,stratus',
                             '--set', 'distance=800', '--out', 's.png')  # fmt: skip
    assert (code, out, err) == (0, 'picture: s.png\n', '')
    sheet = picture_of('s.png')
    for hour in (10, 15):
        for clouds in ('clear', 'stratus'):
            scene = {'time_of_day': hour, 'clouds': clouds, 'distance': 800, 'cross_track': 1,
                     'heading': 4}  # fmt: skip
            assert holds(sheet, scene_picture(scenario_from_human(scene))), (hour, clouds)
    assert 2 * 360 < sheet.shape[1] < 3 * 360
    assert 2 * 200 < sheet.shape[0] < 3 * 200


def test_given_rain_when_a_sheet_is_asked_for_then_it_has_a_row_per_cloud_and_rain(taxinet):
    assert taxinet('--hours', '12', '--rain', '0,80', '--out', 's.png')[0] == 0
    assert 6 * 200 < picture_of('s.png').shape[0] < 7 * 200


def holds(sheet: np.ndarray, tile: np.ndarray) -> bool:
    """Whether a picture lies somewhere on a sheet, pixel by pixel."""
    height, width = tile.shape[:2]
    corners = np.argwhere((sheet[: -height + 1, : -width + 1] == tile[0, 0]).all(axis=2))
    return any((sheet[y : y + height, x : x + width] == tile).all() for y, x in corners)


BAD = {
    'no key': (['--set', 'clouds'], 'expected key=value'),
    'unknown key': (['--set', 'cloud=clear'], "unknown key 'cloud'"),
    'key twice': (['--set', 'rain=1', '--set', 'rain=2'], 'rain is given twice'),
    'no PNG': (['--out', 'f.jpg'], 'use f.png'),
    'no parent': (['--out', 'no/where.png'], 'no such folder: no'),
    'not writable': (['--out', '/proc/f.png'], 'cannot be written'),
    'hours twice': (['--rain', '9', '--set', 'time_of_day=9'], 'use --hours 9'),
    'hours no numbers': (['--hours', 'noon'], "--hours 'noon': expected comma-"),
    'impossible hour': (['--hours', '25'], 'outside 0..24 h'),
    'unknown sky': (['--clouds', 'fog'], "clouds is 'fog'"),
    'rain from a clear sky': (['--clouds', 'clear', '--rain', '9'], 'rain needs clouds'),
    'an extra word': (['film'], 'film'),
}


@pytest.mark.parametrize('case', BAD)
def test_given_a_mistake_then_one_line_says_what_and_nothing_is_written(
    case, taxinet, tmp_path,
):
    words, expected = BAD[case]
    code, out, err = taxinet(*words)
    assert (code, out) == (2, '')
    (line,) = err.strip().splitlines()
    assert line.startswith('taxinet: error: ')
    assert expected in line
    assert list(tmp_path.iterdir()) == []


def test_given_a_file_that_exists_then_it_is_left_alone(taxinet, tmp_path):
    (tmp_path / 'mine.png').write_text('mine')
    for words in ([], ['--hours', '9']):
        code, _, err = taxinet(*words, '--out', 'mine.png')
        assert code == 2
        assert 'is not overwritten' in err
    assert (tmp_path / 'mine.png').read_text() == 'mine'
