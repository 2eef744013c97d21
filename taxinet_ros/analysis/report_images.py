"""Pictures of a report inside its page, for light and dark, as data addresses."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass

from PIL import Image

from taxinet_ros.analysis.picture_files import DARK, LIGHT, png_bytes
from taxinet_ros.analysis.report_parts import Picture, Theme

_CSS_PIXELS_PER_INCH = 96


@dataclass(frozen=True, kw_only=True, slots=True)
class PictureView:
    """A picture, ready for the template.

    Attributes:
        name, title, caption: as in the report.
        light, dark: addresses that hold the whole file.
        width, height: size on the page [CSS px].
    """

    name: str
    title: str
    caption: str
    light: str
    dark: str
    width: int
    height: int


def view_picture(picture: Picture) -> PictureView:
    """Draw a picture for light and for dark pages."""
    width, height = (round(inches * _CSS_PIXELS_PER_INCH) for inches in picture.size_in)
    return PictureView(
        name=picture.name, title=picture.title, caption=picture.caption,
        light=_address(picture, LIGHT), dark=_address(picture, DARK), width=width, height=height,
    )


def data_address(data: bytes) -> str:
    """The ``data:`` address of a WebP file."""
    return 'data:image/webp;base64,' + base64.b64encode(data).decode('ascii')


def _address(picture: Picture, theme: Theme) -> str:
    """Lossless WebP: a third of the PNG's size."""
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(png_bytes(picture, theme))) as image:
        image.convert('RGB').save(buffer, format='webp', lossless=True, quality=60, method=4)
    return data_address(buffer.getvalue())
