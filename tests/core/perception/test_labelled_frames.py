"""Folders of labelled frames from elsewhere."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from taxinet_ros.core.perception.labelled_frames import (
    COLUMNS,
    labelled_frames,
    read_labelled_frames,
)
from taxinet_ros.errors import UsageError

HEADER = ','.join(COLUMNS)


def save(path: Path, size: tuple[int, int] = (200, 360), value: int = 90) -> None:
    picture = np.full((*size, 3), (value, 100, 200), np.uint8)
    assert cv2.imwrite(str(path), picture[:, :, ::-1])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inside = tmp_path / 'frames'
    (inside / 'more').mkdir(parents=True)
    save(inside / 'a.png')
    save(inside / 'more' / 'b.png', (400, 720), 91)
    save(tmp_path / 'outside.png')
    return inside


def write(folder: Path, *lines: str, header: str = HEADER) -> None:
    (folder / 'labels.csv').write_text('\n'.join([header, *lines, '']), encoding='utf-8')


def test_given_labels_when_read_then_units_are_si_and_order_and_signs_are_kept(folder: Path):
    write(folder, 'more/b.png,-2.5,30,52', 'a.png,1,-90,48.5')
    first, second = read_labelled_frames(folder)
    assert (first.image, second.image) == ('more/b.png', 'a.png')
    assert first.truth.cte_m == -2.5
    assert first.truth.he_rad == pytest.approx(math.pi / 6)
    assert second.truth.he_rad == pytest.approx(-math.pi / 2)
    assert (first.distance_m, second.distance_m) == (52.0, 48.5)


def test_given_a_larger_picture_when_loaded_then_it_has_the_cameras_size(folder: Path):
    write(folder, 'more/b.png,0,0,0', 'a.png,0,0,0')
    for frame, red in zip(read_labelled_frames(folder), (91, 90), strict=True):
        picture = frame.picture()
        assert picture.shape == (200, 360, 3)
        assert picture.dtype == np.uint8
        assert (picture == (red, 100, 200)).all()


def test_given_a_spreadsheets_file_when_read_then_mark_spaces_order_and_extras_do_no_harm(
    folder: Path,
):
    lines = ('\ufeffdistance_m, image ,note,heading_error_deg, cte_m', '7, a.png,"x, y",5, 0.5', '')
    (folder / 'labels.csv').write_bytes('\r\n'.join([*lines, '']).encode())
    (frame,) = read_labelled_frames(folder)
    assert (frame.image, frame.distance_m, frame.truth.cte_m) == ('a.png', 7.0, 0.5)


def test_given_rows_of_numbers_when_checked_then_they_are_as_good_as_text(folder: Path):
    row = {'image': 'a.png', 'cte_m': np.float32(0.5), 'heading_error_deg': 9, 'distance_m': 1.0}
    (frame,) = labelled_frames(folder, [(1, row)], 'labels.parquet')
    assert frame.truth.cte_m == 0.5


BAD_LINES = {
    'not a number': ('a.png,left,0,0', "line 2: cte_m is 'left', not a finite number"),
    'nan': ('a.png,0,nan,0', "line 2: heading_error_deg is 'nan', not a finite number"),
    'infinite': ('a.png,0,0,inf', "line 2: distance_m is 'inf', not a finite number"),
    'empty value': ('a.png,,0,0', "line 2: cte_m is '', not a finite number"),
    'absolute heading': ('a.png,0,234,0', 'heading_error_deg is 234, outside -180..180'),
    'short line': ('a.png,0', 'line 2: ends before heading_error_deg; complete'),
    'missing image': ('c.png,0,0,0', "line 2: image 'c.png' is not in"),
    'no image': (',0,0,0', "line 2: image '' is not in"),
    'folder for an image': ('more,0,0,0', "image 'more' is not in"),
    'parent folder': ('../outside.png,0,0,0', "image '../outside.png' lies outside"),
    'absolute path': ('/etc/hostname,0,0,0', "image '/etc/hostname' lies outside"),
    'impossible name': ('a\0.png,0,0,0', 'is not in'),
}


@pytest.mark.parametrize('case', BAD_LINES)
def test_given_a_bad_line_when_read_then_one_line_says_where_and_what(case: str, folder: Path):
    line, expected = BAD_LINES[case]
    write(folder, line)
    with pytest.raises(UsageError) as raised:
        read_labelled_frames(folder)
    assert expected in str(raised.value)
    assert 'labels.csv' in str(raised.value)
    assert '\n' not in str(raised.value)


def test_given_a_link_out_of_the_folder_when_read_then_it_is_refused(folder: Path):
    (folder / 'link.png').symlink_to(folder.parent / 'outside.png')
    write(folder, 'link.png,0,0,0')
    with pytest.raises(UsageError, match='lies outside'):
        read_labelled_frames(folder)


def test_given_no_folder_or_no_labels_when_read_then_it_says_which(folder: Path):
    with pytest.raises(UsageError, match='nowhere: no such folder'):
        read_labelled_frames(folder / 'nowhere')
    with pytest.raises(UsageError, match=r'labels\.csv: no such file; write one with the columns'):
        read_labelled_frames(folder)


@pytest.mark.parametrize('column', COLUMNS)
def test_given_a_missing_column_when_read_then_it_is_named_with_those_there(
    column: str, folder: Path,
):
    write(folder, 'a.png,0,0,0', header=HEADER.replace(column, 'other'))
    with pytest.raises(UsageError, match=f'no column {column}; there are .*other'):
        read_labelled_frames(folder)


@pytest.mark.parametrize(('content', 'expected'), [
    (b'', 'lists no frames'),
    (HEADER.encode(), 'lists no frames'),
    (b'\xff\xfe\x00bad', 'not readable as UTF-8'),
])
def test_given_no_text_or_no_lines_when_read_then_it_is_refused(
    content: bytes, expected: str, folder: Path,
):
    (folder / 'labels.csv').write_bytes(content)
    with pytest.raises(UsageError, match=expected):
        read_labelled_frames(folder)


@pytest.mark.parametrize('damage', ['empty', 'text', 'cut short', 'sixteen bits'])
def test_given_a_bad_picture_when_loaded_then_one_line_names_it_and_nothing_else_is_said(
    damage: str, folder: Path, capfd: pytest.CaptureFixture[str],
):
    path = folder / 'a.png'
    noise = np.random.default_rng(1).integers(0, 256, (200, 360), np.uint8)
    assert cv2.imwrite(str(path), noise)
    content = path.read_bytes()
    path.write_bytes(
        {'empty': b'', 'text': b'hello', 'cut short': content[: len(content) // 2]}.get(
            damage, content
        )
    )
    if damage == 'sixteen bits':
        assert cv2.imwrite(str(path), noise.astype(np.uint16) * 257)
    write(folder, 'a.png,0,0,0')
    (frame,) = read_labelled_frames(folder)
    with pytest.raises(UsageError, match=r'a\.png: (cannot be read as a picture|is 360x200 I;16)'):
        frame.picture()
    assert capfd.readouterr() == ('', '')
