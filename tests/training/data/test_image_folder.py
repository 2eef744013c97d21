from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from training_samples import coloured_frame, foreign_folder

from taxinet_ros.core.perception.eye import find_eye
from taxinet_ros.core.perception.network import INPUT_SHAPE, shrink
from taxinet_ros.core.rig.catalogue import load_camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.training.data.image_folder import load_folders, open_folder


def rewrite(folder: Path, change: Callable[[str], str]) -> None:
    path = folder / 'labels.csv'
    path.write_text(change(path.read_text()))


def as_parquet(folder: Path, **columns: object) -> None:
    table = pd.read_csv(folder / 'labels.csv').assign(**columns)
    (folder / 'labels.csv').unlink()
    table.to_parquet(folder / 'labels.parquet', index=False)


def test_given_a_foreign_folder_when_loaded_then_pictures_and_signs_are_its_own(
    tmp_path: Path,
) -> None:
    folder = foreign_folder(tmp_path / 'field trip', images=4)
    told: list[tuple[str, int, int]] = []
    loaded, sources = load_folders([folder], workers=2, progress=lambda *what: told.append(what))
    assert told == [('images', 1, 4), ('images', 2, 4), ('images', 3, 4), ('images', 4, 4)]
    assert list(loaded.cte_m) == [0, 1, 2, 3]
    assert np.degrees(loaded.he_rad) == pytest.approx([0, -2.5, -5, -7.5])
    assert loaded.pictures.shape == (4, *INPUT_SHAPE)
    for index in range(4):
        assert np.array_equal(loaded.pictures[index], shrink(coloured_frame(index)))
    assert [(source.kind, source.name) for source in sources] == [('folder', 'field trip')]


@pytest.mark.parametrize(('shape', 'suffix'), [
    ((64, 192, 3), 'png'), ((192, 192, 3), 'jpg'), ((400, 720, 3), 'png'), ((480, 640, 3), 'jpg'),
])
def test_given_another_size_when_loaded_then_the_whole_image_is_brought_to_the_frames_shape(
    shape: tuple[int, ...], suffix: str, tmp_path: Path
) -> None:
    folder = foreign_folder(tmp_path / 'f', images=2, shape=shape, suffix=suffix)
    loaded, _ = load_folders([folder], workers=1)
    large = coloured_frame(1, shape)
    seen = shrink(cv2.resize(large, (360, 200), interpolation=cv2.INTER_AREA))
    unlike = np.abs(loaded.pictures[1].astype(int) - seen)
    assert unlike.max() <= (0 if suffix == 'png' else 12)
    assert unlike.mean() <= 1.5


def test_given_the_same_labels_in_another_table_when_loaded_then_the_dataset_is_the_same(
    tmp_path: Path,
) -> None:
    text, table = foreign_folder(tmp_path / 'text'), foreign_folder(tmp_path / 'table')
    as_parquet(table, distance_m=3.0)
    (one, _), (two, _) = load_folders([text], workers=1), load_folders([table], workers=3)
    assert np.array_equal(one.pictures, two.pictures)
    assert (list(one.cte_m), list(one.he_rad)) == (list(two.cte_m), list(two.he_rad))


def test_given_two_folders_when_loaded_then_rows_follow_and_digests_tell_contents_apart(
    tmp_path: Path,
) -> None:
    folders = [foreign_folder(tmp_path / name, images=3) for name in ('a', 'b')]
    both, sources = load_folders(folders, workers=2)
    assert list(both.cte_m) == [0, 1, 2, 0, 1, 2]
    assert sources[0].sha256 == sources[1].sha256
    cv2.imwrite(str(folders[1] / 'photo_1.png'), coloured_frame(9))
    other = load_folders(folders[1:], workers=1)[1][0].sha256
    rewrite(folders[1], lambda text: text.replace('1,', '1.5,'))
    another = load_folders(folders[1:], workers=1)[1][0].sha256
    assert len({sources[0].sha256, other, another}) == 3


def test_given_labels_when_read_then_units_are_si_and_order_and_signs_are_kept(tmp_path: Path):
    folder = foreign_folder(tmp_path / 'f', images=2)
    lines = ('\ufeffdistance_m, image ,note,heading_error_deg, cte_m',
             '7, photo_1.png,"x, y",30, -2.5', '48.5,photo_0.png,,-90,1', '')
    (folder / 'labels.csv').write_bytes('\r\n'.join(lines).encode())  # as a spreadsheet does
    first, second = open_folder(folder).frames
    assert (first.image, second.image) == ('photo_1.png', 'photo_0.png')
    assert (first.truth.cte_m, first.truth.he_rad) == (-2.5, pytest.approx(np.pi / 6))
    assert (second.truth.cte_m, second.truth.he_rad) == (1.0, pytest.approx(-np.pi / 2))
    assert (first.distance_m, second.distance_m) == (7.0, 48.5)


MINE = 'name: mine\noffset_m: [2, 0, 0.5]\nsize_px: [360, 200]\nfield_of_view_deg: {}\n'


