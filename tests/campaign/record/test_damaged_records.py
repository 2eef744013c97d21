"""Records of a real campaign, damaged and forged: refused or named, never a changed number.

``TAXINET_FUZZ=300`` in the environment flips every bit of its files, not some of them.
"""

from __future__ import annotations

import json
import os
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from journal_samples import rewrite, under_way, write_events, write_old

from taxinet_ros import errors
from taxinet_ros.analysis.runs.campaign import read_runs
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.campaign.doctor import examine, mend
from taxinet_ros.campaign.past_runs.judged_run import bag_differences, find_run
from taxinet_ros.campaign.past_runs.recorded_campaign import open_failed_campaign, scenario_of_row
from taxinet_ros.campaign.record.facts import FACTS_NAME, LEDGER_NAME, read_facts, write_facts
from taxinet_ros.campaign.record.ledger import Ledger, read_ledger
from taxinet_ros.campaign.record.resumption import read_earlier_runs
from taxinet_ros.campaign.record.table import (
    CSV_NAME,
    PARQUET_NAME,
    check_tables,
    read_table,
    write_tables,
)
from taxinet_ros.cli.main import _exit_code, app
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import draft_path
from taxinet_ros.files.journal import parse_journal, read_journal
from taxinet_ros.files.sealed_json import read_sealed, write_sealed

pytestmark = [pytest.mark.nightly, pytest.mark.ros]
RUNS = 4
FUZZ = int(os.environ.get('TAXINET_FUZZ', '1'))
FILES = (LEDGER_NAME, FACTS_NAME, CSV_NAME, PARQUET_NAME)


@pytest.fixture(scope='module')
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of the real graph, with failed and satisfied runs and their bags."""
    out = tmp_path_factory.mktemp('records') / 'c'
    words = ['falsify', 'nominal', '--runs', str(RUNS), '--workers', '2', '--sampler', 'random',
             '--seed', '3', '--images', 'none', '--perception', 'truth', '--set', 'duration_s=1',
             '--spec', 'tight=always(abs(cte) <= 0.4)', '--out', str(out)]
    assert _exit_code(lambda: app(words, standalone_mode=False)) == 1
    assert set(read_table(out)['outcome']) == {'PASS', 'FAIL'}
    return out


@pytest.fixture
def campaign(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it to be damaged; every warning is told again."""
    monkeypatch.setattr(errors, '_WARNED', set())
    return Path(shutil.copytree(made, tmp_path / 'c'))


