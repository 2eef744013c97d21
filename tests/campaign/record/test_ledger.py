"""The ledger: nothing acknowledged is lost, nothing torn is believed, a full disk says so.

A full disk ends a campaign with one line, whichever of its files it was that did not fit.
"""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

from taxinet_ros.campaign.record.ledger import Ledger, read_ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import write_tables
from taxinet_ros.cli import main as cli
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import HUMAN_KEYS
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.verdict.run_statistics import RunStatistics
from taxinet_ros.errors import UsageError


def row(index: int, outcome: Outcome = Outcome.PASS, rho: float = 0.1 + 0.2) -> RunRow:
    request = RunRequest(
        run_id=f'run-{index}', index=index, program='s_falsif', seed=5,
        scenario=Scenario(clouds='stratus', rain_fraction=1 / 3),
        judging=Judging(specs=('phi_eventually',)),
        participants=(),
    )
    judged = outcome.judged
    result = RunResult(outcome=outcome, last_seq=300, wall_s=3.0,
                       robustness=exact_intervals({'phi_eventually': rho} if judged else {}),
                       statistics=RunStatistics(max_cross_track_m=2.0) if judged else None)
    return RunRow.of_run(request, result, perception='truth', sim_s=30.0, bag=f'run-{index}')


def fill(path: Path) -> None:
    with Ledger(path) as ledger:
        ledger.campaign({'seed': 5})
        for index in range(3):
            ledger.intent(index, f'run-{index}')
            if index < 2:
                ledger.result(row(index))


def test_given_a_ledger_when_read_then_rows_campaign_and_unfinished_runs_come_back(
    tmp_path: Path,
) -> None:
    fill(tmp_path / 'ledger.jsonl')
    content = read_ledger(tmp_path / 'ledger.jsonl')
    assert content.campaign == {'seed': 5}
    assert content.rows == (row(0), row(1))
    assert content.unfinished == (2,)


def test_given_any_torn_end_when_read_and_resumed_then_only_the_torn_line_is_gone(
    tmp_path: Path,
) -> None:
    whole = tmp_path / 'whole.jsonl'
    fill(whole)
    data = whole.read_bytes()
    start = data.rfind(b'\n', 0, data.rfind(b'"event":"result"')) + 1
    torn = tmp_path / 'torn.jsonl'
    cuts = list(range(start, data.index(b'\n', start), 37))
    assert len(cuts) > 5
    for cut in cuts:
        torn.write_bytes(data[:cut])
        assert read_ledger(torn).rows == (row(0),)
        assert read_ledger(torn).unfinished == (1,)
        with Ledger(torn) as ledger:
            ledger.result(row(1))
        assert read_ledger(torn).rows == (row(0), row(1))


def test_given_a_second_result_when_read_then_the_newer_one_counts(tmp_path: Path) -> None:
    path = tmp_path / 'ledger.jsonl'
    with Ledger(path) as ledger:
        ledger.result(row(0, Outcome.INFRA_ERROR))
        ledger.result(row(0))
    assert read_ledger(path).rows == (row(0),)


@pytest.mark.parametrize('line', ['{"event":', '{"event":"party"}', '[]',
                                  '{"event":"result","row":{"index":3}}'])
def test_given_a_damaged_line_when_read_then_its_number_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / 'ledger.jsonl'
    fill(path)
    with path.open('a') as file:
        file.write(line + '\n')
    with pytest.raises(UsageError, match=r'ledger\.jsonl:7: damaged line') as caught:
        read_ledger(path)
    assert '\n' not in str(caught.value)


def test_given_an_open_ledger_when_opened_again_then_the_second_writer_is_refused(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'ledger.jsonl'
    with Ledger(path) as ledger:
        ledger.intent(0, 'run-0')
        with pytest.raises(UsageError, match='another campaign'):
            Ledger(path)
    assert read_ledger(path).unfinished == (0,)


def test_given_no_folder_when_opened_then_one_line_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match='No such file'):
        Ledger(tmp_path / 'none' / 'ledger.jsonl')
    with pytest.raises(UsageError, match='No such file'):
        read_ledger(tmp_path / 'none.jsonl')


def test_given_a_line_when_read_by_other_tools_then_it_is_plain_json(tmp_path: Path) -> None:
    path = tmp_path / 'ledger.jsonl'
    with Ledger(path) as ledger:
        ledger.result(row(4, Outcome.FAIL, rho=-1.25))
    values = json.loads(path.read_text())['row']
    assert (values['index'], values['outcome'], values['rho']) == (
        4, 'FAIL', {'phi_eventually': -1.25}
    )


def test_given_a_verdict_without_rho_when_made_a_row_then_it_is_refused() -> None:
    with pytest.raises(ValueError, match='PASS with rho'):
        RunRow(run_id='r', index=0, program='p', seed=1, perception='truth', outcome=Outcome.PASS)
    with pytest.raises(ValueError, match='INFRA_ERROR with rho'):
        RunRow(run_id='r', index=0, program='p', seed=1, perception='truth',
               outcome=Outcome.INFRA_ERROR, robustness=exact_intervals({'phi': 1.0}))


def refuse(*arguments: object) -> int:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def code_and_line(work, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = cli._exit_code(work)
    return code, capsys.readouterr().err


def test_given_a_ledger_that_cannot_grow_then_one_line_names_it(tmp_path, monkeypatch, capsys):
    with Ledger(tmp_path / 'ledger.jsonl') as ledger:
        monkeypatch.setattr(os, 'write', refuse)
        code, line = code_and_line(lambda: ledger.intent(0, 'run'), capsys)
    assert (code, line) == (
        4, f'taxinet: error: {tmp_path}/ledger.jsonl: [Errno 28] No space left on device\n'
    )


def test_given_a_line_of_which_half_fits_then_one_line_says_so(tmp_path, monkeypatch, capsys):
    with Ledger(tmp_path / 'ledger.jsonl') as ledger:
        monkeypatch.setattr(os, 'write', lambda descriptor, data: len(data) // 2)
        code, line = code_and_line(lambda: ledger.intent(0, 'run'), capsys)
    assert code == 4
    assert f'{tmp_path}/ledger.jsonl: [Errno 28] only ' in line
    assert line.count('\n') == 1


def test_given_a_table_that_does_not_fit_then_one_line_names_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(os, 'fsync', refuse)
    code, line = code_and_line(lambda: write_tables([], tmp_path), capsys)
    assert (code, line) == (
        4, f'taxinet: error: {tmp_path}/runs.csv: [Errno 28] No space left on device\n'
    )


def test_given_another_fault_of_the_system_then_it_is_not_hidden(capsys):
    def fail() -> None:
        raise OSError(errno.ENOTDIR, 'not a directory')

    assert cli._exit_code(fail) == 2, 'a path that does not do'
    assert 'not a directory' in capsys.readouterr().err


def test_given_a_row_when_written_then_its_scene_stands_by_keys() -> None:
    written = row(0).to_json()
    assert {key: written[key] for key in HUMAN_KEYS} == row(0).scene
    assert RunRow.from_json(written) == row(0)


def test_given_a_row_with_an_unknown_column_then_it_is_refused() -> None:
    with pytest.raises(UsageError, match='unexpected fingerprint'):
        RunRow.from_json({**row(0).to_json(), 'fingerprint': ''})
