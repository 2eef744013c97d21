"""List of the HTML pages in a campaign's folder, and the tables that notebooks show."""

from __future__ import annotations

import contextlib
import html
import re
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from taxinet_ros.files.atomic import write_atomically

INDEX_NAME = 'index.html'
_TITLE = re.compile('<title>(.*?)</title>', re.DOTALL)
_HEAD = '<!DOCTYPE html><meta charset="utf-8"><meta name="generator" content="taxinet_ros index">'
_HEAD_BYTES = 4096


def write_index(folder: Path) -> None:
    """List the pages in a folder, and in the folders in it, in its ``index.html``.

    Without effect for a single page, and where somebody else's ``index.html`` is; a list is a
    convenience, so a folder that cannot be written stays without.
    """
    index = folder / INDEX_NAME
    pages = sorted({*folder.glob('*.html'), *folder.glob('*/*.html')} - {index})
    if len(pages) < 2:
        return
    with contextlib.suppress(OSError):
        if index.exists() and not _begin(index).startswith(_HEAD):
            return
        title = f'Pages of {html.escape(folder.resolve().name)}'
        items = ''.join(
            f'<li><a href="{quote(str(page.relative_to(folder)))}">{_title(page)}</a></li>\n'
            for page in pages
        )
        write_atomically(
            index, f'{_HEAD}\n<title>{title}</title>\n<h1>{title}</h1>\n<ul>\n{items}</ul>\n'
        )


def html_table(title: str, rows: Mapping[str, object]) -> str:
    """A small table of names and values, of an object that a notebook shows."""
    lines = ''.join(
        f'<tr><th style="text-align:left">{html.escape(name)}</th>'
        f'<td style="text-align:left">{html.escape(str(value))}</td></tr>'
        for name, value in rows.items()
    )
    return f'<table><caption>{html.escape(title)}</caption>{lines}</table>'


def _begin(page: Path) -> str:
    with page.open('rb') as file:
        return file.read(_HEAD_BYTES).decode(errors='replace')


def _title(page: Path) -> str:
    """Title of a page, escaped; its name if it has none."""
    found = _TITLE.search(_begin(page))
    return html.escape(html.unescape(found[1].strip()) if found else page.name)
