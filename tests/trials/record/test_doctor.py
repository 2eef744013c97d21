"""A real campaign, damaged: named by the doctor, refused by readers, made again by ``--resume``."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from campaign_records import change_row, write_campaign

from taxinet_ros import errors
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.cli.main import _exit_code, app
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.atomic import draft_path
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.doctor import examine
from taxinet_ros.trials.past_runs.recorded_campaign import (
    bag_differences,
    find_run,
    open_campaign,
    open_failed_campaign,
    scenario_of_row,
)
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import CSV_NAME, PARQUET_NAME, read_table

RUNS = 4
SEARCH = ('falsify', 'nominal', '--sampler', 'random', '--seed', '3', '--images', 'none',
          '--engine', 'loop', '--audit', '0', '--perception', 'truth', '--set', 'duration_s=1')
TIGHT = ('--spec', 'tight=always(abs(cte) <= 0.4)')


@pytest.fixture(scope='module')
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with failed and satisfied runs and their bags."""
    out = tmp_path_factory.mktemp('records') / 'c'
    words = [*SEARCH, *TIGHT, '--runs', str(RUNS), '--workers', '2', '--out', str(out)]
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


def findings(folder: Path) -> dict[str, str]:
    return {Path(one.where).name: one.what for one in examine(folder).findings}


def without_clock(table: pd.DataFrame) -> pd.DataFrame:
    return table.drop(columns=list(WALL_CLOCK_COLUMNS))


# The record ------------------------------------------------------------------------------------


def test_doctor_given_a_sound_campaign_then_it_says_so(campaign, taxinet):
    code, out, err = taxinet('doctor', campaign)
    assert (code, err) == (0, '')
    *notes, last = out.splitlines()
    assert last == f'{campaign}: 1 records, {RUNS} runs, 2 tables, {RUNS} bags: sound'
    nothing = 'not checked, no record to verify against'
    assert notes == [f'note    {campaign / "logs"}: {nothing}: worker-1.log, worker-2.log']


def a_bit_of_a_row(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[data.rindex(b'"outcome":"') + 3] ^= 4
    path.write_bytes(data)


def a_page_of_zeros(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[:-4096] + bytes(4096))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-4096])


def a_row_is_lost(path: Path) -> None:
    connection = sqlite3.connect(path)
    connection.execute("DELETE FROM entries WHERE kind = 'row' AND key = '000000002'")
    connection.commit()
    connection.close()


@pytest.mark.parametrize('damage', [
    a_bit_of_a_row, a_page_of_zeros, *(
        pytest.param(damage, marks=pytest.mark.nightly) for damage in (cut, a_row_is_lost)
    ),
])
def test_given_a_damaged_record_then_readers_refuse_it_and_resumed_it_is_as_before(
    campaign, taxinet, tmp_path, damage
):
    path, before = campaign / RECORD_NAME, without_clock(read_table(campaign))
    damage(path)
    data = path.read_bytes()
    code, out, _ = taxinet('doctor', campaign)
    assert (code, f'BAD     {path}: ' in out) == (3, True), out
    for words in (('gate', campaign, '--min-satisfaction', '0.1'), ('analyze', campaign),
                  ('monitor', campaign), ('localize', campaign, '--out', tmp_path / 'l'),
                  ('shrink', campaign / before['bag'][0])):
        code, _, err = taxinet(*words)
        assert (code, str(path) in err, err.count('\n')) == (2, True, 1), (words, err)
    assert path.read_bytes() == data
    code, _, err = taxinet(*SEARCH, *TIGHT, '--runs', RUNS, '--out', campaign, '--resume')
    assert code == 1, err
    assert f'kept as {RECORD_NAME}.damaged-1' in err
    assert path.with_name(f'{RECORD_NAME}.damaged-1').read_bytes() == data
    pd.testing.assert_frame_equal(without_clock(read_table(campaign)), before)
    code, out, _ = taxinet('doctor', campaign)
    assert code == 0, out


