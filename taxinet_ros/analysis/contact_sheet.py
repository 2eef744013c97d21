"""Many camera pictures on one sheet, each with a caption, to be looked at by a person."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Picture = NDArray[np.uint8]

_GAP_PX = 6
_PAPER = (255, 255, 255)
_INK = (20, 20, 20)
_FONT_SHARE = 22
"""A tile is as wide as so many times the caption's letters are high: readable in a report."""


def contact_sheet(tiles: Sequence[tuple[Picture, str]], columns: int, path: Path) -> None:
    """Lay out pictures row by row, each with its caption below.

    The same tiles give the same bytes. Every tile gets the size of the largest picture; a smaller
    one is centred in it, not stretched. A caption wraps at spaces and keeps its line breaks.

    Args:
        tiles: pictures ((H, W, 3) uint8, RGB) and their captions.
        columns: pictures in a row.
        path: PNG file to write.

    Raises:
        ValueError: no tiles, no columns, or a picture that is not (H, W, 3) uint8.
    """
    if not tiles or columns < 1:
        raise ValueError(f'{len(tiles)} tiles in {columns} columns make no sheet')
    for image, caption in tiles:
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise ValueError(f'tile {caption!r}: {image.shape} {image.dtype}, not (H, W, 3) uint8')
    columns = min(columns, len(tiles))
    height = max(image.shape[0] for image, _ in tiles)
    width = max(image.shape[1] for image, _ in tiles)
    captions = [_wrap(caption, width) for _, caption in tiles]
    strip = _line_height(width) * max(caption.count('\n') + 1 for caption in captions) + _GAP_PX
    rows = -(-len(tiles) // columns)
    cell = (width + _GAP_PX, height + strip + _GAP_PX)
    sheet = Image.new('RGB', (columns * cell[0] + _GAP_PX, rows * cell[1] + _GAP_PX), _PAPER)
    draw = ImageDraw.Draw(sheet)
    for number, ((image, _), caption) in enumerate(zip(tiles, captions, strict=True)):
        row, column = divmod(number, columns)
        left, top = _GAP_PX + column * cell[0], _GAP_PX + row * cell[1]
        at = (left + (width - image.shape[1]) // 2, top + (height - image.shape[0]) // 2)
        sheet.paste(Image.fromarray(image), at)
        draw.text(
            (left + 2, top + height + 2), caption, fill=_INK, font=_font(width),
            spacing=_line_height(width) - _font_px(width),
        )
    sheet.save(path, format='PNG')


def _font_px(width: int) -> int:
    return max(width // _FONT_SHARE, 10)


def _line_height(width: int) -> int:
    return round(_font_px(width) * 1.25)


@cache
def _font(width: int) -> ImageFont.FreeTypeFont:
    # matplotlib brings DejaVu Sans along: the same letters on every machine, degrees included.
    file = Path(matplotlib.get_data_path(), 'fonts', 'ttf', 'DejaVuSans.ttf')
    return ImageFont.truetype(file, _font_px(width))


def _wrap(caption: str, width: int) -> str:
    return '\n'.join(line for part in caption.split('\n') for line in _wrap_line(part, width))


def _wrap_line(text: str, width: int) -> list[str]:
    lines: list[str] = []
    for word in text.split(' '):
        longer = f'{lines[-1]} {word}' if lines else word
        if lines and _font(width).getlength(longer) <= width - 4:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines
