"""The contact sheet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taxinet_ros.analysis.contact_sheet import Picture, contact_sheet


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


@pytest.mark.parametrize(('tiles', 'columns', 'message'), [
    ([], 2, '0 tiles'),
    ([(tile(50), 'x')], 0, '0 columns'),
    ([(np.zeros((4, 4), np.uint8), 'grey')], 1, "tile 'grey'"),
    ([(np.zeros((4, 4, 3)), 'float')], 1, 'float64'),
])
def test_given_no_pictures_when_laid_out_then_it_is_refused(
    tiles: list[tuple[Picture, str]], columns: int, message: str, tmp_path: Path,
) -> None:
    with pytest.raises(ValueError, match=message):
        contact_sheet(tiles, columns, tmp_path / 'sheet.png')