def test_given_an_emptied_record_then_nothing_is_begun_anew_over_its_bags(campaign, taxinet):
    (campaign / RECORD_NAME).write_bytes(b'')
    before = sorted(path.name for path in campaign.iterdir())
    code, _, err = taxinet(*SEARCH, *TIGHT, '--runs', RUNS, '--out', campaign, '--resume')
    assert (code, 'is empty, so the earlier options are unknown' in err) == (2, True), err
    assert sorted(path.name for path in campaign.iterdir()) == before


@pytest.mark.parametrize(('name', 'make'), [
    (RECORD_NAME, os.mkfifo), (RECORD_NAME, os.mkdir), ('experiment.json', os.mkfifo),
])
def test_doctor_given_what_is_no_regular_file_then_it_is_named_and_not_read(
    campaign, taxinet, name, make
):
    (campaign / name).unlink(missing_ok=True)
    make(campaign / name)
    code, out, _ = taxinet('doctor', campaign)
    assert (code, f'{name}: is not a regular file' in out) == (3, True)


def test_doctor_given_no_campaign_then_one_line_says_so(taxinet, tmp_path):
    for place in (tmp_path, tmp_path / 'none'):
        code, _, err = taxinet('doctor', place)
        assert (code, err.count('\n')) == (2, 1)


def test_doctor_given_an_older_copy_of_the_record_then_tables_and_bags_tell(campaign, taxinet):
    content = read_campaign(campaign)
    kept = {name: (campaign / name).read_bytes() for name in (CSV_NAME, PARQUET_NAME)}
    write_campaign(campaign, content.rows[:2], content.facts)
    for name, data in kept.items():
        (campaign / name).write_bytes(data)
    newer = [row.bag for row in content.rows[2:]]
    found = findings(campaign)
    assert found.keys() == {CSV_NAME, *newer}
    assert 'has run 2, 3' in found[CSV_NAME] or 'has run 2-3' in found[CSV_NAME]
    for row in content.rows[2:]:
        said = f'(it says {row.outcome}, tight {row.rho["tight"]:+.3f}), which the record does not '
        assert f'is of run {row.index} {said}' in found[row.bag]
    assert (campaign / CSV_NAME).read_bytes() == kept[CSV_NAME], 'it is not written over'
    for name in kept:
        (campaign / name).unlink()
    assert findings(campaign).keys() == {*newer}


def test_given_a_start_without_result_then_doctor_and_gate_name_the_run(campaign, taxinet):
    gate = ('gate', campaign, '--min-satisfaction', '0.1')
    assert 'note' not in taxinet(*gate)[1]
    content = read_campaign(campaign)
    *rows, lost = content.rows
    write_campaign(campaign, rows, content.facts, begun=[lost.index])
    said = f'run {lost.index}: started but has no result'
    assert f'note: {said}' in ' '.join(taxinet(*gate)[1].split())
    code, out, _ = taxinet('doctor', campaign)
    assert (code, f'BAD     {campaign / RECORD_NAME}: {said}' in out) == (3, True)
    assert f'{campaign / lost.bag}: a bag without a result in the record (it says ' in out
    assert f'{lost.outcome}, tight {lost.rho["tight"]:+.3f})' in out
    write_campaign(campaign, rows, content.facts, begun=[lost.index], ended=False)
    code, out, _ = taxinet('doctor', campaign)
    again = 'the command that made it, resumed if it can be, runs it again'
    assert (code, f'{said}; {again}' in out) == (0, True)
    write_campaign(campaign, (), content.facts, begun=[lost.index], ended=False)
    code, _, error = taxinet('monitor', campaign)
    assert (code, 'no finished run left a bag; for that of one that did not' in error) == (2, True)


# Tables and other files ------------------------------------------------------------------------


def edited(folder: Path) -> None:
    for name in (CSV_NAME, PARQUET_NAME):
        path = folder / name
        data = path.read_bytes().replace(b'FAIL', b'PASS')
        assert data != path.read_bytes()
        path.write_bytes(data)


