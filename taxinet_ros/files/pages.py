"""Links between the HTML pages of one campaign.

A page is made when its command runs, and some pages of the same campaign come later. So each page
has an empty place for links, and the campaign's folder a list of its pages (:data:`PAGES_NAME`).
Whoever writes a page adds it to the list, and fills the places of all pages on it that still exist.
A page that compares campaigns is on the list of each, and has a line of links for each.
Checksums of pages leave that place out: :func:`page_sha256`.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import html
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

from taxinet_ros.files.atomic import write_atomically

PAGES_NAME = 'pages.json'
_SCHEMA = 'taxinet-pages'
PLACE = '<!--pages of this campaign--><!--end of pages-->'
"""Where the links will be; text and data of a page are escaped and cannot contain it."""
_BEGIN, _END = (f'{part}-->'.encode() for part in PLACE.split('-->')[:2])
_FILLED = re.compile(re.escape(_BEGIN) + b'.*?' + re.escape(_END), re.DOTALL)
_LISTS = re.compile('<nav class="pages" data-of="([^"]*)".*?<ul>(.*?)</ul></nav>', re.DOTALL)


def page_sha256(path: Path) -> str:
    """SHA-256 of a file; of a page without its links to others, which come and go.

    Raises:
        OSError: it cannot be read.
    """
    if path.suffix == '.html':
        data = _FILLED.sub(PLACE.encode(), path.read_bytes(), count=1)
        return hashlib.sha256(data).hexdigest()
    with path.open('rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()


def add_page(campaign: Path, page: Path, title: str) -> None:
    """Add a page to those of a campaign, and let all of them link to each other.

    A page is a convenience: a folder or a page that cannot be written stays as it is.

    Args:
        campaign: folder of the campaign; one that is not there, or is no folder, has no list.
        page: HTML page or picture that exists; a picture is linked to, but links to nothing.
        title: display text of links to it, unique for pages that differ.
    """
    if not campaign.is_dir():
        return
    with contextlib.suppress(OSError), _locked(campaign):
        folder = campaign.resolve()
        pages = _read(folder)
        pages[os.path.relpath(page.resolve(), folder)] = title
        there = {
            path: words for path, words in sorted(pages.items(), key=lambda item: item[1])
            if (folder / path).is_file()
        }
        values = {'schema': _SCHEMA, 'pages': [
            {'path': path, 'title': words} for path, words in there.items()
        ]}
        write_atomically(folder / PAGES_NAME, json.dumps(values, indent=2) + '\n')
        for path in there:
            with contextlib.suppress(OSError):
                _fill(folder, folder / path, there)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, since two commands may add a page at once."""
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(number, fcntl.LOCK_EX)
        yield
    finally:
        os.close(number)


def _read(folder: Path) -> dict[str, str]:
    """The titles of the pages by path; none if the list is damaged, since pages come again."""
    try:
        values: Any = json.loads((folder / PAGES_NAME).read_text(encoding='utf-8'))
        found = {one['path']: one['title'] for one in values['pages']}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {
        path: title for path, title in found.items()
        if isinstance(path, str) and isinstance(title, str) and '\0' not in path
    }


def _fill(folder: Path, page: Path, pages: dict[str, str]) -> None:
    """Write the links to all other pages into a page that has a place for them.

    Links of other campaigns stay while these have a list of pages.
    """
    if page.suffix != '.html':
        return
    before = page.read_bytes()
    place = _FILLED.search(before)
    if place is None:
        return
    lists = {
        of: items for of, items in _LISTS.findall(place[0].decode())
        if (page.parent / unquote(of) / PAGES_NAME).is_file()
    }
    ours = _address(folder, page)
    lists[ours] = _items(folder, page, pages)
    if len(pages) < 2:
        del lists[ours]
    links = ''.join(
        f'<nav class="pages" data-of="{of}" aria-label="Pages of {words}">'
        f'<span>{words[0].upper()}{words[1:]}:</span><ul>{items}</ul></nav>'
        for of, items in sorted(lists.items())
        for words in [_campaign_words(of, page, alone=len(lists) == 1)]
    )
    after = _FILLED.sub(lambda _: _BEGIN + links.encode() + _END, before, count=1)
    if after != before:
        write_atomically(page, after)


def _items(folder: Path, page: Path, pages: dict[str, str]) -> str:
    items = []
    for path, title in pages.items():
        words = html.escape(title)
        if (folder / path).resolve() == page.resolve():
            items.append(f'<li><b aria-current="page">{words}</b></li>')
        else:
            items.append(f'<li><a href="{_address(folder / path, page)}">{words}</a></li>')
    return ''.join(items)


def _address(path: Path, page: Path) -> str:
    """Relative address of a file or folder, as a page has it."""
    return quote(f'./{os.path.relpath(path, page.parent)}', safe='/')


def _campaign_words(of: str, page: Path, *, alone: bool) -> str:
    name = (page.parent / unquote(of)).resolve().name
    return 'this campaign' if alone else f'campaign {html.escape(name)}'
