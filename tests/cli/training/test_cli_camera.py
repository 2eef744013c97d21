"""``taxinet camera``: frames, sheets and comparisons as people ask for them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taxinet_ros.analysis.camera.sheets import scene_picture
from taxinet_ros.cli.main import main
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import Scenario, scenario_from_human

pytestmark = pytest.mark.nightly

Output = tuple[int, str, str]


@pytest.fixture
def taxinet(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Type words after ``taxinet camera`` in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('COLUMNS', '80')

    def call(*words: str) -> Output:
        monkeypatch.setattr(sys, 'argv', ['taxinet', 'camera', *words])
        with pytest.raises(SystemExit) as left:
            main()
        code = left.value.code
        assert isinstance(code, int)
        return code, *capsys.readouterr()

    return call


@pytest.fixture(scope='module')
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames of our own camera in the form of foreign ones, one twice the size."""
    folder = tmp_path_factory.mktemp('drive')
    lines = ['image,cte_m,heading_error_deg,distance_m']
    for k, (cte, heading, distance) in enumerate(((-3, 5, 971), (0, -8, 990), (4, 0, 1010))):
        pose = {'cross_track': cte, 'heading': heading, 'distance': distance, 'time_of_day': 10}
        picture = Image.fromarray(scene_picture(scenario_from_human(pose)))
        if k == 2:
            picture = picture.resize((720, 400))
        picture.save(folder / f'{k}.png')
        lines.append(f'{k}.png,{cte},{heading},{distance}')
    (folder / 'labels.csv').write_text('\n'.join(lines))
    return folder


def picture_of(path: str) -> np.ndarray:
    return np.asarray(Image.open(path))


def test_given_a_scene_when_framed_then_the_file_is_what_the_camera_sees(taxinet):
    code, out, err = taxinet('frame', '--set', 'heading=10', '--set', 'time_of_day=15',
                             '--out', 'f.png')  # fmt: skip
    assert (code, out, err) == (0, 'picture: f.png\n', '')
    scene = Scenario(heading_rad=float(np.radians(10)), time_of_day_s=15 * 3600)
    np.testing.assert_array_equal(picture_of('f.png'), scene_picture(scene))


def test_given_no_file_when_framed_twice_then_both_are_new_files(taxinet):
    for name in ('camera-frame.png', 'camera-frame-2.png'):
        assert taxinet('frame')[:2] == (0, f'picture: bags/{name}\n')
        assert picture_of(f'bags/{name}').shape == (200, 360, 3)


def test_given_hours_and_skies_when_a_sheet_is_asked_for_then_it_holds_just_those(taxinet):
    code, out, err = taxinet('sheet', '--hours', '10, 15', '--clouds', 'clear,stratus',
                             '--set', 'distance=800', '--out', 's.png')  # fmt: skip
    assert (code, out, err) == (0, 'sheet: s.png\n', '')
    sheet = picture_of('s.png')
    for hour in (10, 15):
        for clouds in ('clear', 'stratus'):
            scene = {'time_of_day': hour, 'clouds': clouds, 'distance': 800, 'cross_track': 1,
                     'heading': 4}  # fmt: skip
            assert holds(sheet, scene_picture(scenario_from_human(scene))), (hour, clouds)
    assert 2 * 360 < sheet.shape[1] < 3 * 360
    assert 2 * 200 < sheet.shape[0] < 3 * 200


def test_given_rain_when_a_sheet_is_asked_for_then_it_has_a_row_per_cloud_and_rain(taxinet):
    assert taxinet('sheet', '--hours', '12', '--rain', '0,80', '--out', 's.png')[0] == 0
    assert 6 * 200 < picture_of('s.png').shape[0] < 7 * 200


def holds(sheet: np.ndarray, tile: np.ndarray) -> bool:
    """Whether a picture lies somewhere on a sheet, pixel by pixel."""
    height, width = tile.shape[:2]
    corners = np.argwhere((sheet[: -height + 1, : -width + 1] == tile[0, 0]).all(axis=2))
    return any((sheet[y : y + height, x : x + width] == tile).all() for y, x in corners)


def test_given_frames_when_compared_then_there_are_a_table_and_a_sheet(taxinet, drive):
    before = sorted(drive.iterdir())
    code, out, err = taxinet('compare', str(drive))
    assert (code, err) == (0, '')
    assert 'cross-track, m' in out
    assert 'heading, deg' in out
    assert '3 frames, 0 without estimate; perception taxinet' in out
    name = f'bags/camera-compare-{drive.name}.png'
    assert out.endswith(f'sheet: {name}\n')
    sheet = picture_of(name)
    assert holds(sheet, picture_of(str(drive / '0.png')))
    assert sorted(drive.iterdir()) == before


