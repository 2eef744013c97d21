"""The contact sheet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from taxinet_ros.analysis.camera.sheets import Picture, contact_sheet, grid_sheet


def tile(value: int, height: int = 200, width: int = 360) -> Picture:
    return np.full((height, width, 3), (value, 10, 200), dtype=np.uint8)


def sheet_of(tiles: list[tuple[Picture, str]], columns: int, path: Path) -> Picture:
    contact_sheet(tiles, columns, path)
    return np.asarray(Image.open(path))


def test_given_pictures_when_laid_out_then_each_is_whole_and_in_reading_order(
    tmp_path: Path,
) -> None:
    tiles = [(tile(value), f'#{value}') for value in (50, 60, 70, 80, 90)]
    sheet = sheet_of(tiles, 3, tmp_path / 'sheet.png')
    corners = []
    for value in (50, 60, 70, 80, 90):
        where = np.argwhere((sheet == (value, 10, 200)).all(axis=2))
        assert len(where) == 200 * 360
        corners.append(tuple(where.min(axis=0)))
    assert corners == sorted(corners)
    assert len({row for row, _ in corners}) == 2


def test_given_captions_when_laid_out_then_they_are_drawn_below_and_inside_their_tile(
    tmp_path: Path,
) -> None:
    long = 'ρ = −1.20 m, CTE +5.2 m, HE +23°, 7.5 h, stratus, rain 60 %, seed 7, run 12'
    sheet = sheet_of([(tile(50), long), (tile(60), '')], 2, tmp_path / 'sheet.png')
    ink = np.argwhere(sheet.max(axis=2) < 100)
    below = np.argwhere((sheet == (50, 10, 200)).all(axis=2)).max(axis=0)
    assert len(ink) > 300
    assert ink[:, 0].min() > below[0]
    assert ink[:, 1].max() <= below[1]


def test_given_a_small_picture_when_laid_out_then_it_is_not_stretched(tmp_path: Path) -> None:
    sheet = sheet_of([(tile(50), 'a'), (tile(60, 64, 128), 'b')], 2, tmp_path / 'sheet.png')
    assert (sheet == (60, 10, 200)).all(axis=2).sum() == 64 * 128


def test_given_the_same_tiles_when_laid_out_twice_then_the_bytes_are_the_same(
    tmp_path: Path,
) -> None:
    for name in ('a.png', 'b.png'):
        contact_sheet([(tile(50), 'one'), (tile(60), 'two')], 9, tmp_path / name)
    assert (tmp_path / 'a.png').read_bytes() == (tmp_path / 'b.png').read_bytes()


def test_given_a_title_when_laid_out_then_it_stands_above_the_pictures(
    tmp_path: Path,
) -> None:
    tiles = [(tile(value), '') for value in (50, 60, 70, 80)]
    contact_sheet(tiles, 4, tmp_path / 'sheet.png', title='Pairs')
    sheet = np.asarray(Image.open(tmp_path / 'sheet.png'))
    first = np.argwhere((sheet == (50, 10, 200)).all(axis=2)).min(axis=0)
    ink = np.argwhere(sheet.max(axis=2) < 100)
    assert len(ink) > 50
    assert ink[:, 0].max() < first[0]


def test_given_a_table_when_laid_out_then_headings_stand_left_and_above_of_whole_pictures(
    tmp_path: Path,
) -> None:
    tiles = [[tile(50), tile(60)], [tile(70), tile(80)]]
    grid_sheet(tiles, ['a long heading', 'two\nlines'], ['07:00', '08:00'], tmp_path / 's.png',
               title='Title')  # fmt: skip
    sheet = np.asarray(Image.open(tmp_path / 's.png'))
    corners = {}
    for value in (50, 60, 70, 80):
        where = np.argwhere((sheet == (value, 10, 200)).all(axis=2))
        assert len(where) == 200 * 360
        corners[value] = where.min(axis=0)
    assert corners[50][0] == corners[60][0] < corners[70][0] == corners[80][0]
    assert corners[50][1] == corners[70][1] < corners[60][1] == corners[80][1]
    ink = np.argwhere(sheet.max(axis=2) < 100)
    left, above = ink[:, 1] < corners[50][1], ink[:, 0] < corners[50][0]
    assert (left | above).all()
    assert (left & ~above).sum() > 300
    assert (above & ~left).sum() > 300