def of_fewer_runs(folder: Path) -> None:
    content = read_campaign(folder)
    write_campaign(folder / 'less', content.rows[:-1], content.facts)
    for name in (CSV_NAME, PARQUET_NAME):
        (folder / 'less' / name).replace(folder / name)
    shutil.rmtree(folder / 'less')


def gone(folder: Path) -> None:
    for name in (CSV_NAME, PARQUET_NAME):
        (folder / name).unlink()


@pytest.mark.parametrize('damage', [
    edited, *(pytest.param(damage, marks=pytest.mark.nightly) for damage in (of_fewer_runs, gone)),
])
def test_doctor_given_tables_that_do_not_say_what_the_record_says_then_they_are_made_again(
    campaign, taxinet, damage
):
    before = (campaign / CSV_NAME).read_bytes()
    damage(campaign)
    damaged = {path: path.read_bytes() for path in campaign.glob('runs.*')}
    with Record(campaign / RECORD_NAME):
        code, out, _ = taxinet('doctor', campaign)
        assert (code, f'note    {campaign}: its campaign is running' in out) == (0, True)
        assert {path: path.read_bytes() for path in campaign.glob('runs.*')} == damaged
    code, out, _ = taxinet('doctor', campaign)
    said = f'{CSV_NAME}, {PARQUET_NAME} made again from the record'
    assert (code, said in out) == (0, True)
    assert (campaign / CSV_NAME).read_bytes() == before
    pd.testing.assert_frame_equal(read_table(campaign / PARQUET_NAME), read_table(campaign))
    assert 'made again' not in taxinet('doctor', campaign)[1]


def test_doctor_given_what_nothing_vouches_for_then_all_of_it_is_named(campaign, taxinet, tmp_path):
    shutil.copytree(campaign / 'nominal-s3-00000', campaign / 'more' / 'bag')
    (campaign / 'elsewhere').symlink_to(tmp_path)
    for name in ('report.html', 'notes.txt', 'campaign.db.damaged-1'):
        (campaign / name).write_text('1')
    code, out, _ = taxinet('doctor', campaign)
    assert code == 0
    assert f'note    {campaign}: not checked, made from the rest: report.html\n' in out
    assert ': campaign.db.damaged-1, elsewhere, notes.txt\n' in out
    found = json.loads(taxinet('doctor', campaign, '--json')[1])
    assert {str(Path(path).relative_to(campaign)) for path in found['not_checked']} == {
        'report.html', 'notes.txt', 'campaign.db.damaged-1', 'elsewhere', 'more/bag',
        'logs/worker-1.log', 'logs/worker-2.log',
    }


def test_doctor_given_bags_that_are_gone_damaged_or_half_written_then_they_are_named(campaign):
    first, second, third = read_table(campaign)['bag'][:3]
    shutil.rmtree(campaign / first)
    (mcap,) = (campaign / second).glob('*.mcap')
    data = bytearray(mcap.read_bytes())
    data[3000] ^= 1
    mcap.write_bytes(data)
    draft = draft_path(campaign / third / METADATA_FILE)
    draft.write_text('rosbag2_')
    found = findings(campaign)
    assert found.keys() == {first, second, draft.name}
    assert 'is missing' in found[first]
    assert 'left by a killed process' in found[draft.name]


