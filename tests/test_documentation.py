"""What the pages of the documentation name is there; ARCHITECTURE.md says where things are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from taxinet_ros.errors import ExitCode

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'taxinet_ros'
PAGE = (ROOT / 'ARCHITECTURE.md').read_text(encoding='utf-8')
PAGES = sorted([
    *ROOT.glob('*.md'), *ROOT.glob('docs/**/*.md'), *ROOT.glob('examples/**/*.md'),
    *ROOT.glob('benchmarks/*.md'),
])
ROW = re.compile(r'^\| `(\w+)/` \|[^|]*\|([^|]*)\|$', re.MULTILINE)


def rooms_of(floor: Path) -> set[str]:
    return {path.parent.name for path in floor.glob('*/__init__.py')}


def test_given_the_page_then_every_file_and_folder_that_it_names_exists():
    named = re.findall(r'`([\w./-]*/[\w./-]*|\w+\.(?:py|md|toml))`', PAGE)
    places = [name for name in named if not name.startswith('/')]
    assert len(places) > 30
    parents = (ROOT, PACKAGE, PACKAGE / 'core' / 'mtl', PACKAGE / 'trials' / 'record')
    missing = [name for name in places if not any((parent / name).exists() for parent in parents)]
    assert missing == []


def test_given_the_table_of_floors_then_it_lists_the_rooms_that_there_are():
    told = {floor: set(re.findall(r'`(\w+)`', rooms)) for floor, rooms in ROW.findall(PAGE)}
    real = {
        path.parent.name: rooms_of(path.parent) for path in PACKAGE.glob('*/__init__.py')
        if rooms_of(path.parent)
    }
    assert told == real


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_given_a_page_then_every_file_and_heading_that_it_links_to_exists(page):
    lost = []
    text = re.sub(r'```.*?```|`[^`\n]*`', '', page.read_text(encoding='utf-8'), flags=re.DOTALL)
    for link in re.findall(r'\]\(([^)\s]+)\)', text):
        name, _, heading = link.partition('#')
        if name.startswith(('http:', 'https:', 'mailto:')):
            continue
        target = page.parent / name if name else page
        if not target.exists() or (heading and heading not in headings(target)):
            lost.append(link)
    assert lost == []


def test_given_the_page_on_faults_then_it_tells_every_exit_code():
    text = (ROOT / 'docs' / 'faults.md').read_text(encoding='utf-8')
    told = re.search(r'Exit codes: (.*?)\n\n', text, re.DOTALL)[1]
    assert [code for code in ExitCode if not re.search(rf'\b{code:d} [a-z]', told)] == []


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_given_a_page_then_no_figure_is_left_to_be_filled_in(page):
    assert blanks(page.read_text(encoding='utf-8')) == []


def test_given_a_blank_in_a_table_then_it_is_found():
    text = '| `taxinet` | @MIXED@ | see user@example.org, TO`DO` and an `@ANY@` of code |'
    assert blanks(f'{text} TODO: 3 of ??? runs') == ['@MIXED@', 'TODO', '???']


def blanks(text: str) -> list[str]:
    """What authors leave where a figure is to come, outside of code."""
    prose = re.sub(r'```.*?```|`[^`\n]*`', '', text, flags=re.DOTALL)
    return re.findall(r'@[A-Z][A-Z0-9_]*@|\b(?:TODO|FIXME|TBD|XXX)\b|\?\?\?', prose)


def headings(page: Path) -> set[str]:
    """The anchors of a page's headings, as forges make them."""
    lines = re.findall(r'^#+ (.+)$', page.read_text(encoding='utf-8'), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', line.lower()).replace(' ', '-') for line in lines}


def test_given_the_front_page_then_it_is_read_in_a_few_minutes():
    assert len((ROOT / 'README.md').read_text(encoding='utf-8').split()) <= 900
