"""Short chaos leaves nothing broken, and what is broken is found."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import chaos
import pytest
from chaos import DAMAGES, FAULTS, NOT_RESUMED, RESUMED, Chaos, numbers

from taxinet_ros.errors import InfraError

pytestmark = pytest.mark.nightly

FAKE = r"""
import json, pathlib, sys, time
sys.path[:0] = {path!r}
from taxinet_ros.trials.record.content import ROW, run_key
from taxinet_ros.trials.record.facts import FACTS
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import write_tables
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import Record
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.verdict.outcome import Outcome

words = sys.argv[1:]
out = pathlib.Path('c')
resumed = '--resume' in words
trouble = {trouble!r}

def row(index, rho):
    return RunRow(run_id=f'r{{index}}', index=index, program='p', seed=0, perception='truth',
                  outcome=Outcome.PASS, robustness=exact_intervals({{'phi': rho}}))

rows = [row(index, 1.0) for index in range(8)]
try:
    record = Record(out / 'campaign.db')
except UsageError as error:
    print(f'taxinet: error: {{error}}')
    sys.exit(2)
with record:
    record.put(FACTS, '', {{}})
    if not resumed:
        for one in rows[:7]:
            record.put(ROW, run_key(one.index), one.to_json())
        print('half', flush=True)
        if pathlib.Path('../begun').exists():
            time.sleep(1000)
        pathlib.Path('../begun').touch()
    if resumed and 'rows changed' in trouble:
        rows[7] = row(7, 2.0)
    if resumed and 'traceback' in trouble:
        raise RuntimeError
    if resumed and trouble == 'hang':
        time.sleep(1000)
    for one in rows[7:8 - ('rows lost' in trouble and resumed)]:
        record.put(ROW, run_key(one.index), one.to_json())
write_tables(rows, out, {{}})
if 'orphan' in trouble and resumed:
    import subprocess
    subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(1000)'])
sys.exit(2 if 'exit code' in trouble and resumed else 0)
"""


@pytest.fixture
def one_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kill amid the first sitting of a campaign of eight runs; no damage."""
    subject = chaos.Subject(words=('falsify',), runs=8)
    fault = chaos.Fault(
        act=lambda sitting: sitting.process.send_signal(signal.SIGKILL),
        codes=frozenset({-signal.SIGKILL}),
    )
    monkeypatch.setattr(chaos, 'SUBJECTS', {'falsify': subject})
    monkeypatch.setattr(chaos, 'FAULTS', {'killed': fault})
    monkeypatch.setattr(chaos, 'RESUMED', ('killed',))
    monkeypatch.setattr(chaos, '_SITTINGS', 1)
    monkeypatch.setattr(chaos, '_LEAVE_S', 1.0)
    monkeypatch.setattr(chaos, 'DAMAGES', {'nothing': ()})


def disturbing(tmp_path: Path, trouble: str) -> Chaos:
    """Chaos around campaigns that a fake command makes, with mistakes when it is resumed."""
    fake = tmp_path / 'fake.py'
    fake.write_text(FAKE.format(path=sys.path, trouble=trouble))
    folder = tmp_path / 'chaos'
    folder.mkdir()
    return Chaos(folder, (sys.executable, str(fake)), seed=0)


@pytest.mark.usefixtures('one_fault')
@pytest.mark.parametrize('trouble', [
    '', 'rows changed, orphan', 'rows lost, exit code', 'traceback',
])
def test_given_a_campaign_that_goes_wrong_when_resumed_then_chaos_says_how(trouble, tmp_path):
    one = disturbing(tmp_path, trouble)
    one.trial(0)
    found = one.found
    assert found.ends == {'killed': {'-9': 1}}
    kinds = {kind for _, kind, _ in found.broken}
    assert kinds >= set(trouble.split(', ')) if trouble else not kinds, found.broken
    assert bool(trouble) == any((tmp_path / 'chaos').glob('trial-*')), 'kept where it broke'
    report = json.loads(json.dumps(found.report()))
    assert report['trials'] == found.trials
    assert sum(report['found'].values()) == len(report['broken'])


@pytest.mark.usefixtures('one_fault')
def test_given_a_campaign_that_hangs_then_it_is_ended_and_told(tmp_path, monkeypatch):
    one = disturbing(tmp_path, 'hang')
    one._whole('falsify')
    monkeypatch.setattr(chaos, 'HANG_S', 3.0)
    one.trial(0)
    assert {kind for _, kind, _ in one.found.broken} == {'hang'}


@pytest.mark.usefixtures('one_fault')
def test_given_a_record_that_is_cut_then_it_is_refused_by_name_and_put_back(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(chaos, 'DAMAGES', {'record cut': DAMAGES['record cut']})
    one = disturbing(tmp_path, '')
    refused = []
    fixed = chaos._Trial._fixed

    def noted(trial, name, sitting):
        refused.append(sitting.last_line)
        return fixed(trial, name, sitting)

    monkeypatch.setattr(chaos._Trial, '_fixed', noted)
    one.trial(0)
    assert one.found.ends['record cut'] == {'done': 1}
    assert one.found.broken == []
    (line,) = refused
    assert 'c/campaign.db: damaged' in line


def test_given_a_command_that_is_no_taxinet_then_nothing_is_compared_with_it(tmp_path):
    with pytest.raises(InfraError, match='ended with 1'):
        Chaos(tmp_path, (sys.executable, '-c', 'raise SystemExit(1)'), seed=0).trial(0)


def test_given_the_lists_then_every_fault_is_drawn():
    assert {*RESUMED, *NOT_RESUMED} == set(FAULTS)
    assert list(numbers(3, None, None)) == [0, 1, 2]
    assert list(numbers(None, None, 7)) == [7]


@pytest.mark.ros
def test_given_short_chaos_then_nothing_is_broken(capsys):
    assert chaos.main(['--seed', str(SEED), '--trials', '1', '--json']) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report['trials'], report['found']) == (1, {})
    assert report['rows_compared'] == 8
    assert report['faults']['campaign killed'] == {'-9': 1}
    assert sum(times for ends in report['faults'].values() for times in ends.values()) >= 2


SEED = 4764
"""Its first trial is a falsification that is killed, resumed, and disturbed once more."""
