"""``taxinet bag info | recover | export`` and ``doctor BAG``: what is printed, the exit codes."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from bag_faults import chunks_of
from PIL import Image
from whole_runs import PER_STEP, RUN_ID, STEPS, WEIGHTS, write_run

from taxinet_ros.analysis.one_run.film import film_frames
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import make_atomically

Taxinet = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope='module')
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a whole run, one cut off, and one with a flipped bit."""
    folder = tmp_path_factory.mktemp('bags')
    file = write_run(folder / 'run')
    data = bytearray(file.read_bytes())
    (_, end) = chunks_of(bytes(data))[9]
    (folder / 'cut').mkdir()
    (folder / 'cut' / 'cut_0.mcap').write_bytes(data[:end + 20])
    data[end - 6] ^= 1
    (folder / 'flipped').mkdir()
    (folder / 'flipped' / 'flipped_0.mcap').write_bytes(data)
    (folder / 'garbage.mcap').write_bytes(b'garbage' * 9)
    (folder / 'sqlite').mkdir()
    (folder / 'sqlite' / 's_0.db3').touch()
    (folder / 'empty').mkdir()
    return folder


@pytest.fixture
def bag(
    made: Path, taxinet: Taxinet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Taxinet:
    """Types ``taxinet bag …`` beside the bags; new files go into ``NEW/``."""
    monkeypatch.setenv('COLUMNS', '200')
    monkeypatch.chdir(made)
    return lambda *words: taxinet('bag', *(word.replace('NEW', str(tmp_path)) for word in words))


def test_given_a_run_when_asked_for_info_then_people_see_run_scene_and_outcome(
    bag: Taxinet,
) -> None:
    code, out, err = bag('info', 'run')
    assert (code, err) == (0, '')
    for words in (
        f'run        {RUN_ID} (program, seed 7, index 3), recorded by taxinet_ros 1.2.3',
        'outcome    PASS, 16 control steps judged',
        'on_runway: rho +12.7',
        'CTE -2.50 m (left positive), HE +8.0 deg, 640 m past the threshold, 2020-03-20 09:15, '
        'broken, rain 30 %',
        f'perception taxinet, weights {WEIGHTS}',
        'gains      heading_gain=1.5',
        'stayed on the runway, |CTE| at most 2.50 m',
        'bag        whole',
        '/taxi_command                    16  taxinet_msgs/msg/TaxiCommand',
        'attached   manifest.json, scenario.json',
    ):
        assert words in out


def test_given_json_when_asked_for_info_then_it_is_one_object(bag: Taxinet) -> None:
    code, out, _ = bag('info', 'run', '--json')
    values = json.loads(out)
    assert (code, values['whole'], values['messages']) == (0, True, 168)
    assert values['run']['scene']['heading_deg'] == pytest.approx(8)
    assert values['run']['judged']['on_runway']['lower'] > 12
    code, out, _ = bag('info', 'cut', '--json')
    values = json.loads(out)
    assert (code, values['whole']) == (3, False)
    assert values['run']['judged']['phi_eventually']['lower'] == '-inf'


@pytest.mark.parametrize(('name', 'code'), [('run', 0), ('cut', 3), ('flipped', 3)])
def test_given_a_bag_when_the_doctor_looks_then_exit_code_and_json_agree(
    bag: Taxinet, taxinet: Taxinet, name: str, code: int
) -> None:
    said, out, err = taxinet('doctor', name)
    assert (said, err) == (code, '')
    assert ('nothing is wrong' in out) == (code == 0)
    assert (f'fixed by: taxinet bag recover {name} --out NEW' in out) == (code == 3)
    said, out, _ = taxinet('doctor', name, '--json')
    values = json.loads(out)
    assert (said, values['sound']) == (code, code == 0)
    assert len(values['checks']) == 4


def test_given_other_forms_of_a_bag_then_the_doctor_knows_them_from_results(
    bag: Taxinet, taxinet: Taxinet, made: Path, tmp_path: Path
) -> None:
    assert taxinet('doctor', 'run/run_0.mcap')[0] == 0
    assert 'an sqlite3 bag; convert it' in taxinet('doctor', 'sqlite')[2]
    assert 'contains no .mcap' in taxinet('doctor', 'empty')[2]
    assert 'no such bag' in taxinet('doctor', 'nothing')[2]
    noted = tmp_path / 'noted'
    shutil.copytree(made / 'run', noted)
    (noted / 'notes.json').write_text('{}')
    assert 'nothing is wrong' in taxinet('doctor', str(noted))[1]
    (tmp_path / 'page.html').touch()
    assert 'contains no bag, campaign' in taxinet('doctor', str(tmp_path))[2]


def test_given_damaged_bags_when_recovered_then_the_new_ones_are_whole(
    bag: Taxinet, made: Path, tmp_path: Path
) -> None:
    before = {path: path.read_bytes() for path in made.rglob('*') if path.is_file()}
    code, out, err = bag('recover', 'flipped', '--out', 'NEW/f')
    assert (code, err) == (3, '')
    assert 'damage: flipped/flipped_0.mcap: at byte' in out
    (intact,) = map(int, re.findall(r'; (\d+) intact messages before\n', out))
    steps = (intact - 6) // PER_STEP
    assert steps > 1
    assert f'saved {intact} messages, {steps} whole control steps of 16 planned, into' in out
    assert f'lost {168 - intact} of 168 messages' in out
    assert 'mcap recover flipped/flipped_0.mcap -o NEW.mcap' in out
    code, out, _ = bag('recover', 'cut', '--out', 'NEW/c')
    assert code == 3
    assert 'lost an unknown amount of data being written' in out
    assert 'mcap recover' not in out, 'nothing lies behind the end of a file'
    code, out, _ = bag('recover', 'run', '--out', 'NEW/run')
    assert code == 0
    assert 'lost' not in out
    assert (tmp_path / 'run' / 'run_0.mcap').read_bytes() == before[made / 'run' / 'run_0.mcap']
    for name in ('f', 'c', 'run'):
        assert bag('info', f'NEW/{name}')[0] == 0
    assert {path: path.read_bytes() for path in made.rglob('*') if path.is_file()} == before


def test_given_tables_when_exported_then_files_hold_them_with_units(
    bag: Taxinet, tmp_path: Path
) -> None:
    code, out, err = bag('export', 'run', '--out', 'NEW/t.csv')
    assert (code, err) == (0, '')
    assert out.startswith(f'table: {tmp_path}/t.csv (16 rows, ')
    trace = pd.read_csv(tmp_path / 't.csv')
    assert trace['cte_m'][0] == pytest.approx(-2.5)
    assert bag('export', 'run', '--out', 'NEW/c.csv', '--topics', 'taxi_command')[0] == 0
    assert 'steering_angle [rad]' in pd.read_csv(tmp_path / 'c.csv').columns
    assert bag('export', 'run', '--out', 'NEW/all', '--format', 'parquet')[0] == 0
    names = {path.name for path in (tmp_path / 'all').iterdir()}
    assert {'taxi_command.parquet', 'ground_truth.odom.parquet'} <= names
    assert 'camera.image_raw.parquet' not in names
    odometry = pd.read_parquet(tmp_path / 'all' / 'ground_truth.odom.parquet')
    assert odometry.attrs['units']['pose.pose.position.x'] == 'm'


@pytest.mark.nightly
def test_given_films_when_exported_then_every_step_is_a_frame_with_its_picture(
    bag: Taxinet, tmp_path: Path
) -> None:
    assert bag('export', 'run', '--out', 'NEW/f.mp4') == (
        0, f'film: {tmp_path}/f.mp4 ({STEPS} frames)\n', ''
    )
    film = cv2.VideoCapture(str(tmp_path / 'f.mp4'))
    assert film.get(cv2.CAP_PROP_FPS) == 10
    frames = [film.read()[1] for _ in range(STEPS)]
    film.release()
    assert frames[0].shape == (960, 1080, 3)
    # The recorded frames are plain grey, lighter at every step; below them stand plots.
    for step, frame in enumerate(frames):
        assert np.median(frame[300:400, 300:700]) == pytest.approx(60 + 10 * step, abs=4)
    assert np.mean(frames[-1][640:900]) > 200
    assert bag('export', 'run', '--out', 'NEW/f.gif')[0] == 0
    with Image.open(tmp_path / 'f.gif') as gif:
        assert (gif.size, gif.n_frames, gif.info['duration']) == ((540, 480), STEPS // 2, 200)


def test_frames_of_another_size_are_filmed_in_the_same_size(made: Path) -> None:
    sizes = [(720, 400), (9, 5), *[(360, 200)] * (STEPS - 2)]
    assert [frame.shape for frame in film_frames(_filmed(made, sizes))] == [(960, 1080, 3)] * STEPS


@pytest.mark.parametrize('size', [(640, 480), (360, 199), (1, 1)])
def test_frames_of_another_shape_are_refused_in_one_line(
    made: Path, size: tuple[int, int]
) -> None:
    with pytest.raises(UsageError, match=f'run: camera frames of {size[0]} x {size[1]}; a film'):
        list(film_frames(_filmed(made, [size] * STEPS)))


def _filmed(made: Path, sizes: list[tuple[int, int]]) -> Any:
    """The run with pictures of these widths and heights."""
    run = open_recording(made / 'run')
    frames = [frame._replace(image=cv2.resize(frame.image, size))
              for frame, size in zip(run.frames(), sizes, strict=True)]
    return SimpleNamespace(
        path=run.path, columns=run.columns, facts=run.facts, scenario=run.scenario,
        frames=lambda render: frames,
    )


BAD = {
    'no bag': (['info', 'garbage.mcap'], 2, 'not an MCAP file'),
    'an sqlite bag': (['info', 'sqlite'], 2, 'ros2 bag convert'),
    'empty folder': (['recover', 'empty', '--out', 'NEW/x'], 2, 'contains no .mcap'),
    'recover onto something': (['recover', 'cut', '--out', 'run'], 2, 'already exists'),
    'recover into the bag': (['recover', 'cut', '--out', 'cut/x'], 2, 'is inside the bag'),
    'export of a damaged bag': (
        ['export', 'cut', '--out', 'NEW/x.csv'], 3, 'save the intact part: taxinet bag recover cut',
    ),
    'file that exists': (
        ['export', 'run', '--out', 'garbage.mcap'], 2, 'is the name of a recording',
    ),
    'folder that exists': (['export', 'run', '--out', 'empty'], 2, 'already exists'),
}


@pytest.mark.parametrize('case', BAD)
def test_given_a_mistake_then_one_line_says_what_and_nothing_is_written(
    case: str, bag: Taxinet, tmp_path: Path
) -> None:
    words, expected_code, expected = BAD[case]
    code, out, err = bag(*words)
    assert (code, out) == (expected_code, ''), err
    (line,) = err.strip().splitlines()
    assert line.startswith('taxinet: error: ')
    assert expected in line
    assert list(tmp_path.iterdir()) == []


def test_given_a_full_disk_when_exporting_then_one_line_and_exit_code_four(
    bag: Taxinet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, write: object) -> None:
        def fail(draft: Path) -> None:
            raise OSError(28, 'No space left on device')
        make_atomically(path, fail)

    monkeypatch.setattr('taxinet_ros.files.atomic.make_atomically', full)
    code, out, err = bag('export', 'run', '--out', 'NEW/t.csv')
    assert (code, out) == (4, '')
    assert err == (
        f'taxinet: error: {tmp_path}/t.csv: [Errno 28] No space left on device\n'
    )
    assert list(tmp_path.iterdir()) == []
