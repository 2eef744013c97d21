"""``docs/faults.md``: all kinds of errors, and tests that exist for every fault."""

from __future__ import annotations

import re
from pathlib import Path

from taxinet_ros.errors import InfraKind

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / 'docs' / 'faults.md'


def kinds_in_docs() -> list[str]:
    """The kinds of an INFRA_ERROR in the order of the page's first table."""
    first = TABLE.read_text().split('| kind | means |')[1].split('\n\n')[0]
    return re.findall(r'^\| `(\w+)` \|', first, re.MULTILINE)


def kinds_in_message() -> list[str]:
    text = (ROOT / 'msg_defs' / 'msg' / 'RunStatus.msg').read_text()
    (line,) = (line for line in text.splitlines() if line.startswith('string kind'))
    return line.split('INFRA_ERROR: ')[1].split(', ')


def test_given_the_kinds_of_errors_then_the_docs_and_the_message_list_all_of_them():
    assert kinds_in_docs() == kinds_in_message() == list(InfraKind)


def test_given_a_fault_then_it_says_what_happens_and_its_tests_exist():
    table = TABLE.read_text().split('| fault | what happens | tested in |')[1].split('\n\n')[0]
    rows = [line.strip('| ').split(' | ') for line in table.splitlines()[2:]]
    assert len(rows) > 25
    for cells in rows:
        assert len(cells) == 3, cells
        named = re.findall(r'`([^`]+)`', cells[2])
        assert named, cells
        assert all((ROOT / 'tests' / name).exists() for name in named), cells
