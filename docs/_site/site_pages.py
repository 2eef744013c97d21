"""Sphinx extension: text that is made when the site is built, and links out of ``docs/``.

A page says ``<!-- generated: NAME -->`` where a function of :mod:`generated` is to write, and
``<!-- file: PATH -->`` where a file of the repository is to stand. Links between files, as the
plain repository has them, become links between the pages of the site.
"""

from __future__ import annotations

import os.path
import re
from pathlib import Path
from typing import Any

import generated
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / 'docs'
PLACEHOLDER = re.compile(r'<!-- (generated|file): (\S+) -->')
LINK = re.compile(r'(?<=\]\()(?!\w+:|#)([^)\s#]+)(#[^)\s]*)?(?=\))')
CODE = re.compile(r'(```.*?```|`[^`\n]*`)', re.DOTALL)
PAGES = {
    'README.md': 'index.md',
    'ARCHITECTURE.md': 'project/architecture.md',
    'CONTRIBUTING.md': 'project/contributing.md',
    'SECURITY.md': 'project/security.md',
    'CHANGELOG.rst': 'project/changelog.rst',
    'benchmarks/RESULTS.md': 'project/measurements.md',
}
"""Files outside ``docs/`` that are pages of the site too."""


def linked(text: str, folder: Path) -> str:
    """A page's text, with links of a file in ``folder`` as the site wants them."""
    def replaced(link: re.Match[str]) -> str:
        return _target((folder / link[1]).resolve(), link[2] or '') or link[0]

    parts = CODE.split(text)
    return ''.join(part if part.startswith('`') else LINK.sub(replaced, part) for part in parts)


def _target(file: Path, anchor: str) -> str:
    """Address of a file in the site, from its root; '' where it has none."""
    name = os.path.relpath(file, ROOT)
    if name in PAGES:
        return f'/{PAGES[name]}{anchor}'
    if file.is_relative_to(DOCS):
        return f'/{file.relative_to(DOCS)}{anchor}'
    if name.startswith('examples'):
        inside = name.removeprefix('examples').lstrip('/')
        return f'/examples.md{generated.example_anchor(inside) if inside else ""}'
    return ''


def fill(app: Sphinx, page: str, source: list[str]) -> None:
    """Complete a page's text before it is parsed.

    Raises:
        ExtensionError: a placeholder names nothing.
    """
    del app
    home = (DOCS / page).parent

    def made(mark: re.Match[str]) -> str:
        kind, name = mark.groups()
        if kind == 'generated':
            if name not in generated.PAGES:
                raise ExtensionError(f'{page}: nothing generates {name!r}')
            return generated.PAGES[name]()
        file = ROOT / name
        return linked(file.read_text(encoding='utf-8'), file.parent)

    if page.startswith('project/changelog'):
        return
    source[0] = PLACEHOLDER.sub(made, linked(source[0], home))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect('source-read', fill)
    return {'version': '1', 'parallel_read_safe': True, 'parallel_write_safe': True}