def test_given_folders_that_name_their_cameras_when_seen_through_a_view_then_each_has_its_own(
    tmp_path: Path,
) -> None:
    wing = foreign_folder(
        tmp_path / 'wing', images=3, camera='wing', aircraft='caravan', camera_dyaw_deg='2')
    mine = foreign_folder(
        tmp_path / 'mine', images=3, camera='camera.yaml', aircraft='c172p')
    (mine / 'camera.yaml').write_text(MINE.format(70))
    loaded, (_, before) = load_folders([wing, mine], workers=2, view='ahead')
    assert len(loaded) == 6
    for row, (camera, changes) in enumerate(
        [('wing', {'camera_dyaw_rad': math.radians(2)})] * 3
        + [(load_camera(str(mine / 'camera.yaml')), {'aircraft': 'c172p'})] * 3
    ):
        rig = Scenario(camera=camera, **changes).rig
        seen = find_eye('ahead', rig).see(coloured_frame(row % 3))
        np.testing.assert_array_equal(loaded.pictures[row], seen)
    # Another camera of the same name is another folder to a model card; without a view none is
    # looked at.
    plain = load_folders([mine], workers=1)
    (mine / 'camera.yaml').write_text(MINE.format(80))
    other, (after,) = load_folders([mine], workers=1, view='ahead')
    assert after.sha256 != before.sha256
    assert not np.array_equal(other.pictures, loaded.pictures[3:])
    (mine / 'camera.yaml').write_text('a note')
    again = load_folders([mine], workers=1)
    assert again[1] == plain[1]
    assert np.array_equal(again[0].pictures, plain[0].pictures)


@pytest.mark.parametrize(('columns', 'file', 'reason'), [
    ({}, '', 'line 2: names no camera and no aircraft, which networks with a view have to know; '
     'add columns camera and aircraft'),
    ({'camera': 'wing'}, '', 'line 2: names no aircraft, which'),
    ({'camera': '', 'aircraft': 'caravan'}, '', 'line 2: names no camera, which'),
    ({'camera': 'GoPro', 'aircraft': 'caravan'}, '', "line 2: scenario: camera is 'GoPro', not"),
    ({'camera': 'wing', 'aircraft': 'A320'}, '', "line 2: scenario: aircraft is 'A320', not one"),
    ({'camera': 'mine.yaml', 'aircraft': 'caravan'}, '', "line 2: camera 'mine.yaml' is not in"),
    ({'camera': '../mine.yaml', 'aircraft': 'caravan'}, '',
     "line 2: camera '../mine.yaml' lies outside"),
    ({'camera': 'wing', 'aircraft': 'caravan', 'camera_dx_m': 'far'}, '',
     "line 2: camera_dx_m is 'far', not a finite number"),
    ({'camera': 'camera.yaml', 'aircraft': 'caravan'}, MINE.format(200), 'field_of_view_deg'),
    ({'camera': 'camera.yaml', 'aircraft': 'caravan'}, MINE.format(70).replace('0.5', '-3'),
     'line 2: scenario: camera mine on aircraft caravan is'),
    ({'camera': 'camera.yaml', 'aircraft': 'caravan'}, MINE.format(70).replace('360', '640'),
     'row 1: {}: has 360x200 pixels, its camera mine 640x200; name the camera that took it'),
])
def test_given_a_folder_whose_camera_is_not_known_when_seen_through_a_view_then_one_line_says_so(
    columns: dict[str, str], file: str, reason: str, tmp_path: Path
) -> None:
    folder = foreign_folder(tmp_path / 'f', images=2, **columns)
    (tmp_path / 'mine.yaml').write_text(MINE.format(70))
    if file:
        (folder / 'camera.yaml').write_text(file)
    load_folders([folder], workers=1)
    with pytest.raises(UsageError) as caught:
        load_folders([folder], workers=1, view='ahead')
    message = str(caught.value)
    assert message.startswith(str(folder / 'labels.csv'))
    assert reason.format(folder / 'photo_0.png') in message
    assert '\n' not in message


def nan_in_parquet(folder: Path) -> None:
    as_parquet(folder, cte_m=[0.0, 1.0, float('nan')])


def gap_in_parquet(folder: Path) -> None:
    as_parquet(folder, heading_error_deg=pd.array([0.0, None, 1.0], dtype='Float64'))


def cut_in_half(folder: Path) -> None:
    path = folder / 'photo_1.png'
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def wrong_digest(folder: Path) -> None:
    digests = [hashlib.sha256((folder / f'photo_{i}.png').read_bytes()) for i in range(3)]
    as_parquet(folder, sha256=[digest.hexdigest() for digest in digests])
    cv2.imwrite(str(folder / 'photo_2.png'), coloured_frame(7))


def sixteen_bits(folder: Path) -> None:
    cv2.imwrite(str(folder / 'photo_0.png'), coloured_frame(0)[..., 0].astype(np.uint16) * 257)


