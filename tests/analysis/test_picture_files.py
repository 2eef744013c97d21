"""Pictures of a report as PNG."""

import io
from dataclasses import replace
from itertools import product
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image
from report_examples import picture

from taxinet_ros.analysis.picture_files import DARK, DOTS_PER_INCH, LIGHT, png_bytes, write_png
from taxinet_ros.analysis.report_parts import Theme

THEMES = {'light': LIGHT, 'dark': DARK}


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours (WCAG 2.2, relative luminance)."""
    low, high = sorted(_luminance(colour) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: str) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_given_a_picture_when_drawn_twice_then_the_bytes_are_equal_whatever_the_settings() -> None:
    first = png_bytes(picture(), LIGHT)
    with mpl.rc_context({'axes.facecolor': 'red', 'font.size': 30}):
        assert png_bytes(picture(), LIGHT) == first
    assert png_bytes(picture(), DARK) != first
    with Image.open(io.BytesIO(first)) as image:
        assert image.size == (3 * DOTS_PER_INCH, 1.5 * DOTS_PER_INCH)


@pytest.mark.parametrize('theme', THEMES.values(), ids=THEMES)
def test_given_a_drawing_without_colours_when_drawn_then_it_has_those_of_the_theme(
    theme: Theme,
) -> None:
    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        axes.plot([0, 1])
        axes.set_title('█' * 8)

    with Image.open(io.BytesIO(png_bytes(replace(picture(), draw=draw), theme))) as image:
        colours = {colour for _, colour in image.convert('RGB').getcolors(1 << 20) or []}
    for wanted in (theme.ink, theme.paper, theme.passed):
        assert tuple(round(255 * channel) for channel in to_rgb(wanted)) in colours


@pytest.mark.parametrize('theme', THEMES.values(), ids=THEMES)
def test_given_a_theme_when_on_its_paper_then_words_and_curves_stand_out(theme: Theme) -> None:
    assert contrast(theme.ink, theme.paper) >= 7
    curves = (theme.passed, theme.failed, *theme.others)
    assert min(contrast(colour, paper) for colour, paper in product(curves, [theme.paper])) >= 3


def test_given_a_folder_when_written_then_the_file_is_named_after_the_picture(
    tmp_path: Path,
) -> None:
    path = write_png(picture('rates'), tmp_path, DARK)
    assert path == tmp_path / 'rates.png'
    assert path.read_bytes() == png_bytes(picture(), DARK)
    assert list(tmp_path.iterdir()) == [path]
