"""ARCHITECTURE.md tells newcomers where things are: everything that it names is there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'taxinet_ros'
PAGE = (ROOT / 'ARCHITECTURE.md').read_text(encoding='utf-8')
ROW = re.compile(r'^\| `(\w+)/` \|[^|]*\|([^|]*)\|$', re.MULTILINE)


def rooms_of(floor: Path) -> set[str]:
    return {path.parent.name for path in floor.glob('*/__init__.py')}


def test_given_the_page_then_every_file_and_folder_that_it_names_exists():
    named = re.findall(r'`([\w./-]*/[\w./-]*|\w+\.(?:py|md|toml))`', PAGE)
    places = [name for name in named if not name.startswith('/')]
    assert len(places) > 40
    parents = (ROOT, PACKAGE, PACKAGE / 'core' / 'mtl', PACKAGE / 'campaign' / 'record')
    missing = [name for name in places if not any((parent / name).exists() for parent in parents)]
    assert missing == []


def test_given_the_table_of_floors_then_it_lists_the_rooms_that_there_are():
    told = {floor: set(re.findall(r'`(\w+)`', rooms)) for floor, rooms in ROW.findall(PAGE)}
    real = {
        path.parent.name: rooms_of(path.parent) for path in PACKAGE.glob('*/__init__.py')
        if rooms_of(path.parent)
    }
    assert told == real