@pytest.fixture
def taxinet(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    def run(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = _exit_code(lambda: app([str(word) for word in words], standalone_mode=False))
        return code, *capsys.readouterr()
    return run


def what_readers_say(folder: Path) -> tuple[object, object, pd.DataFrame]:
    """All that ``gate``, ``analyze`` and the reports take from a campaign's folder."""
    check_tables(folder)
    content = read_ledger(folder / LEDGER_NAME)
    return content, read_runs(folder).facts, read_table(folder)


def damaged(data: bytes, most: int) -> Iterator[bytes]:
    """The data with one bit flipped, for so many of its bits."""
    bits = random.Random(2).sample(range(8 * len(data)), min(most * FUZZ, 8 * len(data)))
    for bit in bits:
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        yield bytes(changed)


@pytest.mark.parametrize(('name', 'most'), [
    (LEDGER_NAME, 400), (FACTS_NAME, 400), (CSV_NAME, 200), (PARQUET_NAME, 200)])
def test_f2_given_any_flipped_bit_of_a_record_then_every_reader_of_it_refuses(
    campaign, name, most
):
    what_readers_say(campaign)
    data = (campaign / name).read_bytes()
    count = 0
    for changed in damaged(data, most):
        (campaign / name).write_bytes(changed)
        with pytest.raises(UsageError) as caught:
            what_readers_say(campaign)
        said = str(caught.value)
        assert str(campaign / name) in said
        assert 'taxinet doctor' in said
        assert '\n' not in said
        count += 1
    assert count >= most


def test_f2_given_any_flipped_bit_of_the_ledger_then_no_line_of_it_is_taken_for_another(campaign):
    """Without the other files' help, as in a campaign that has not ended."""
    data = (campaign / LEDGER_NAME).read_bytes()
    assert not parse_journal(data).troubles
    tried = list(damaged(data, 6000))
    assert len(tried) >= 6000
    assert all(parse_journal(changed).troubles for changed in tried)


@pytest.mark.parametrize(('change', 'said'), [
    (lambda lines: lines.pop(3), ':4: damaged line (lines before it are missing)'),
    (lambda lines: lines.pop(0), ':1: damaged line (lines before it are missing)'),
    (lambda lines: lines.insert(4, lines[3]), ':5: damaged line (it occurs twice, first as'),
    (lambda lines: lines.append(lines[2]), ':10: damaged line (it occurs twice, first as'),
    (lambda lines: lines.__setitem__(slice(3, 5), lines[4:2:-1]), ':4: damaged line (it belongs'),
    (lambda lines: lines.pop(), 'missing at its end'),
    (lambda lines: lines.__delitem__(slice(5, None)), '4 of its 9 lines are missing'),
    (lambda lines: lines.__delitem__(slice(0, None)), '9 of its 9 lines are missing'),
])
def test_f2_given_lines_lost_doubled_or_in_another_order_then_that_is_said(
    campaign, taxinet, change, said
):
    lines = (campaign / LEDGER_NAME).read_bytes().splitlines(keepends=True)
    assert len(lines) == 1 + 2 * RUNS
    change(lines)
    (campaign / LEDGER_NAME).write_bytes(b''.join(lines))
    code, _, err = taxinet('gate', campaign, '--min-satisfaction', '0.1')
    assert (code, err.count('\n')) == (2, 1)
    assert said in err
    assert f'taxinet doctor {campaign}' in err


def test_f2_given_a_last_line_whose_end_is_damaged_then_it_is_not_taken_for_a_torn_one(campaign):
    under_way(campaign)
    path = campaign / LEDGER_NAME
    whole = path.read_bytes()
    for changed in (whole[:-1] + b'\x0b', whole[:-1] + b'\x8a'):
        path.write_bytes(changed)
        with pytest.raises(UsageError, match=r'jsonl:9: damaged line \(its end is damaged'):
            Ledger(path)
        assert path.read_bytes() == changed, 'it is left as it is'
    path.write_bytes(whole[:-1])
    with Ledger(path):
        pass
    assert path.read_bytes() == b''.join(whole.splitlines(keepends=True)[:-1])


def test_f2_given_records_of_earlier_versions_then_they_are_read_and_said_to_be_unprotected(
    campaign, taxinet
):
    path = campaign / LEDGER_NAME
    events = read_journal(path)
    rows, facts = read_ledger(path).rows, read_facts(campaign)
    write_old(path, events)
    (campaign / FACTS_NAME).write_text(json.dumps(facts.values))
    code, _, err = taxinet('gate', campaign, '--min-satisfaction', '0.1')
    assert code in (0, 3)
    assert f'{path}: its first 9 lines were written by an earlier version' in err
    assert f'{campaign / FACTS_NAME}: unverified' in err
    assert err.count('\n') == 2
    with Ledger(path) as ledger:
        ledger.campaign(facts.values)
    assert read_ledger(path).rows == rows
    old, _, added = path.read_bytes().rpartition(b'{"chain"')
    path.write_bytes(old.replace(b'"outcome"', b'"outcomf"', 1) + b'{"chain"' + added)
    with pytest.raises(UsageError, match='damaged'):
        read_ledger(path)


@pytest.mark.parametrize('events', [1, 2])
def test_f2_given_damage_to_a_checksum_then_no_new_ledger_looks_like_an_old_one(tmp_path, events):
    path = tmp_path / LEDGER_NAME
    write_events(path, [{'event': 'intent', 'index': i, 'run_id': f'r-{i}'} for i in range(events)])
    data = path.read_bytes()
    flipped = 0
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        assert parse_journal(bytes(changed)).troubles, bit
        flipped += 1
    assert flipped > 800


def test_f2_given_a_campaign_json_that_was_edited_then_it_is_not_written_over_in_silence(campaign):
    path = campaign / FACTS_NAME
    sound = path.read_text()
    path.write_text(sound.replace('"runs": 4', '"runs": 5'))
    for use in (lambda: read_ledger(campaign / LEDGER_NAME), lambda: write_facts(campaign, {}),
                lambda: read_runs(campaign), lambda: write_tables([], campaign)):
        with pytest.raises(UsageError, match=r'campaign\.json: damaged or edited'):
            use()
    path.write_text(sound)
    write_facts(campaign, {**read_facts(campaign).values, 'seed': 4})  # with a checksum that fits
    with pytest.raises(UsageError, match=r'campaign\.json: has another seed than ledger\.jsonl'):
        read_ledger(campaign / LEDGER_NAME)


def test_f2_given_a_table_alone_and_of_pandas_then_it_is_said_to_be_unverified(
    campaign, capsys, tmp_path
):
    (tmp_path / 'alone').mkdir()
    shutil.copy(campaign / PARQUET_NAME, tmp_path / 'alone')
    read_runs(campaign)
    assert len(read_runs(tmp_path / 'alone').frame) == RUNS
    assert capsys.readouterr().err == '', 'it has a checksum in itself'
    read_table(campaign).to_parquet(tmp_path / 'alone' / PARQUET_NAME)
    assert len(read_runs(tmp_path / 'alone').frame) == RUNS
    said = 'its tables are unverified, since campaign.json is not there'
    assert capsys.readouterr().err == f'taxinet: warning: {tmp_path / "alone"}: {said}\n'


def test_f2_given_any_flipped_bit_of_a_sealed_index_then_it_is_refused(tmp_path):
    """As of an experiment, an analysis, a dataset, what a search has learned."""
    path, table = tmp_path / 'experiment.json', tmp_path / 'pairs.parquet'
    table.write_bytes(b'pairs')
    values = {'name': 'e', 'arms': {'a': {'failures': 3}}, 'share': 0.25, 'none': None}
    write_sealed(path, values, [table])
    assert read_sealed(path).values == values
    data = path.read_bytes()
    for changed in damaged(data, 1500):
        path.write_bytes(changed)
        with pytest.raises(UsageError, match='damaged or edited') as caught:
            read_sealed(path)
        assert '\n' not in str(caught.value)
    path.write_bytes(data)
    assert not examine(tmp_path).findings
    table.write_bytes(b'qairs')
    (found,) = examine(tmp_path).findings
    assert found.what == 'is not the file recorded in experiment.json'
    with pytest.raises(UsageError, match='do it again'):
        read_sealed(path).check_file(table, 'do it again')


@pytest.mark.parametrize('name', ['stages.jsonl', 'rounds.jsonl', 'trials.jsonl'])
def test_doctor_given_another_journal_then_its_damage_is_found_and_mended(tmp_path, name):
    path = tmp_path / 'inner' / name
    path.parent.mkdir()
    events = [{'event': 'end', 'stage': f's{number}', 'wall_s': 1.5} for number in range(3)]
    write_events(path, events)
    assert not examine(tmp_path).findings
    path.write_bytes(path.read_bytes().replace(b'"s1"', b'"s9"'))
    (found,) = examine(tmp_path).findings
    assert (found.where, found.what) == (f'{path}:2', 'its checksum differs')
    (done,) = mend(tmp_path)
    assert done.endswith('lost: line 2')
    assert not examine(tmp_path).findings
    assert read_journal(path) == [events[0], events[2]]


# Semantics -------------------------------------------------------------------------------------


def lie(events: list[dict[str, Any]], about: str, changes: dict[str, Any]) -> None:
    """Change the first row of an outcome."""
    row = next(event['row'] for event in events
               if event['event'] == 'result' and event['row']['outcome'] == about)
    row.update(changes)


LIES = [
    ('FAIL', {'rho': {'tight': 0.5}}, 'FAIL with robustness'),
    ('PASS', {'rho': {'tight': -0.5}}, 'PASS with robustness'),
    ('PASS', {'rho': {'tight': 0.0}}, 'PASS with robustness'),
    ('PASS', {'outcome': 'FAIL'}, 'FAIL with robustness'),
    ('PASS', {'outcome': 'INFRA_ERROR'}, 'INFRA_ERROR with rho'),
    ('PASS', {'rho': {'tight': float('nan')}}, 'a robustness is no number'),
    ('PASS', {'outcome': 'GREAT'}, 'GREAT'),
    ('PASS', {'run_id': '../../../etc'}, 'not a plain name'),
    ('PASS', {'bag': '../../../etc'}, 'not a plain name'),
    ('PASS', {'index': -1}, 'index is -1'),
    ('PASS', {'clouds': 'purple'}, 'clouds is'),
    ('PASS', {'distance_m': float('inf')}, 'distance_m is inf'),
]


@pytest.mark.parametrize(('outcome', 'changes', 'said'), LIES)
def test_f2_given_a_row_that_cannot_be_then_the_ledgers_line_is_named(
    campaign, outcome, changes, said
):
    under_way(campaign)
    rewrite(campaign / LEDGER_NAME, lambda events: lie(events, outcome, changes))
    with pytest.raises(UsageError, match=r'ledger\.jsonl:\d+: damaged line') as caught:
        read_ledger(campaign / LEDGER_NAME)
    assert said in str(caught.value)


@pytest.mark.parametrize(('column', 'value', 'said'), [
    ('rho_tight', -1.0, 'PASS, but a robustness is not above 0'),
    ('rho', -1.0, 'PASS, but rho is not above 0'),
    ('outcome', 'FAIL', 'FAIL, but no robustness is 0 or less'),
    ('outcome', 'INFRA_ERROR', 'a robustness without a verdict'),
    ('outcome', 'GREAT', 'an unknown word for outcome'),
    ('run_id', '../../../etc', 'its run_id is not a plain name'),
    ('index', -1, 'its index is negative'),
    ('distance_m', float('inf'), 'distance_m is not finite'),
    ('clouds', 'purple', 'an unknown word for clouds'),
])
def test_f2_given_a_row_that_cannot_be_then_the_tables_row_is_named(
    campaign, tmp_path, column, value, said
):
    frame = read_table(campaign)
    at = frame.index[frame['outcome'] == 'PASS'][0]
    frame.loc[at, column] = value
    if column == 'rho_tight':
        frame.loc[at, ['rho_lower.tight', 'rho_upper.tight']] = value
    frame.to_parquet(tmp_path / 'forged.parquet')
    with pytest.raises(UsageError) as caught:
        read_table(tmp_path / 'forged.parquet')
    assert f'forged.parquet: row {at + 1}: {said}' in str(caught.value)


@pytest.mark.parametrize('column', ['run_id', 'index'])
def test_f2_given_a_row_that_is_there_twice_then_the_table_is_refused(campaign, tmp_path, column):
    frame = read_table(campaign)
    frame.loc[1, column] = frame.loc[0, column]
    frame.to_parquet(tmp_path / 'forged.parquet')
    with pytest.raises(UsageError, match=f'row 2: its {column} occurs twice'):
        read_table(tmp_path / 'forged.parquet')


def test_f2_given_a_second_verdict_of_a_run_then_the_ledger_is_refused(campaign):
    under_way(campaign)
    rewrite(campaign / LEDGER_NAME, lambda events: events.append(events[-1]))
    with pytest.raises(UsageError, match=r':10: damaged line \(run \d is \w+ already'):
        read_ledger(campaign / LEDGER_NAME)


def test_f2_given_an_intent_without_result_or_the_other_way_then_the_gate_names_the_run(
    campaign, taxinet
):
    words = ('gate', campaign, '--min-satisfaction', '0.1')
    assert 'note' not in taxinet(*words)[1]
    facts, path = read_facts(campaign).values, campaign / LEDGER_NAME
    events = read_journal(path)
    result = next(event for event in events if event['event'] == 'result')
    for left_out, said in (
        (result, 'started but has no result'),
        (next(event for event in events if event.get('index') == result['row']['index']),
         'has a result but no record of its start'),
    ):
        write_events(path, [event for event in events if event is not left_out])
        (campaign / FACTS_NAME).unlink()
        write_facts(campaign, facts)
        write_tables(read_ledger(path).rows, campaign, ['tight'])
        assert f'note: run {result["row"]["index"]}: {said}' in ' '.join(taxinet(*words)[1].split())


# Bags ------------------------------------------------------------------------------------------


def swap_bags(campaign: Path, one: str, other: str) -> None:
    """Give a failed run the bag of a satisfied one, under its own name."""
    shutil.rmtree(campaign / one)
    shutil.copytree(campaign / other, campaign / one)
    (campaign / one / f'{other}_0.mcap').rename(campaign / one / f'{one}_0.mcap')


def test_f2_given_the_bag_of_another_run_then_it_is_noticed_wherever_row_and_bag_meet(
    campaign, taxinet
):
    failed = open_failed_campaign(campaign).counterexamples[0]
    other = next(row for row in read_ledger(campaign / LEDGER_NAME).rows if row.outcome == 'PASS')
    assert scenario_of_row(failed, campaign, {})[1]
    swap_bags(campaign, failed.run_id, other.run_id)
    said = f'{campaign / failed.run_id}: is not the bag of its run: its run_id is {other.run_id}'
    for use in (lambda: scenario_of_row(failed, campaign, {}),
                lambda: find_run(campaign / failed.run_id)):
        with pytest.raises(UsageError) as caught:
            use()
        assert said in str(caught.value)
    code, _, err = taxinet('monitor', campaign, '--spec', 'new=always(abs(cte) < 9)', '--add')
    assert (code, said in err) == (2, True)
    found = [one.what for one in examine(campaign).findings if failed.run_id in one.where]
    assert any('its outcome is PASS, the row has FAIL' in what for what in found)


# The doctor ------------------------------------------------------------------------------------


def test_doctor_given_a_sound_campaign_then_it_says_so_and_mending_changes_no_byte(
    campaign, taxinet
):
    def contents() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in campaign.rglob('*') if path.is_file()}

    before = contents()
    code, out, err = taxinet('doctor', campaign)
    assert (code, err) == (0, '')
    *notes, last = out.splitlines()
    assert last == f'{campaign}: 1 journals, 1 indices, {RUNS} runs, 2 tables, {RUNS} bags: sound'
    nothing = 'not checked, no record to verify against'
    assert notes == [f'note    {campaign / "logs"}: {nothing}: worker-1.log, worker-2.log']
    assert taxinet('doctor', campaign, '--mend')[0] == 0
    assert contents() == before


def test_doctor_given_what_nothing_vouches_for_then_all_of_it_is_named(campaign, taxinet, tmp_path):
    shutil.copytree(campaign / 'nominal-s3-00000', campaign / 'more' / 'bag')
    (campaign / 'elsewhere').symlink_to(tmp_path)
    for name in ('report.html', 'notes.txt', 'runs.csv.damaged-1'):
        (campaign / name).write_text('1')
    code, out, _ = taxinet('doctor', campaign)
    assert code == 0
    assert f'note    {campaign}: not checked, made from the rest: report.html\n' in out
    assert ': elsewhere, notes.txt, runs.csv.damaged-1\n' in out
    found = json.loads(taxinet('doctor', campaign, '--json')[1])
    assert {str(Path(path).relative_to(campaign)) for path in found['not_checked']} == {
        'report.html', 'notes.txt', 'runs.csv.damaged-1', 'elsewhere', 'more/bag',
        'logs/worker-1.log', 'logs/worker-2.log',
    }


def test_doctor_given_no_campaign_then_one_line_says_so(taxinet, tmp_path):
    for place in (tmp_path, tmp_path / 'none'):
        code, _, err = taxinet('doctor', place)
        assert (code, err.count('\n')) == (2, 1)


@pytest.mark.parametrize(('name', 'how'), [
    (FACTS_NAME, 'flipped'), (CSV_NAME, 'flipped'), (PARQUET_NAME, 'flipped'), (FACTS_NAME, 'gone'),
    (PARQUET_NAME, 'gone')])
def test_doctor_given_a_damaged_table_or_index_then_it_is_written_anew_from_the_ledger(
    campaign, taxinet, name, how
):
    path = campaign / name
    data = path.read_bytes()
    before = read_table(campaign)
    ledger = (campaign / LEDGER_NAME).read_bytes()
    if how == 'gone':
        path.unlink()
    else:
        path.write_bytes(data[:99] + bytes([data[99] ^ 4]) + data[100:])
    code, out, _ = taxinet('doctor', campaign)
    assert code == 3
    assert name in out
    assert f'mended by: taxinet doctor --mend {campaign}' in out
    code, out, _ = taxinet('doctor', campaign, '--mend')
    assert code == 0, out
    mended = (campaign / LEDGER_NAME).read_bytes()
    assert mended.startswith(ledger)
    assert (mended == ledger) == (name != FACTS_NAME), 'else nobody vouched for its end'
    assert ('its end is unverified' in out) == (name == FACTS_NAME)
    pd.testing.assert_frame_equal(read_table(campaign), before)
    what_readers_say(campaign)


def everything(folder: Path) -> set[bytes]:
    return {path.read_bytes() for path in folder.iterdir() if path.is_file()}


def of_another(campaign: Path, tmp_path: Path) -> bytes:
    """The ledger of the same program with another seed."""
    path = tmp_path / 'other.jsonl'
    events = read_journal(campaign / LEDGER_NAME)
    for event in events:
        if event['event'] == 'campaign':
            event['campaign']['seed'] = 9
        elif event['event'] == 'result':
            event['row'] |= {'seed': 9, 'run_id': event['row']['run_id'].replace('s3', 's9')}
        else:
            event['run_id'] = event['run_id'].replace('s3', 's9')
    write_events(path, events)
    return path.read_bytes()


@pytest.mark.parametrize('kept', [0, 1, 5, 'other'])
def test_doctor_given_a_ledger_that_lost_its_end_then_no_byte_goes_and_the_loss_is_said_for_ever(
    campaign, taxinet, tmp_path, kept
):
    path = campaign / LEDGER_NAME
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(of_another(campaign, tmp_path) if kept == 'other' else b''.join(lines[:kept]))
    before = everything(campaign)
    rows = len(read_table(campaign))
    code, out, _ = taxinet('doctor', campaign)
    assert code == 3
    assert 'does not say what the ledger says: it has run' in out or kept == 'other'
    code, out, _ = taxinet('doctor', campaign, '--mend')
    assert (code, 'sound' in out.splitlines()[-1]) == (3, False)
    assert before <= everything(campaign), 'all that was there is there'
    content = read_ledger(path)
    assert (len(content.rows) < rows, content.campaign['seed']) == (True, 3)
    assert 'without a result that was in the tables: run ' in out
    again = everything(campaign)
    assert taxinet('doctor', campaign, '--mend')[0] == 3
    assert everything(campaign) == again, 'once is enough'
    if content.rows:
        notes = taxinet('gate', campaign, '--min-satisfaction', '0.1')[1]
        assert 'without a result that was in the tables' in notes


def test_doctor_given_lost_runs_that_have_results_again_then_it_is_sound(campaign):
    path = campaign / LEDGER_NAME
    events = read_journal(path)
    path.write_bytes(b''.join(path.read_bytes().splitlines(keepends=True)[:5]))
    mend(campaign)
    assert read_ledger(path).incomplete
    done = {row.index for row in read_ledger(path).rows}
    begun = set(read_ledger(path).attempts)
    rows = [event for event in events if event['event'] == 'result'
            and event['row']['index'] not in done]
    with Ledger(path) as ledger:
        for event in rows:
            if event['row']['index'] not in begun:
                ledger.intent(event['row']['index'], event['row']['run_id'])
            ledger._append(event)
    mend(campaign)
    assert not read_ledger(path).incomplete
    assert read_ledger(path).lost
    assert not examine(campaign).findings


@pytest.mark.parametrize('first', [True, False])
def test_doctor_given_two_campaigns_in_one_ledger_then_the_others_lines_are_put_aside(
    campaign, taxinet, tmp_path, first
):
    path = campaign / LEDGER_NAME
    own, other = path.read_bytes(), of_another(campaign, tmp_path)
    rows = read_ledger(path).rows
    path.write_bytes(other + own if first else own + other)
    before = everything(campaign)
    assert taxinet('doctor', campaign)[0] == 3
    code, out, _ = taxinet('doctor', campaign, '--mend')
    assert (code, 'or belong to another campaign' in out) == (3, True)
    assert read_ledger(path).rows == rows
    assert path.read_bytes().startswith(own)
    assert before <= everything(campaign)


def test_f2_given_a_campaign_line_of_another_campaign_then_the_line_is_refused(campaign):
    under_way(campaign)
    path = campaign / LEDGER_NAME
    facts = dict(read_ledger(path).campaign)
    for name, value in (('seed', 9), ('sampler', 'cem'), ('program_sha256', 'f' * 64)):
        rewrite(path, lambda events, changed={**facts, name: value}: events.append(
            {'event': 'campaign', 'campaign': changed}))
        with pytest.raises(UsageError, match=rf'jsonl:10: .*line of another campaign: its {name}'):
            read_ledger(path)
        rewrite(path, lambda events: events.pop())


def test_doctor_given_a_lost_first_line_then_what_the_campaign_is_is_put_back(campaign, taxinet):
    path = campaign / LEDGER_NAME
    facts, whole = read_facts(campaign).values, path.read_bytes()
    path.write_bytes(whole.partition(b'\n')[2])
    taxinet('doctor', campaign, '--mend')
    assert read_ledger(path).campaign == facts
    assert len(read_ledger(path).rows) == RUNS
    write_events(path, [one for one in read_journal(path) if one['event'] != 'campaign'])
    (campaign / FACTS_NAME).unlink()
    with pytest.raises(UsageError, match='has runs but no campaign record') as caught:
        read_earlier_runs(campaign, facts)
    assert f'taxinet doctor --mend {campaign}' in str(caught.value)


def test_doctor_given_a_cut_ledger_that_nobody_vouches_for_then_a_note_on_its_end_remains(
    campaign, taxinet
):
    path = campaign / LEDGER_NAME
    path.write_bytes(b''.join(path.read_bytes().splitlines(keepends=True)[:5]))
    for name in (FACTS_NAME, CSV_NAME, PARQUET_NAME):
        (campaign / name).unlink()
    taxinet('doctor', campaign, '--mend')
    for words in (('doctor', campaign), ('gate', campaign, '--min-satisfaction', '0.1')):
        assert 'its end is unverified' in taxinet(*words)[1]


@pytest.mark.parametrize('name', [LEDGER_NAME, FACTS_NAME, 'x.jsonl', PARQUET_NAME])
@pytest.mark.parametrize('make', [
    os.mkfifo, os.mkdir, lambda path: path.symlink_to(path.with_name('none'))])
def test_doctor_given_what_is_no_regular_file_then_it_is_named_and_neither_read_nor_mended(
    campaign, taxinet, name, make
):
    (campaign / name).unlink(missing_ok=True)
    make(campaign / name)
    before = everything(campaign)
    code, out, _ = taxinet('doctor', campaign)
    assert (code, name in out) == (3, True)
    code, _, err = taxinet('doctor', campaign, '--mend')
    assert (code, err.count('\n')) == (2, 1)
    assert f'{campaign / name}: is not a regular file' in err
    assert everything(campaign) == before


def test_doctor_given_a_table_that_was_forged_with_its_digests_then_the_ledger_says_otherwise(
    campaign,
):
    rows = list(read_ledger(campaign / LEDGER_NAME).rows)
    write_tables(rows[:-1], campaign, ['tight'])
    found = examine(campaign).findings
    assert [Path(one.where).name for one in found] == [CSV_NAME, PARQUET_NAME]
    assert all(one.what == 'does not say what the ledger says' for one in found)
    mend(campaign)
    assert not examine(campaign).findings


def test_doctor_given_a_damaged_line_then_it_is_put_aside_and_its_bag_has_the_verdict(
    campaign, taxinet
):
    path = campaign / LEDGER_NAME
    data = path.read_bytes()
    lines = data.splitlines(keepends=True)
    number = max(at for at, line in enumerate(lines) if b'"event":"result"' in line)
    lost = json.loads(lines[number])['row']
    lines[number] = lines[number].replace(b'"outcome"', b'"outcame"')
    path.write_bytes(b''.join(lines))
    code, out, _ = taxinet('doctor', campaign)
    assert code == 3
    assert f'BAD     {path}:{number + 1}: its checksum differs' in out
    assert f'{campaign / lost["run_id"]}: a bag without a result' in out
    assert f'it says {lost["outcome"]} (tight {lost["rho"]["tight"]:+.3f})' in out
    code, out, _ = taxinet('doctor', campaign, '--mend')
    assert code == 3, 'one run has no result any more'
    aside = campaign / f'{LEDGER_NAME}.damaged-1'
    assert aside.read_bytes() == b''.join(lines), 'nothing recorded is lost'
    assert f'lost: line {number + 1}' in out
    content = read_ledger(path)
    assert content.unfinished == (lost['index'],)
    assert len(content.rows) == len(read_table(campaign)) == RUNS - 1
    notes = taxinet('gate', campaign, '--min-satisfaction', '0.1')[1]
    assert f'the original is kept as {aside.name}' in notes


def test_doctor_given_lines_doubled_and_in_another_order_then_all_are_put_right(campaign):
    path = campaign / LEDGER_NAME
    data = path.read_bytes()
    rows = read_ledger(path).rows
    lines = data.splitlines(keepends=True)
    path.write_bytes(b''.join([*lines[:2], lines[4], lines[3], lines[2], lines[3], *lines[5:]]))
    assert examine(campaign).findings
    mend(campaign)
    assert not examine(campaign).findings
    assert read_ledger(path).rows == rows
    assert path.read_bytes().startswith(data), 'and then that it was mended'


def test_doctor_given_what_killed_processes_leave_then_it_is_named(campaign, taxinet):
    bag = campaign / read_table(campaign)['bag'][0]
    draft_path(bag / METADATA_FILE).write_text('rosbag2_')
    code, out, _ = taxinet('doctor', campaign)
    assert code == 3
    assert f'{draft_path(bag / METADATA_FILE)}: left by a killed process' in out
    under_way(campaign)
    said = json.loads(taxinet('doctor', campaign, '--json')[1])
    assert not said['sound']
    assert any('has not ended in good order' in one['what'] for one in said['findings'])


def test_doctor_given_a_bag_that_is_gone_or_damaged_then_it_is_named(campaign):
    first, second = read_table(campaign)['bag'][:2]
    shutil.rmtree(campaign / first)
    (mcap,) = (campaign / second).glob('*.mcap')
    data = mcap.read_bytes()
    mcap.write_bytes(data[:3000] + bytes([data[3000] ^ 1]) + data[3001:])
    found = {Path(one.where).name: one.what for one in examine(campaign).findings}
    assert set(found) == {first, second}
    assert 'is missing' in found[first]


def test_doctor_given_somebody_at_work_then_nothing_is_mended(campaign, taxinet):
    with Ledger(campaign / LEDGER_NAME):
        code, _, err = taxinet('doctor', campaign, '--mend')
    assert (code, 'in use by another process' in err) == (2, True)


# Bags beside the record ------------------------------------------------------------------------


@pytest.mark.parametrize('linked', [False, True])
def test_f2_given_the_bag_of_another_run_then_no_command_gives_its_numbers(
    campaign, taxinet, tmp_path, linked
):
    failed = open_failed_campaign(campaign).counterexamples[0]
    other = next(row for row in read_ledger(campaign / LEDGER_NAME).rows if row.outcome == 'PASS')
    bag = campaign / failed.run_id
    if linked:
        shutil.rmtree(bag)
        bag.symlink_to(other.run_id)
    else:
        swap_bags(campaign, failed.run_id, other.run_id)
    mcap = next(bag.glob('*.mcap'))
    said = f'is not the bag of its run: its run_id is {other.run_id}'
    again = ('run', '--from', bag, '--out', tmp_path / 'again')
    for words in (('monitor', campaign), ('monitor', bag), ('monitor', mcap),
                  ('monitor', campaign, '--json'), again, ('shrink', bag),
                  ('explain', bag, '--perception', 'original', '--out', tmp_path / 'explained'),
                  ('bag', 'replay', bag, '--into', 'mtl_monitor', '--out', tmp_path / 'replayed')):
        code, out, err = taxinet(*words)
        assert (code, said in err, len(err.splitlines())) == (2, True, 1), (words, out, err)
        assert f'{failed.run_id}  ' not in out


def test_f2_given_the_bag_of_the_same_run_of_another_campaign_then_monitor_refuses_it(
    campaign, taxinet
):
    under_way(campaign)
    rewrite(campaign / LEDGER_NAME, lambda events: lie(events, 'FAIL', {'rho': {'tight': -9.0}}))
    failed = open_failed_campaign(campaign).counterexamples
    row = next(row for row in failed if row.rho['tight'] == -9.0)
    for place in (campaign, campaign / row.run_id):
        code, _, err = taxinet('monitor', place)
        assert (code, 'is not the bag of its run: its rho of tight is' in err) == (2, True), err


@pytest.mark.parametrize(('words', 'said'), [
    (['--set', 'clouds=overcast', '--set', 'rain=90', '--spec', 'tight=always(abs(cte) <= 0.401)'],
     ['its rain_percent is 90.0, the row has 0.0',
      'its formula tight is always(abs(cte) <= 0.401), the ']),
    (['--set', 'steering.heading_gain=0.4', '--spec', 'tight=always(abs(cte) <= 0.4)'],
     ['its steering.heading_gain is 0.4, the row has ']),
])
def test_f2_given_the_bags_of_a_campaign_with_other_scenes_gains_or_formulas_then_they_are_named(
    campaign, taxinet, tmp_path, words, said
):
    """Under the same names, with the same seeds, however alike it all went."""
    other = tmp_path / 'other'
    code, _, err = taxinet(
        'falsify', 'nominal', '--runs', '2', '--workers', '1', '--sampler', 'random', '--seed', '3',
        '--images', 'none', '--perception', 'truth', '--set', 'duration=1', *words, '--out', other,
    )
    assert code in (0, 1), err
    rows = {row.index: row for row in read_ledger(campaign / LEDGER_NAME).rows}
    recording = open_recording(campaign / rows[0].bag)
    assert bag_differences(rows[0], read_facts(campaign).values, recording) == []
    for index in (0, 1):
        shutil.rmtree(campaign / rows[index].bag)
        shutil.copytree(other / rows[index].bag, campaign / rows[index].bag)
    found = [one.what for one in examine(campaign).findings if rows[0].run_id in one.where]
    for text in said:
        assert any(text in what for what in found), found
    code, _, err = taxinet('monitor', campaign)
    assert (code, 'is not the bag of its run: its ' in err, len(err.splitlines())) == (2, True, 1)
    code, out, _ = taxinet('doctor', other)
    assert code == 0, out


@pytest.mark.parametrize('share', [0.5, 0.98])
def test_f2_given_a_cut_bag_in_its_place_then_monitor_reads_what_there_is(
    campaign, taxinet, share
):
    failed = open_failed_campaign(campaign).counterexamples[0]
    mcap = next((campaign / failed.run_id).glob('*.mcap'))
    mcap.write_bytes(mcap.read_bytes()[:int(mcap.stat().st_size * share)])
    code, out, err = taxinet('monitor', campaign)
    assert (code, err) == (3, ''), out
    assert 'bags' in out.splitlines()[-1]