# Bags and rows ---------------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize('linked', [False, True])
def test_given_the_bag_of_another_run_then_no_command_gives_its_numbers(
    campaign, taxinet, tmp_path, linked
):
    failed = open_failed_campaign(campaign).counterexamples[0]
    other = next(row for row in open_campaign(campaign).rows if row.outcome is Outcome.PASS)
    bag = campaign / failed.run_id
    assert scenario_of_row(failed, campaign, {})[1]
    shutil.rmtree(bag)
    if linked:
        bag.symlink_to(other.run_id)
    else:
        shutil.copytree(campaign / other.run_id, bag)
        (bag / f'{other.run_id}_0.mcap').rename(bag / f'{failed.run_id}_0.mcap')
    said = f'is not the bag of its run: its run_id is {other.run_id}'
    for use in (lambda: scenario_of_row(failed, campaign, {}), lambda: find_run(bag)):
        with pytest.raises(errors.UsageError, match=said):
            use()
    mcap = next(bag.glob('*.mcap'))
    again = ('run', '--from', bag, '--out', tmp_path / 'again')
    for words in (('monitor', campaign), ('monitor', bag), ('monitor', mcap),
                  ('monitor', campaign, '--json'), again, ('shrink', bag),
                  ('monitor', campaign, '--spec', 'new=always(abs(cte) < 9)', '--add'),
                  ('explain', bag, '--perception', 'original', '--out', tmp_path / 'explained'),
                  ('bag', 'replay', bag, '--into', 'mtl_monitor', '--out', tmp_path / 'replayed')):
        code, out, err = taxinet(*words)
        assert (code, said in err, len(err.splitlines())) == (2, True, 1), (words, out, err)
        assert f'{failed.run_id}  ' not in out
    found = [one.what for one in examine(campaign).findings if failed.run_id in one.where]
    assert any('its outcome is PASS, the row has FAIL' in what for what in found)


def test_given_the_bag_of_the_same_run_of_another_campaign_then_it_is_refused(campaign, taxinet):
    failed = open_failed_campaign(campaign).counterexamples[0]
    change_row(campaign, failed.index, robustness={'tight': (-9.0, -9.0)})
    for place in (campaign, campaign / failed.run_id):
        code, _, err = taxinet('monitor', place)
        assert (code, 'is not the bag of its run: its rho of tight is' in err) == (2, True), err
    assert 'its rho of tight is' in findings(campaign)[failed.run_id]


@pytest.mark.nightly
@pytest.mark.parametrize(('words', 'said'), [
    (['--set', 'clouds=overcast', '--set', 'rain=90', '--spec', 'tight=always(abs(cte) <= 0.401)'],
     ['its rain_percent is 90.0, the row has 0.0',
      'its formula tight is always(abs(cte) <= 0.401), the ']),
    (['--set', 'steering.heading_gain=0.4', *TIGHT],
     ['its rho of tight is ']),
])
def test_given_the_bags_of_a_campaign_with_other_scenes_gains_or_formulas_then_they_are_named(
    campaign, taxinet, tmp_path, words, said
):
    """Under the same names, with the same seeds, however alike it all went."""
    other = tmp_path / 'other'
    code, _, err = taxinet(*SEARCH, *words, '--runs', '2', '--out', other)
    assert code in (0, 1), err
    content = read_campaign(campaign)
    first = content.rows[0]
    recording = open_recording(campaign / first.bag)
    assert bag_differences(first, content.facts, recording) == []
    for row in content.rows[:2]:
        shutil.rmtree(campaign / row.bag)
        shutil.copytree(other / row.bag, campaign / row.bag)
    found = [one.what for one in examine(campaign).findings if first.run_id in one.where]
    for text in said:
        assert any(text in what for what in found), found
    code, _, err = taxinet('monitor', campaign)
    assert (code, 'is not the bag of its run: its ' in err, len(err.splitlines())) == (2, True, 1)
    code, out, _ = taxinet('doctor', other)
    assert code == 0, out


@pytest.mark.parametrize('share', [0.5, 0.98])
def test_given_a_cut_bag_in_its_place_then_monitor_reads_what_there_is(campaign, taxinet, share):
    failed = open_failed_campaign(campaign).counterexamples[0]
    mcap = next((campaign / failed.run_id).glob('*.mcap'))
    mcap.write_bytes(mcap.read_bytes()[:int(mcap.stat().st_size * share)])
    code, out, err = taxinet('monitor', campaign)
    assert (code, err) == (3, ''), out
    assert 'bags' in out.splitlines()[-1]
