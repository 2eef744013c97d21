"""Records of a real campaign, damaged: refused or named, made again, never a changed number.

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
from journal_samples import rewrite, under_way, write_events

from taxinet_ros import errors
from taxinet_ros.analysis.runs.campaign import read_runs
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.campaign.doctor import examine
from taxinet_ros.campaign.past_runs.judged_run import bag_differences, find_run
from taxinet_ros.campaign.past_runs.recorded_campaign import open_failed_campaign, scenario_of_row
from taxinet_ros.campaign.record.facts import FACTS_NAME, LEDGER_NAME, read_facts, write_facts
from taxinet_ros.campaign.record.ledger import Ledger, read_ledger
from taxinet_ros.campaign.record.table import (
    CSV_NAME,
    PARQUET_NAME,
    WALL_CLOCK_COLUMNS,
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
SEARCH = ('falsify', 'nominal', '--runs', str(RUNS), '--sampler', 'random', '--seed', '3',
          '--images', 'none', '--perception', 'truth', '--set', 'duration_s=1',
          '--spec', 'tight=always(abs(cte) <= 0.4)')
FUZZ = int(os.environ.get('TAXINET_FUZZ', '1'))
FILES = (LEDGER_NAME, FACTS_NAME, CSV_NAME, PARQUET_NAME)


@pytest.fixture(scope='module')
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of the real graph, with failed and satisfied runs and their bags."""
    out = tmp_path_factory.mktemp('records') / 'c'
    words = [*SEARCH, '--workers', '2', '--out', str(out)]
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
    (lambda lines: lines.pop(3), '1 of its 9 lines are missing at its end'),
    (lambda lines: lines.pop(), 'missing at its end'),
    (lambda lines: lines.__delitem__(slice(5, None)), '4 of its 9 lines are missing'),
    (lambda lines: lines.__delitem__(slice(0, None)), '9 of its 9 lines are missing'),
])
def test_f2_given_lost_lines_then_that_is_said(
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


def test_f2_given_records_of_another_version_then_they_are_refused(campaign, taxinet):
    path, facts = campaign / LEDGER_NAME, read_facts(campaign).values
    whole = path.read_bytes()
    path.write_text(''.join(json.dumps(event) + '\n' for event in read_journal(path)))
    code, _, err = taxinet('gate', campaign, '--min-satisfaction', '0.1')
    assert (code, f'{path}:1: damaged line (no checksum: ' in err) == (2, True)
    path.write_bytes(whole)
    (campaign / FACTS_NAME).write_text(json.dumps(facts))
    code, _, err = taxinet('gate', campaign, '--min-satisfaction', '0.1')
    assert (code, 'has no checksum; was it written by another version?' in err) == (2, True)


@pytest.mark.parametrize('events', [1, 2])
def test_f2_given_any_flipped_bit_of_a_short_journal_then_it_is_noticed(tmp_path, events):
    path = tmp_path / LEDGER_NAME
    write_events(path, [{'event': 'intent', 'index': i, 'run_id': f'r-{i}'} for i in range(events)])
    data = path.read_bytes()
    flipped = 0
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        assert parse_journal(bytes(changed)).troubles, bit
        flipped += 1
    assert flipped > 500


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
def test_doctor_given_another_journal_then_its_damage_is_found(tmp_path, name):
    path = tmp_path / 'inner' / name
    path.parent.mkdir()
    events = [{'event': 'end', 'stage': f's{number}', 'wall_s': 1.5} for number in range(3)]
    write_events(path, events)
    assert not examine(tmp_path).findings
    path.write_bytes(path.read_bytes().replace(b'"s1"', b'"s9"'))
    (found,) = examine(tmp_path).findings
    assert (found.where, found.what) == (f'{path}:2', 'its checksum differs')


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


def test_f2_given_a_start_without_result_then_the_gate_names_the_run(
    campaign, taxinet
):
    words = ('gate', campaign, '--min-satisfaction', '0.1')
    assert 'note' not in taxinet(*words)[1]
    facts, path = read_facts(campaign).values, campaign / LEDGER_NAME
    events = read_journal(path)
    result = next(event for event in events if event['event'] == 'result')
    write_events(path, [event for event in events if event is not result])
    (campaign / FACTS_NAME).unlink()
    write_facts(campaign, facts)
    write_tables(read_ledger(path).rows, campaign, ['tight'])
    said = f'note: run {result["row"]["index"]}: started but has no result'
    assert said in ' '.join(taxinet(*words)[1].split())


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


def test_doctor_given_a_sound_campaign_then_it_says_so(campaign, taxinet):
    code, out, err = taxinet('doctor', campaign)
    assert (code, err) == (0, '')
    *notes, last = out.splitlines()
    assert last == f'{campaign}: 1 journals, 1 indices, {RUNS} runs, 2 tables, {RUNS} bags: sound'
    nothing = 'not checked, no record to verify against'
    assert notes == [f'note    {campaign / "logs"}: {nothing}: worker-1.log, worker-2.log']


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


def flip(path: Path, at: int = 99) -> None:
    data = path.read_bytes()
    path.write_bytes(data[:at] + bytes([data[at] ^ 4]) + data[at + 1:])


def cut_to(path: Path, lines: int) -> None:
    path.write_bytes(b''.join(path.read_bytes().splitlines(keepends=True)[:lines]))


def last_result(path: Path) -> int:
    """Place of the last result in a ledger."""
    return path.read_bytes().rindex(b'"outcome"')


@pytest.mark.parametrize(('damage', 'copies'), [
    (lambda folder: flip(folder / LEDGER_NAME, last_result(folder / LEDGER_NAME)), [LEDGER_NAME]),
    (lambda folder: flip(folder / LEDGER_NAME), [LEDGER_NAME]),  # what the campaign is
    (lambda folder: cut_to(folder / LEDGER_NAME, 5), [LEDGER_NAME]),
    (lambda folder: cut_to(folder / LEDGER_NAME, 0), [LEDGER_NAME]),
    (lambda folder: flip(folder / FACTS_NAME), [FACTS_NAME]),
    (lambda folder: (folder / FACTS_NAME).unlink(), []),
    (lambda folder: flip(folder / PARQUET_NAME), []),
    (lambda folder: (folder / CSV_NAME).unlink(), []),
], ids=['a result', 'the facts of the ledger', 'its end', 'all of it', 'campaign.json',
        'campaign.json gone', 'table', 'table gone'])
def test_given_a_damaged_record_when_resumed_then_it_is_as_before_and_nothing_recorded_is_lost(
    campaign, taxinet, damage, copies
):
    before = read_table(campaign).drop(columns=list(WALL_CLOCK_COLUMNS))
    damage(campaign)
    damaged_files = {name: (campaign / name).read_bytes() for name in copies}
    assert taxinet('doctor', campaign)[0] == 3
    code, _, err = taxinet(*SEARCH, '--out', campaign, '--resume')
    assert code == 1
    for name, data in damaged_files.items():
        assert f'{name} (kept as {name}.damaged-1)' in err
        assert (campaign / f'{name}.damaged-1').read_bytes() == data
    after = read_table(campaign).drop(columns=list(WALL_CLOCK_COLUMNS))
    pd.testing.assert_frame_equal(after, before)
    what_readers_say(campaign)
    code, out, _ = taxinet('doctor', campaign)
    assert code == 0, out


@pytest.mark.parametrize('name', [LEDGER_NAME, FACTS_NAME, 'x.jsonl', PARQUET_NAME])
@pytest.mark.parametrize('make', [
    os.mkfifo, os.mkdir, lambda path: path.symlink_to(path.with_name('none'))])
def test_doctor_given_what_is_no_regular_file_then_it_is_named_and_not_read(
    campaign, taxinet, name, make
):
    (campaign / name).unlink(missing_ok=True)
    make(campaign / name)
    code, out, _ = taxinet('doctor', campaign)
    assert (code, name in out) == (3, True)


def test_doctor_given_a_table_of_fewer_runs_then_the_ledger_says_otherwise(campaign):
    rows = list(read_ledger(campaign / LEDGER_NAME).rows)
    write_tables(rows[:-1], campaign, ['tight'])
    found = examine(campaign).findings
    assert [Path(one.where).name for one in found] == [CSV_NAME, PARQUET_NAME]
    assert all(one.what == 'does not say what the ledger says' for one in found)


def test_doctor_given_a_damaged_line_then_it_is_named_and_its_bag_has_the_verdict(
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
