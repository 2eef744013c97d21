"""Pictures of a report as PNG, for light and dark pages: equal bytes each time they are drawn."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from matplotlib.style import context as style_context

from taxinet_ros.analysis.report_parts import Picture, Theme
from taxinet_ros.bag.layout import write_whole

# Blue and vermilion are Okabe and Ito's, as in the other pictures; on a dark ground lighter ones
# of the same hues, for each must stand out from the paper by 3 : 1 (WCAG 2.2, 1.4.11).
LIGHT = Theme(
    ink='#1f2328', faint='#d5d9de', paper='#ffffff', passed='#0072B2', failed='#D55E00',
    others=('#007a5a', '#7A4D9E', '#8a6d00', '#b0487a'),
)
DARK = Theme(
    ink='#e6e8eb', faint='#3d444d', paper='#16191d', passed='#56B4E9', failed='#F28C38',
    others=('#3fc79a', '#b794e0', '#F0E442', '#e58fb6'),
)

DOTS_PER_INCH = 144
"""Of all pictures: sharp on a screen with two dots to a CSS pixel, and small."""


def png_bytes(picture: Picture, theme: Theme) -> bytes:
    """Draw a picture as PNG; the same picture and theme give the same bytes.

    The figure comes to ``picture.draw`` with a constrained layout and with the theme's colours as
    defaults of text, axes, ticks, grid, legend and ground, whatever a ``matplotlibrc`` says.
    """
    buffer = io.BytesIO()
    # Ticks and legends that are made only while it is saved take their colours then.
    with style_context(['default', _defaults(theme)]):
        figure = Figure(
            figsize=picture.size_in, dpi=DOTS_PER_INCH, layout='constrained',
            facecolor=theme.paper,
        )
        FigureCanvasAgg(figure)
        picture.draw(figure, theme)
        figure.savefig(buffer, format='png', metadata={'Software': None})
    return buffer.getvalue()


def write_png(picture: Picture, folder: Path, theme: Theme) -> Path:
    """Write ``<name>.png`` into an existing folder and return its path.

    Raises:
        BagWriteError: it cannot be written.
    """
    path = folder / f'{picture.name}.png'
    data = png_bytes(picture, theme)
    write_whole(path, lambda draft: draft.write_bytes(data))
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
