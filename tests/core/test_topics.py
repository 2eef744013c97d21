"""No other line of the package than the table's spells a topic's name."""

from __future__ import annotations

import re
from pathlib import Path

import taxinet_ros
from taxinet_ros.core.topics import TOPICS

PACKAGE = Path(taxinet_ros.__file__).parent
TABLE = PACKAGE / 'core' / 'topics.py'
EXAMPLE = PACKAGE / 'bag' / '__init__.py'  # Its docstring shows how a table is read.


def test_given_the_package_then_topics_are_spelled_in_one_file_only():
    # 'scenario' and 'clock' are words of their own, too.
    names = [topic.name.lstrip('/') for topic in TOPICS]
    spelled = re.compile(
        '|'.join(f"'/?{name}'" for name in names if '/' in name or '_' in name)
        + "|'/scenario'|'/clock'"
    )
    files = sorted(set(PACKAGE.rglob('*.py')) - {TABLE, EXAMPLE})
    assert len(files) > 300
    assert [
        f'{path.relative_to(PACKAGE)}: {found[0]}' for path in files
        for found in spelled.finditer(path.read_text(encoding='utf-8'))
    ] == []
