"""``docs/faults.md``: all kinds of errors, a row for each fault, and tests that exist."""

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


def rows() -> dict[str, list[str]]:
    """Cells of each row of the table of faults, by its number."""
    lines = [line.strip('|').split(' | ') for line in TABLE.read_text().splitlines()]
    return {
        cells[0].strip(): [cell.strip() for cell in cells[1:]]
        for cells in lines if re.fullmatch(r' ?F\d+', cells[0])
    }


def functions() -> set[str]:
    """Every test there is, as ``file::function``."""
    return {
        f'{file.name}::{name}'
        for file in (ROOT / 'tests').rglob('test_*.py')
        for name in re.findall(r'^def (test_\w+)\(', file.read_text(), re.MULTILINE)
    }


def test_given_the_table_then_it_has_all_faults_once_and_in_order():
    assert list(rows()) == [f'F{number}' for number in range(1, 31)]
    text = TABLE.read_text()
    assert all(text.count(f'| F{number} |') == 1 for number in range(1, 31))


def test_given_a_fault_then_it_says_what_happens_and_the_tests_behind_it_exist():
    there = functions()
    assert len(there) > 500
    for number, cells in rows().items():
        assert len(cells) == 3, number
        assert all(cells), number
        named = re.findall(r'`([^`]*)`', cells[2])
        assert named, number
        assert set(named) <= there, (number, sorted(set(named) - there))