def link_outside(folder: Path) -> None:
    (folder / 'photo_0.png').unlink()
    (folder / 'photo_0.png').symlink_to(folder.parent / 'other.png')


def with_text(text: str) -> Callable[[Path], object]:
    return lambda folder: rewrite(folder, lambda _: text)


HEAD = 'image,cte_m,heading_error_deg\n'
CASES: dict[str, tuple[Callable[[Path], object], str, str]] = {
    'no table': (lambda f: (f / 'labels.csv').unlink(), '', 'contains neither labels.parquet nor'),
    'two tables': (
        lambda f: (f / 'labels.parquet').write_bytes(b''), '', 'keep only one of them',
    ),
    'no row': (with_text(HEAD), 'labels.csv', 'lists no frames'),
    'empty file': (with_text(''), 'labels.csv', 'lists no frames'),
    'line cut short': (with_text(f'{HEAD}photo_0.png,1\n'), 'line 2', 'complete the line'),
    'no number': (with_text(f'{HEAD}photo_0.png,left,1\n'), 'line 2', "'left'"),
    'not a number in Parquet': (nan_in_parquet, 'line 3', 'not a finite number'),
    'gap in Parquet': (gap_in_parquet, 'line 2', 'not a finite number'),
    'Parquet damaged': (
        lambda f: (f / 'labels.csv').rename(f / 'labels.parquet'), 'labels.parquet', 'cannot be',
    ),
    'no text': (lambda f: (f / 'labels.csv').write_bytes(b'\xff\xfe\0'), 'labels.csv', 'cannot be'),
    'image missing': (lambda f: (f / 'photo_1.png').unlink(), 'line 3', 'photo_1.png'),
    'image damaged': (cut_in_half, 'row 2', 'cannot be read as a picture'),
    'image a text': (
        lambda f: (f / 'photo_2.png').write_text('hello'), 'row 3', 'cannot be read as a picture',
    ),
    'image too small': (
        lambda f: cv2.imwrite(str(f / 'photo_0.png'), coloured_frame(0, (60, 200, 3))),
        'row 1', '200x60 pixels, fewer than the 192x64',
    ),
    'image twice': (
        with_text(f'{HEAD}photo_0.png,1,1\nphoto_1.png,1,1\n./photo_0.png,1,1\n'),
        'line 4', 'already in line 2',
    ),
    'image outside': (with_text(f'{HEAD}../other.png,1,1\n'), 'line 2', 'outside'),
    'image at an absolute path': (with_text(f'{HEAD}/etc/hostname,1,1\n'), 'line 2', 'outside'),
    'image behind a link': (link_outside, 'line 2', 'outside'),
    'impossible name': (with_text(f'{HEAD}a\0.png,1,1\n'), 'line 2', 'is not in'),
    'no name': (with_text(f'{HEAD},1,1\n'), 'line 2', "image '' is not in"),
    'a folder': (with_text(f'{HEAD}.,1,1\n'), 'line 2', "image '.' is not in"),
    'infinite': (with_text(f'{HEAD}photo_0.png,1,inf\n'), 'line 2', 'not a finite number'),
    'empty value': (with_text(f'{HEAD}photo_0.png,,1\n'), 'line 2', "cte_m is '', not a finite"),
    'absolute heading': (with_text(f'{HEAD}photo_0.png,1,234\n'), 'line 2', 'outside -180..180'),
    'other columns': (
        with_text('image,cte,heading_error_deg\nphoto_0.png,1,1\n'), 'line 2',
        'no column cte_m; there are image, cte',
    ),
    'sixteen bits': (sixteen_bits, 'row 1', 'is 360x200'),
    'image empty': (
        lambda f: (f / 'photo_0.png').write_bytes(b''), 'row 1', 'cannot be read as a picture',
    ),
    'image changed': (wrong_digest, 'row 3', 'SHA-256'),
    'not finished': (lambda f: (f / 'progress.db').write_text('{}'), '', 'taxinet dataset'),
    'facts damaged': (
        lambda f: (f / 'dataset.json').write_text('[]'), 'dataset.json', 'taxinet doctor',
    ),
    'table changed': (
        lambda f: write_sealed(f / 'dataset.json', {'labels_sha256': '0'}), 'labels.csv',
        'is not the table',
    ),
}  # fmt: skip


@pytest.mark.parametrize('case', CASES)
def test_given_a_bad_folder_when_loaded_then_one_line_says_what_where_and_how_to_fix_it(
    case: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = foreign_folder(tmp_path / 'f', images=3)
    cv2.imwrite(str(tmp_path / 'other.png'), coloured_frame(1))
    load_folders([folder], workers=1)
    break_it, where, reason = CASES[case]
    break_it(folder)
    with pytest.raises(UsageError) as caught:
        load_folders([folder], workers=2)
    message = str(caught.value)
    assert message.startswith(str(folder))
    assert where in message
    assert reason in message
    assert '\n' not in message
    assert capfd.readouterr() == ('', '')


def test_given_no_folder_when_opened_then_one_line_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match='no such folder'):
        open_folder(tmp_path / 'none')
