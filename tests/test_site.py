"""The site: it builds without a warning, its links lead somewhere, and its examples hold."""

from __future__ import annotations

import doctest
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

import taxinet_ros as tx

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'


class Page(HTMLParser):
    """Links and anchors of an HTML page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.links += [given[name] for name in ('href', 'src') if given.get(name)]
        self.anchors |= {given[name] for name in ('id', 'name') if given.get(name)}


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    """Every page of the built site, by its path."""
    pytest.importorskip('furo', reason='the extra docs is not installed')
    out = tmp_path_factory.mktemp('site')
    built = subprocess.run(
        [sys.executable, '-m', 'sphinx', '-q', '-W', '--keep-going', '-b', 'html',
         '-d', str(out / 'trees'), str(DOCS), str(out / 'html')],
        capture_output=True, text=True, check=False,
    )
    assert built.returncode == 0, built.stderr
    assert built.stderr == ''
    return {
        path: Page(path.read_text(encoding='utf-8')) for path in (out / 'html').rglob('*.html')
    }


def test_given_the_site_then_every_link_within_it_leads_to_a_file_and_an_anchor(site):
    lost = []
    for path, page in site.items():
        for link in page.links:
            if re.match(r'\w+:', link):
                continue
            name, _, anchor = unquote(link).partition('#')
            target = (path.parent / name.partition('?')[0]).resolve() if name else path
            there = target.is_file() and (
                not anchor or target not in site or anchor in site[target].anchors
            )
            if not there:
                lost.append(f'{path.name}: {link}')
    assert len(site) > 40
    assert lost == []


def test_given_the_site_then_every_page_of_the_docs_is_in_it_and_in_its_menu(site):
    names = {page.relative_to(DOCS).with_suffix('.html').as_posix() for page in DOCS.rglob('*.md')}
    home = next(path for path in site if path.name == 'index.html' and path.parent.name == 'html')
    menu = {
        (home.parent / link.partition('#')[0]).resolve().relative_to(home.parent).as_posix()
        for link in site[home].links if not re.match(r'\w+:', link)
    }
    assert names - menu == {'index.html'} - menu


def test_given_the_reference_then_it_has_every_command_key_column_and_kind(site):
    sys.path.insert(0, str(DOCS / '_site'))
    try:
        import generated
    finally:
        sys.path.remove(str(DOCS / '_site'))
    commands = re.findall(r'^#+ taxinet ([\w -]+)$', generated.commands(), re.MULTILINE)
    assert {'run', 'falsify', 'bag export', 'odd', 'node'} <= set(commands)
    for what in (generated.columns(), generated.scenario_keys(), generated.infra_kinds()):
        rows = [line for line in what.splitlines() if line.startswith('| `')]
        assert len(rows) > 9
        assert not [row for row in rows if row.endswith('|  |')], 'a row says nothing'
    (cli,) = (page for path, page in site.items() if path.name == 'cli.html')
    assert {f'taxinet-{command.replace(" ", "-")}' for command in commands} <= cli.anchors


def test_given_the_gallery_then_each_film_has_the_command_that_made_it():
    page = (DOCS / 'gallery.md').read_text(encoding='utf-8')
    shown = re.findall(r'\(gallery/(\w+)\.webp\)', page)
    assert sorted(shown) == sorted(film.stem for film in (DOCS / 'gallery').iterdir())
    assert len(re.findall(r'^```sh\ntaxinet run ', page, re.MULTILINE)) == len(shown) >= 5


@pytest.mark.parametrize(
    'page', [page for page in sorted(DOCS.rglob('*.md')) if '>>> ' in page.read_text()],
    ids=lambda page: page.stem,
)
def test_given_a_page_with_a_session_of_python_then_it_answers_as_shown(page):
    failed, tried = doctest.testfile(str(page), module_relative=False)
    assert (failed, tried > 0) == (0, True)


def test_given_the_examples_of_public_names_then_they_answer_as_shown():
    finder, runner = doctest.DocTestFinder(), doctest.DocTestRunner()
    for name in tx.__all__:
        for test in finder.find(getattr(tx, name), name, globs={}):
            runner.run(test)
    assert runner.summarize(verbose=False).failed == 0
    assert runner.tries > 5
