"""Contact sheets: camera pictures with captions, and scenes by hour and weather."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.core.renderer import OURS, find_renderer
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import along_words, clock_words

Picture = NDArray[np.uint8]
_GAP_PX = 6
_PAPER = (255, 255, 255)
_INK = (20, 20, 20)
_FONT_SHARE = 22
"""Tile width over the height of caption letters, chosen to be readable in a report."""
_HEADING_SHARE = 85
"""The same for the headings of a whole table of pictures."""


def contact_sheet(
    tiles: Sequence[tuple[Picture, str]], columns: int, path: Path,
    *, title: str = '',
) -> None:
    """Arrange pictures row by row, each with its caption below.

    The same tiles give the same bytes. Every tile gets the size of the largest picture; a smaller
    one is centred in it, not stretched. A caption wraps at spaces and keeps its line breaks.

    Args:
        tiles: pictures ((H, W, 3) uint8, RGB) and their captions.
        columns: number of pictures in a row.
        path: PNG file to write.
        title: title line.

    Raises:
        ValueError: there are no tiles or columns, or a picture is not (H, W, 3) uint8.
    """
    if not tiles or columns < 1:
        raise ValueError(f'{len(tiles)} tiles in {columns} columns make no sheet')
    _check(tiles)
    columns = min(columns, len(tiles))
    height, width = _largest(tiles)
    captions = [_wrap(caption, width) for _, caption in tiles]
    strip = _line_height(width) * max(caption.count('\n') + 1 for caption in captions) + _GAP_PX
    rows = -(-len(tiles) // columns)
    head = _title_height(_title_px(width)) if title else 0
    pitch = height + strip + _GAP_PX
    size = (_GAP_PX + columns * (width + _GAP_PX), head + rows * pitch + _GAP_PX)
    sheet = Image.new('RGB', size, _PAPER)
    draw = ImageDraw.Draw(sheet)
    _draw_title(draw, title, _title_px(width))
    for number, ((image, _), caption) in enumerate(zip(tiles, captions, strict=True)):
        row, column = divmod(number, columns)
        left, top = _GAP_PX + column * (width + _GAP_PX), head + _GAP_PX + row * pitch
        _paste(sheet, image, (left, top), (height, width))
        draw.text(
            (left + 2, top + height + 2), caption, fill=_INK, font=_font(_font_px(width)),
            spacing=_line_height(width) - _font_px(width),
        )
    sheet.save(path, format='PNG')


def grid_sheet(
    tiles: Sequence[Sequence[Picture]], rows: Sequence[str], columns: Sequence[str], path: Path,
    *, title: str,
) -> None:
    """Arrange pictures as a table with a heading for every row and every column.

    Args:
        tiles: one sequence of pictures ((H, W, 3) uint8, RGB) per row.
        rows: row headings; they keep their line breaks.
        columns: column headings.
        path: PNG file to write.
        title: title line.

    Raises:
        ValueError: there are no tiles, headings do not match them, or a picture has another shape.
    """
    if not rows or not columns or [len(row) for row in tiles] != [len(columns)] * len(rows):
        raise ValueError(f'{len(rows)} rows and {len(columns)} columns of headings fit no tiles')
    flat = [
        (image, f'{row}, {column}')
        for row, images in zip(rows, tiles, strict=True)
        for column, image in zip(columns, images, strict=True)
    ]
    _check(flat)
    height, width = _largest(flat)
    # A sheet is viewed as a whole, so its headings scale with it, not with its pictures.
    px = max(_title_px(width), len(columns) * width // _HEADING_SHARE)
    font = _font(px)
    draw = ImageDraw.Draw(Image.new('RGB', (1, 1)))
    margin = round(max(draw.multiline_textbbox((0, 0), row, font)[2] for row in rows)) + 4 * _GAP_PX
    top0 = _title_height(px) + round(1.3 * px) + _GAP_PX
    size = (
        margin + len(columns) * (width + _GAP_PX), top0 + len(rows) * (height + _GAP_PX),
    )
    sheet = Image.new('RGB', size, _PAPER)
    draw = ImageDraw.Draw(sheet)
    _draw_title(draw, title, px)
    for column, text in enumerate(columns):
        middle = margin + column * (width + _GAP_PX) + width // 2
        draw.text((middle, top0 - _GAP_PX), text, fill=_INK, font=font, anchor='md')
    for row, text in enumerate(rows):
        top = top0 + row * (height + _GAP_PX)
        draw.multiline_text(
            (margin - 2 * _GAP_PX, top + height // 2), text, _INK, font, 'rm', align='right',
        )
        for column, image in enumerate(tiles[row]):
            _paste(sheet, image, (margin + column * (width + _GAP_PX), top), (height, width))
    sheet.save(path, format='PNG')


def _check(tiles: Sequence[tuple[Picture, str]]) -> None:
    for image, caption in tiles:
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise ValueError(f'tile {caption!r}: {image.shape} {image.dtype}, not (H, W, 3) uint8')


def _largest(tiles: Sequence[tuple[Picture, str]]) -> tuple[int, int]:
    return max(i.shape[0] for i, _ in tiles), max(i.shape[1] for i, _ in tiles)


def _paste(
    sheet: Image.Image, image: Picture, corner: tuple[int, int], size: tuple[int, int]
) -> None:
    """Centre a picture in a cell of ``size`` (height, width)."""
    left, top = corner
    at = (left + (size[1] - image.shape[1]) // 2, top + (size[0] - image.shape[0]) // 2)
    sheet.paste(Image.fromarray(image), at)


def _draw_title(draw: ImageDraw.ImageDraw, title: str, px: int) -> None:
    draw.text((_GAP_PX + 2, 2 * _GAP_PX), title, fill=_INK, font=_font(px))


def _title_px(width: int) -> int:
    return round(1.4 * _font_px(width))


def _title_height(px: int) -> int:
    return round(1.3 * px) + 3 * _GAP_PX


def _font_px(width: int) -> int:
    return max(width // _FONT_SHARE, 10)


def _line_height(width: int) -> int:
    return round(_font_px(width) * 1.25)


@cache
def _font(px: int) -> ImageFont.FreeTypeFont:
    # matplotlib ships DejaVu Sans: the same glyphs on every machine, including the degree sign.
    file = Path(matplotlib.get_data_path(), 'fonts', 'ttf', 'DejaVuSans.ttf')
    return ImageFont.truetype(file, px)


def _wrap(caption: str, width: int) -> str:
    return '\n'.join(line for part in caption.split('\n') for line in _wrap_line(part, width))


def _wrap_line(text: str, width: int) -> list[str]:
    lines: list[str] = []
    for word in text.split(' '):
        longer = f'{lines[-1]} {word}' if lines else word
        if lines and _font(_font_px(width)).getlength(longer) <= width - 4:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


HOURS = (6.0, 6.5, 7.0, 9.0, 12.0, 14.0, 15.5, 17.0, 17.5)
"""Default local hours of a sheet, more closely spaced at dawn and dusk."""
POSE = {'cross_track_m': 1.0, 'heading_deg': 4.0, 'distance_m': 900.0}
"""Default pose of a sheet: it shows the centreline, both edges and our shadow after noon."""


def scene_picture(scene: Scenario, camera: str = OURS) -> Picture:
    """The first camera frame of a run of ``scene``, (200, 360, 3) uint8 RGB.

    Args:
        scene: the scene.
        camera: who takes the picture (:mod:`taxinet_ros.core.renderer`).

    Raises:
        UsageError: the camera is unknown, or cannot show the scene.
        InfraError: it failed.
    """
    state, renderer = Aircraft(scene).state, find_renderer(camera)
    if renderer is None:
        return Camera(scene).render(state, 0)
    with contextlib.closing(renderer.make(scene)) as theirs:
        return theirs.render(state, 0)


def sheet_scenes(
    settings: Mapping[str, object], hours: Sequence[float], clouds: Sequence[str],
    rains: Sequence[float],
) -> list[list[Scenario]]:
    """Scenes of one pose: one row per weather with one scene per hour.

    Args:
        settings: scenario values shared by all, in human keys and units; the default pose is
            :data:`POSE`.
        hours: local hours.
        clouds: cloud kinds.
        rains: rain [%]; one row for each under each kind of cloud.

    Raises:
        UsageError: a value that no scenario may have.
    """
    return [
        [
            scenario_from_human(
                {**POSE, **settings, 'time_of_day_h': hour, 'clouds': cloud, 'rain_percent': rain}
            )
            for hour in hours
        ]
        for cloud in clouds
        for rain in rains
    ]


def camera_sheet(
    scenes: Sequence[Sequence[Scenario]], path: Path, camera: str = OURS
) -> None:
    """Draw the scenes of :func:`sheet_scenes` as a table of pictures, into a PNG file."""
    first = scenes[0][0]
    grid_sheet(
        [[scene_picture(scene, camera) for scene in row] for row in scenes],
        [_weather(row[0]) for row in scenes],
        [clock_words(scene.time_of_day_s / 3600) for scene in scenes[0]],
        path, title=f'{find_place(first.place).title}, {first.date}, {pose_words(first)}',
    )


def _weather(scene: Scenario) -> str:
    rain = f'\nrain {100 * scene.rain_fraction:.0f} %' if scene.rain_fraction else ''
    return f'{scene.clouds}{rain}'


def pose_words(scene: Scenario) -> str:
    """The start pose of a scene in display units."""
    human = scene.to_human()
    return (
        f'{human["distance_m"]:.0f} m {along_words(scene.track)}, '
        f'CTE {human["cross_track_m"]:+.1f} m, heading {human["heading_deg"]:+.0f}°'
    )
