"""``taxinet shrink`` on real graphs: a run shrunk and run again, an interrupt, refusals."""

from __future__ import annotations

import json
import shlex
import shutil
import signal
from pathlib import Path

import pytest
from campaign_records import results
from taxinet_process import begun, taxinet
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.trials.record.table import read_table

# Fails where the aircraft starts more than 2.05 m off, in rain or not: ground truth sees no rain.
SPEC = 'near=always(abs(cte) <= 2.05)'
RUN = [
    'run', 'nominal', '--perception', 'truth', '--spec', SPEC, '--set', 'duration=0.5',
    '--set', 'cross_track=2.5', '--set', 'heading=0', '--set', 'clouds=broken',
    '--set', 'rain=40', '--set', 'distance=1000', '--set', 'time_of_day=10',
]

pytestmark = [pytest.mark.nightly, pytest.mark.ros]


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a campaign ``c`` of one failed run, shrunk into ``s``."""
    folder = tmp_path_factory.mktemp('shrink')
    done = taxinet(*RUN, '--out', 'c', cwd=folder)
    assert (done.returncode, done.stderr) == (1, '')
    done = taxinet('shrink', 'c/nominal-s0-00000', '--out', 's', cwd=folder)
    assert (done.returncode, done.stderr) == (0, ''), done.stderr
    (folder / 'stdout').write_text(done.stdout)
    return folder


def test_given_a_failed_run_when_shrunk_then_the_screen_says_what_matters(folder):
    lines = (folder / 'stdout').read_text().splitlines()
    assert lines[0].startswith('shrinking nominal-s0-00000 (near, rho -0.')
    table = {line.split()[0]: line.split() for line in lines if line.split()}
    assert table['cross_track_m'][1:7] == ['+2.5', 'm', '0.0', 'm', '+2.1', 'm']
    assert table['cross_track_m'][-1] == 'matters'
    for key in ('clouds', 'rain_percent'):
        assert table[key][-3:] == ['does', 'not', 'matter']
    for key in ('heading_deg', 'distance_m', 'time_of_day_h'):
        assert table[key][-2:] == ['nominal', 'already']
    assert any(line.startswith('cross_track_m: +2.1 m fails, +2.0 m passes') for line in lines)
    assert lines[-2] == 'written: s/shrink.html, shrunk.scenic, shrink.json, shrink.png'


def test_given_a_shrunk_run_then_there_are_bags_a_table_numbers_and_a_picture(folder):
    out = folder / 's'
    table, found = read_table(out), json.loads((out / 'shrink.json').read_text())
    assert len(table) == found['runs'] >= 8
    assert table['rho'].notna().all()
    assert all(read_info(out / bag).complete for bag in table['bag'])
    assert found['end'] == 'minimal'
    assert found['original']['rho'] == read_table(folder / 'c')['rho'][0], 'the same to the bit'
    assert {key for key, one in found['parameters'].items() if one['matters']} == {'cross_track_m'}
    assert (out / 'shrink.png').read_bytes().startswith(b'\x89PNG')
    page = (out / 'shrink.html').read_text()
    assert 'start offset, left of the centreline +2.1 m alone is enough to violate' in page
    assert 'id="worst"' in page, 'the shrunk run is on the first screen'


def test_given_a_cluster_then_the_shrunk_scenario_is_the_same(folder):
    done = taxinet(
        'shrink', 'c/nominal-s0-00000', '--cluster', 'local:2', '--engine', 'loop', '--audit', '0',
        '--out', 'there', cwd=folder,
    )
    assert (done.returncode, done.stderr) == (0, '')
    assert 'cluster local:2 -> there' in done.stdout.splitlines()[0]
    here, there = (
        json.loads((folder / name / 'shrink.json').read_text()) for name in ('s', 'there')
    )
    assert there['end'] == 'minimal'
    assert there['parameters'] == here['parameters']
    assert there['runs'] == here['runs']
    refused = taxinet(
        'shrink', 'c/nominal-s0-00000', '--cluster', 'local:2', '--workers', '2', '--out', 'x',
        cwd=folder,
    )
    assert refused.returncode == 2
    assert 'workers 2: not with a cluster' in refused.stderr
    assert not (folder / 'x').exists()


def test_given_the_command_that_is_printed_then_the_shrunk_scenario_fails_as_it_did(folder):
    line = (folder / 'stdout').read_text().splitlines()[-1]
    assert line.startswith('run it: taxinet run s/shrunk.scenic --perception truth --spec ')
    words = shlex.split(line.removeprefix('run it: taxinet '))
    done = taxinet(*words, '--out', 'again', '--images', 'none', cwd=folder)
    assert (done.returncode, done.stderr) == (1, '')
    rho = json.loads((folder / 's/shrink.json').read_text())['shrunk']['rho']
    assert read_table(folder / 'again')['rho'][0] == pytest.approx(rho, abs=1e-9)


def test_given_an_interrupt_when_resumed_then_it_ends_as_if_there_had_been_none(folder):
    words = ('shrink', 'c/nominal-s0-00000', '--workers', '2', '--out', 'i')
    with begun(*words, cwd=folder) as process:
        wait_for(lambda: results(folder / 'i') >= 3)
        process.send_signal(signal.SIGINT)
        stdout, _ = process.communicate()
    assert process.returncode == 130
    assert 'ended before it was minimal; resume it' in stdout
    done = taxinet(*words, '--resume', '--quiet', cwd=folder)
    assert (done.returncode, done.stderr) == (0, '')
    one, other = (
        json.loads((folder / name / 'shrink.json').read_text()) for name in ('s', 'i')
    )
    assert one['parameters'] == other['parameters']
    assert one['runs'] == other['runs']


def test_given_a_damaged_bag_when_written_again_then_the_result_stands_without_its_path(folder):
    shutil.copytree(folder / 's', folder / 'damaged')
    found = json.loads((folder / 'damaged' / 'shrink.json').read_text())
    (bag,) = (folder / 'damaged' / found['shrunk']['run']).glob('*.mcap')
    data = bytearray(bag.read_bytes())
    data[len(data) // 2] ^= 1
    bag.write_bytes(data)
    done = taxinet(
        'shrink', 'c/nominal-s0-00000', '--out', 'damaged', '--resume', '--quiet', cwd=folder
    )
    assert (done.returncode, done.stderr) == (0, '')
    assert json.loads((folder / 'damaged' / 'shrink.json').read_text()) == found
    page = (folder / 'damaged' / 'shrink.html').read_text()
    assert f'not shown: damaged/{found["shrunk"]["run"]}' in page


def test_given_a_run_that_cannot_be_shrunk_then_one_line_says_why_and_nothing_is_left(folder):
    before = sorted(folder.iterdir())
    done = taxinet('shrink', 'c', cwd=folder)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line == (
        'taxinet: error: c: a campaign; name one of its 1 failed runs, as in c/nominal-s0-00000'
    )
    assert sorted(folder.iterdir()) == before
