"""A campaign whose folder is taken away ends and says so; one whose disk was full goes on."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import pytest
from campaign_records import results
from command_process import ended, small_disk, taxinet
from waiting import wait_for

from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import read_table

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

RUNS = ['--perception', 'truth', '--images', 'none', '--set', 'duration=1', '--out', 'c']
RUN = ['run', 'nominal', '--runs', '2000', *RUNS]
FALSIFY = ['falsify', 'nominal', '--runs', '2000', '--workers', '2', *RUNS]


def moved(tmp_path: Path) -> None:
    (tmp_path / 'c').rename(tmp_path / 'moved')


def replaced(tmp_path: Path) -> None:
    moved(tmp_path)
    (tmp_path / 'c').mkdir()


def lost(
    words: list[str], act: Callable[[Path], None], tmp_path: Path
) -> tuple[int, list[str], list[str]]:
    with taxinet(*words, cwd=tmp_path) as campaign:
        wait_for(lambda: results(tmp_path / 'c') >= 2)
        act(tmp_path)
        code, out, err = ended(campaign)
    complaints = [line for line in err.splitlines() if line.startswith('taxinet: error: ')]
    assert 'Traceback' not in err
    return code, out.splitlines(), complaints


@pytest.mark.parametrize(
    ('words', 'act'), [(RUN, replaced), (FALSIFY, moved)], ids=['run', 'falsify']
)
def test_f9_given_a_record_that_is_taken_away_then_the_campaign_ends_and_tells_what_it_knows(
    words, act, tmp_path
):
    code, lines, complaints = lost(words, act, tmp_path)
    assert code == 4
    (line,) = complaints
    assert 'was moved' in line
    assert line.startswith('taxinet: error: c/')
    shown = [line for line in lines if ' rho ' in line]
    assert len(shown) >= 2
    assert lines[-1].startswith('known until then: ')
    assert not any(line.startswith(('table:', 'under the program')) for line in lines)
    kept = read_campaign(tmp_path / 'moved').rows
    # The run that noticed it is shown, as nothing can be written any more where its record was.
    assert len(kept) >= len(shown) - 1
    if act is moved:
        assert not (tmp_path / 'c').exists(), 'nothing is begun in its place'
    assert not list((tmp_path / 'c').glob('*.*'))


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk with 3.5 MB more than a bag asks for."""
    with small_disk(tmp_path / 'disk', '980000k') as place:
        yield place


def test_f1_given_a_full_disk_when_there_is_room_again_then_the_campaign_ends_as_undisturbed(
    disk, tmp_path
):
    few = ['falsify', 'nominal', '--runs', '4', *RUNS[:-1]]
    with taxinet(*few, str(disk / 'c'), cwd=tmp_path) as campaign:
        wait_for((disk / 'c').exists)
        (disk / 'of others').write_bytes(bytes(4_000_000))
        code, out, err = ended(campaign)
    assert (code, 'Traceback' in err) == (4, False), err
    assert '3 INFRA_ERROR (3 bag)' in out
    assert '3 runs in a row were broken by the bench; --resume continues it' in out
    subprocess.run(['mount', '-o', 'remount,size=3g', str(disk)], check=True)
    for words in ([str(disk / 'c'), '--resume'], ['whole']):
        with taxinet(*few, *words, cwd=tmp_path) as campaign:
            assert ended(campaign)[0] in (0, 1)
    done, whole = read_table(disk / 'c'), read_table(tmp_path / 'whole')
    assert list(done['retries']) == [2, 2, 2, 0]
    but = [*WALL_CLOCK_COLUMNS, 'retries']
    pd.testing.assert_frame_equal(done.drop(columns=but), whole.drop(columns=but))


def test_given_a_disk_that_fills_up_when_a_campaign_goes_on_then_it_pauses_after_two_runs(
    disk, tmp_path
):
    words = ('run', 'nominal', '--runs', '500', *RUNS[:-1])
    with taxinet(*words, str(disk / 'c'), cwd=tmp_path) as campaign:
        wait_for(lambda: results(disk / 'c') >= 1)
        (disk / 'of others').write_bytes(bytes(4_000_000))
        code, out, err = ended(campaign)
    assert (code, 'Traceback' in err) == (4, False), err
    assert 'GB free on the disk, 1.000 GB wanted; make room or record elsewhere' in out
    table = read_table(disk / 'c')
    assert table['outcome'].iloc[0] == 'PASS'
    assert list(table['outcome'])[-2:] == ['INFRA_ERROR'] * 2
    assert list(table['kind'])[-2:] == ['bag'] * 2
    assert table['rho'].iloc[-2:].isna().all()
