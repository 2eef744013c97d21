"""A full disk ends a campaign with one line, whichever of its files it was that did not fit."""

import errno
import os

import pytest

from taxinet_ros.campaign.ledger import Ledger
from taxinet_ros.campaign.table import write_tables
from taxinet_ros.cli import main as cli


def refuse(*arguments: object) -> int:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def told(work, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = cli._exit_code(work)
    return code, capsys.readouterr().err


def test_given_a_ledger_that_cannot_grow_then_one_line_names_it(tmp_path, monkeypatch, capsys):
    with Ledger(tmp_path / 'ledger.jsonl') as ledger:
        monkeypatch.setattr(os, 'write', refuse)
        code, line = told(lambda: ledger.intent(0, 'run'), capsys)
    assert (code, line) == (
        4, f'taxinet: error: {tmp_path}/ledger.jsonl: [Errno 28] No space left on device\n'
    )


def test_given_a_line_of_which_half_fits_then_one_line_says_so(tmp_path, monkeypatch, capsys):
    with Ledger(tmp_path / 'ledger.jsonl') as ledger:
        monkeypatch.setattr(os, 'write', lambda descriptor, data: len(data) // 2)
        code, line = told(lambda: ledger.intent(0, 'run'), capsys)
    assert code == 4
    assert f'{tmp_path}/ledger.jsonl: [Errno 28] only ' in line
    assert line.count('\n') == 1


def test_given_a_table_that_does_not_fit_then_one_line_names_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(os, 'fsync', refuse)
    code, line = told(lambda: write_tables([], tmp_path), capsys)
    assert (code, line) == (
        4, f'taxinet: error: {tmp_path}/runs.csv: [Errno 28] No space left on device\n'
    )


def test_given_another_fault_of_the_system_then_it_is_not_hidden(capsys):
    def fail() -> None:
        raise OSError(errno.ENOTDIR, 'not a directory')

    assert cli._exit_code(fail) == 2, 'a path that does not do'
    assert 'not a directory' in capsys.readouterr().err