def test_given_json_when_compared_then_stdout_is_one_object_and_stderr_names_the_sheet(
    taxinet, drive,
):
    code, out, err = taxinet('compare', str(drive), '--json', '--out', 'c.png',
                             '--set', 'time_of_day=10', '--distance-offset', '2')  # fmt: skip
    assert (code, err) == (0, 'sheet: c.png\n')
    values = json.loads(out)
    assert (values['frame_count'], values['without_estimate']) == (3, 0)
    assert [frame['image'] for frame in values['frames']] == ['0.png', '1.png', '2.png']
    assert [frame['cte_m'] for frame in values['frames']] == [-3, 0, 4]
    seen = make_perception('taxinet').estimate(picture_of(str(drive / '0.png')), None)
    assert values['frames'][0]['cte_estimate_m'] == pytest.approx(seen.cte_m)
    errors = [abs(frame['cte_estimate_m'] - frame['cte_m']) for frame in values['frames']]
    assert values['cte_mae_m'] == pytest.approx(np.mean(errors))
    assert values['mean_predictor_cte_mae_m'] == pytest.approx(22 / 9)
    low, high = values['heading_error_mae_deg_95']
    assert low <= values['heading_error_mae_deg'] <= high
    assert len(values['weights_sha256']) == 64
    assert (values['sheet'], values['distance_offset_m']) == ('c.png', 2)


BAD = {
    'truth': (['compare', 'DRIVE', '--perception', 'truth'], 'uses no camera image'),
    'unknown perception': (['compare', 'DRIVE', '--perception', 'tru'], 'known: truth, taxinet'),
    'no folder': (['compare', 'nowhere'], 'nowhere: no such folder'),
    'no labels': (['compare', '.'], 'labels.csv: no such file'),
    'pose set twice': (['compare', 'DRIVE', '--set', 'heading=3'], 'heading_deg: given by the'),
    'bad light': (['compare', 'DRIVE', '--set', 'clouds=fog'], "clouds is 'fog'"),
    'off our runway': (['compare', 'DRIVE', '--distance-offset', '9000'], '--distance-offset'),
    'no number': (['compare', 'DRIVE', '--distance-offset', 'nan'], 'a finite number'),
    'no key': (['frame', '--set', 'clouds'], 'expected key=value'),
    'unknown key': (['frame', '--set', 'cloud=clear'], "unknown key 'cloud'"),
    'key twice': (['frame', '--set', 'rain=1', '--set', 'rain=2'], 'rain is given twice'),
    'no PNG': (['frame', '--out', 'f.jpg'], 'use f.png'),
    'no parent': (['frame', '--out', 'no/where.png'], 'no such folder: no'),
    'not writable': (['frame', '--out', '/proc/f.png'], 'cannot be written'),
    'hours twice': (['sheet', '--set', 'time_of_day=9'], 'use --hours 9'),
    'hours no numbers': (['sheet', '--hours', 'noon'], "--hours 'noon': expected comma-"),
    'impossible hour': (['sheet', '--hours', '25'], 'outside 0..24 h'),
    'unknown sky': (['sheet', '--clouds', 'fog'], "clouds is 'fog'"),
    'rain from a clear sky': (['sheet', '--clouds', 'clear', '--rain', '9'], 'rain needs clouds'),
    'unknown command': (['film'], 'film'),
}


@pytest.mark.parametrize('case', BAD)
def test_given_a_mistake_then_one_line_says_what_and_nothing_is_written(
    case, taxinet, drive, tmp_path,
):
    words, expected = BAD[case]
    code, out, err = taxinet(*(str(drive) if word == 'DRIVE' else word for word in words))
    assert (code, out) == (2, '')
    (line,) = err.strip().splitlines()
    assert line.startswith('taxinet: error: ')
    assert expected in line
    assert list(tmp_path.iterdir()) == []


def test_given_a_file_that_exists_then_it_is_left_alone(taxinet, tmp_path):
    (tmp_path / 'mine.png').write_text('mine')
    for command in ('frame', 'sheet'):
        code, _, err = taxinet(command, '--out', 'mine.png')
        assert code == 2
        assert 'is not overwritten' in err
    assert (tmp_path / 'mine.png').read_text() == 'mine'


def test_given_no_word_then_the_commands_are_listed(taxinet):
    code, out, _ = taxinet()
    assert code == 0
    for command in ('frame', 'sheet', 'compare'):
        assert f'  {command} ' in out
