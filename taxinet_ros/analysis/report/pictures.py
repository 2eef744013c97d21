"""Pictures of a report as PNG and embedded in its page, for light and dark themes.

The same picture and theme give the same bytes each time they are drawn.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from matplotlib.style import context as style_context
from PIL import Image

from taxinet_ros.analysis.report.parts import Picture, Report, Theme
from taxinet_ros.files.atomic import write_atomically

# Okabe-Ito blue and vermilion, as in the other pictures; on dark pages lighter shades of these
# hues, since each needs a contrast of 3 : 1 with the background (WCAG 2.2, 1.4.11).
LIGHT = Theme(
    ink='#1f2328', faint='#d5d9de', paper='#ffffff', passed='#0072B2', failed='#D55E00',
    others=('#007a5a', '#7A4D9E', '#8a6d00', '#b0487a'),
)
DARK = Theme(
    ink='#e6e8eb', faint='#3d444d', paper='#16191d', passed='#56B4E9', failed='#F28C38',
    others=('#3fc79a', '#b794e0', '#F0E442', '#e58fb6'),
)
DOTS_PER_INCH = 144
"""Resolution of all pictures: sharp on screens with two dots per CSS pixel, but small."""


def png_bytes(picture: Picture, theme: Theme) -> bytes:
    """Draw a picture as PNG; the same picture and theme give the same bytes.

    ``picture.draw`` receives a figure with a constrained layout and the theme's colours as defaults
    of text, axes, ticks, grid, legend and background, independent of any ``matplotlibrc``.
    """
    buffer = io.BytesIO()
    # Ticks and legends created during saving take their colours then.
    with style_context(['default', _defaults(theme)]):
        figure = Figure(
            figsize=picture.size_in, dpi=DOTS_PER_INCH, layout='constrained',
            facecolor=theme.paper,
        )
        picture.draw(figure, theme)
        figure.savefig(buffer, format='png', metadata={'Software': None})
    return buffer.getvalue()


def write_png(picture: Picture, folder: Path, theme: Theme) -> Path:
    """Write ``<name>.png`` into an existing folder and return its path.

    Raises:
        OSError: it cannot be written.
    """
    path = folder / f'{picture.name}.png'
    data = png_bytes(picture, theme)
    write_atomically(path, data)
    return path


def _defaults(theme: Theme) -> dict[str, Any]:
    ink = ('text.color', 'axes.labelcolor', 'axes.titlecolor', 'axes.edgecolor', 'xtick.color',
           'ytick.color', 'lines.color', 'patch.edgecolor', 'hatch.color')
    paper = ('figure.facecolor', 'axes.facecolor', 'savefig.facecolor', 'legend.facecolor')
    cycle = (theme.passed, theme.failed, *theme.others)
    return {
        **dict.fromkeys(ink, theme.ink), **dict.fromkeys(paper, theme.paper),
        'grid.color': theme.faint, 'legend.edgecolor': theme.faint,
        'axes.prop_cycle': cycler(color=cycle),
    }


def write_pictures(
    report: Report, folder: Path, on_progress: Callable[[str], None] = lambda _: None
) -> list[Path]:
    """Write all pictures of a report for light pages, as :func:`write_png` does."""
    written = []
    for picture in (one for section in report.sections for one in section.pictures):
        on_progress(f'picture {picture.name}')
        written.append(write_png(picture, folder, LIGHT))
    return written


_CSS_PIXELS_PER_INCH = 96


def view_picture(picture: Picture, light: bytes | None = None) -> dict[str, Any]:
    """What the template takes of a picture: ``data:`` addresses of both themes, size [CSS px].

    Args:
        picture: the picture.
        light: it as PNG for light pages, if it has been drawn.
    """
    width, height = (round(inches * _CSS_PIXELS_PER_INCH) for inches in picture.size_in)
    return {
        'name': picture.name, 'title': picture.title, 'caption': picture.caption,
        'light': _address(light or png_bytes(picture, LIGHT)),
        'dark': _address(png_bytes(picture, DARK)), 'width': width, 'height': height,
    }


def data_address(data: bytes) -> str:
    """The ``data:`` address of a WebP file."""
    return 'data:image/webp;base64,' + base64.b64encode(data).decode('ascii')


def _address(png: bytes) -> str:
    """Lossless WebP: a third of the PNG's size."""
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(png)) as image:
        image.convert('RGB').save(buffer, format='webp', lossless=True, quality=60, method=4)
    return data_address(buffer.getvalue())
