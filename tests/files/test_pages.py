"""The list of the pages in a campaign's folder."""

from __future__ import annotations

import re
from pathlib import Path

from taxinet_ros.files.pages import INDEX_NAME, write_index


def page(path: Path, title: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<!DOCTYPE html><title>{title}</title><p>x</p>', encoding='utf-8')
    return path


def links(folder: Path) -> dict[str, str]:
    text = (folder / INDEX_NAME).read_text(encoding='utf-8')
    return dict(re.findall('<a href="([^"]*)">(.*)</a>', text))


def test_given_pages_in_a_folder_and_below_when_listed_then_each_is_named_by_its_title(
    tmp_path: Path,
) -> None:
    page(tmp_path / 'analysis' / 'report.html', 'Runs of a &amp; b')
    write_index(tmp_path)
    assert not (tmp_path / INDEX_NAME).exists(), 'one page needs no list'
    why = page(tmp_path / 'why it' / 'why.html', '<script>x()</script>')
    (tmp_path / 'shrink.html').write_bytes(b'\xff')
    for _ in range(2):
        write_index(tmp_path)
        assert links(tmp_path) == {
            'analysis/report.html': 'Runs of a &amp; b', 'shrink.html': 'shrink.html',
            'why%20it/why.html': '&lt;script&gt;x()&lt;/script&gt;',
        }
    why.unlink()
    write_index(tmp_path)
    assert len(links(tmp_path)) == 2


def test_given_an_index_of_somebody_else_then_it_stays(tmp_path: Path) -> None:
    index = page(tmp_path / INDEX_NAME, 'mine')
    for name in 'ab':
        page(tmp_path / f'{name}.html', name)
    before = index.read_bytes()
    write_index(tmp_path)
    assert index.read_bytes() == before
