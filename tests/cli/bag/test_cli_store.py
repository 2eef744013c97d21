"""``--store``, ``taxinet bag store`` and ``fetch``: every command reads a bag that is far away."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from far_store import local_store, s3_server
from taxinet_process import taxinet

from taxinet_ros.bag.store import STORED_NAME
from taxinet_ros.campaign.record.table import WALL_CLOCK_COLUMNS, read_table

pytestmark = pytest.mark.ros
SEARCH = [
    'falsify', 'nominal', '--runs', '3', '--perception', 'truth', '--set', 'duration=1',
    '--seed', '4', '--sampler', 'random', '--images', 'none',
    '--spec', 'tight=always(abs(cte)<=0.3)',
]
STORE = 's3://taxi/campaigns'


@pytest.fixture(scope='module')
def s3() -> Iterator[str]:
    with s3_server() as address:
        yield address


@pytest.fixture(scope='module')
def made(s3: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign whose bags are in S3."""
    out = tmp_path_factory.mktemp('store') / 'search'
    done = taxinet(*SEARCH, '--out', out, '--store', STORE)
    assert done.returncode in (0, 1), done.stderr
    assert done.stdout.splitlines()[-1] == f'stored: 3 bags in {STORE}/search/'
    return out


@pytest.fixture
def campaign(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / 'search'))


def bags(campaign: Path) -> list[Path]:
    """The bags, as the table names them."""
    found = [campaign / bag for bag in read_table(campaign)['bag']]
    assert len(found) == 3
    return found


def files(bag: Path) -> set[str]:
    return {path.name for path in bag.iterdir()}


def test_given_a_campaign_with_a_store_then_its_bags_are_there_and_the_folder_is_sound(campaign):
    assert [files(bag) for bag in bags(campaign)] == [{STORED_NAME}] * 3
    done = taxinet('doctor', campaign)
    assert (done.returncode, done.stderr) == (0, '')
    assert f'3 of these bags in {STORE}/search, not read' in done.stdout
    assert not any('.mcap' in name for bag in bags(campaign) for name in files(bag))


@pytest.mark.parametrize('words', [
    'info BAG', 'doctor BAG', 'export BAG --out NEW.csv', 'compare BAG OTHER',
    'replay BAG --into mtl_monitor --out NEW', 'render BAG', 'recover BAG --out NEW',
    'info BAG/FILE',
])
def test_given_a_bag_far_away_then_every_command_reads_it(words, campaign, tmp_path):
    bag, other, _ = bags(campaign)
    given = {
        'BAG': bag, 'OTHER': other, 'NEW': tmp_path / 'new', 'NEW.csv': tmp_path / 'new.csv',
        'BAG/FILE': bag / f'{bag.name}_0.mcap',
    }
    done = taxinet('bag', *(given.get(word, word) for word in words.split()))
    assert done.returncode == (1 if 'compare' in words else 0), done.stderr
    assert files(bag) == {STORED_NAME, 'metadata.yaml', f'{bag.name}_0.mcap'}


def test_given_bags_far_away_then_requirements_are_judged_and_runs_repeated_from_them(campaign):
    done = taxinet('monitor', campaign, '--spec', 'wide=always(abs(cte)<=30)', '--add')
    assert done.returncode == 0, done.stderr
    assert list(read_table(campaign)['rho_wide'].notna()) == [True] * 3
    assert taxinet('bag', 'store', campaign, STORE).stdout == (
        f'3 bags in {STORE}/search/, 0 uploaded now\n'
    )
    bag = bags(campaign)[0]
    done = taxinet('run', '--from', bag, '--out', campaign.parent / 'again')
    assert done.returncode == 0, done.stderr


def test_given_stored_bags_when_fetched_then_all_are_back_and_stay_when_kept(campaign, tmp_path):
    done = taxinet('bag', 'fetch', campaign)
    assert (done.returncode, done.stdout) == (0, f'3 bags are back in {campaign}\n')
    assert taxinet('doctor', campaign).returncode == 0
    far = local_store(tmp_path / 'far')
    done = taxinet('bag', 'store', campaign, far, '--keep')
    assert (done.returncode, done.stdout) == (0, f'3 bags in {far}/search/, 3 uploaded now\n')
    assert all((bag / f'{bag.name}_0.mcap').is_file() for bag in bags(campaign))
    nothing = taxinet('bag', 'fetch', tmp_path)
    assert (nothing.returncode, nothing.stderr.count('\n')) == (2, 1)


def test_given_a_damaged_bag_then_it_is_not_stored(campaign, tmp_path):
    taxinet('bag', 'fetch', campaign)
    far = local_store(tmp_path / 'far')
    mcap = next(bags(campaign)[1].glob('*.mcap'))
    data = bytearray(mcap.read_bytes())
    data[len(data) // 2] ^= 1
    mcap.write_bytes(data)
    done = taxinet('bag', 'store', campaign, far)
    assert (done.returncode, done.stderr.count('\n')) == (2, 1)
    assert f'{mcap.parent}: is not stored' in done.stderr
    assert mcap.read_bytes() == data


def test_given_a_stored_bag_that_gets_frames_then_it_replaces_the_stored_one(campaign, tmp_path):
    far = local_store(tmp_path / 'far')
    taxinet('bag', 'fetch', campaign)
    assert taxinet('bag', 'store', campaign, far).returncode == 0
    bag = bags(campaign)[0]
    assert taxinet('bag', 'render', bag).returncode == 0
    done = taxinet('bag', 'store', campaign, far)
    assert (done.returncode, done.stdout) == (0, f'3 bags in {far}/search/, 1 uploaded now\n')
    assert taxinet('bag', 'fetch', bag).returncode == 0
    assert '/camera/image_raw' in taxinet('bag', 'info', bag).stdout


def test_given_a_stored_bag_that_was_edited_then_the_stored_one_is_kept(campaign, tmp_path):
    far = local_store(tmp_path / 'far')
    taxinet('bag', 'fetch', campaign)
    one = bags(campaign)[0]
    assert taxinet('bag', 'store', campaign, far).returncode == 0
    stored = {path: path.read_bytes() for path in (tmp_path / 'far').rglob('*.*')}
    assert len(stored) == 6
    taxinet('bag', 'fetch', one)
    with (one / 'metadata.yaml').open('a') as file:
        file.write('# a remark\n')
    done = taxinet('bag', 'store', campaign, far)
    assert (done.returncode, done.stderr.count('\n')) == (2, 1), done.stderr
    assert f'{one}/metadata.yaml: differs from the stored one, {far}/search/' in done.stderr
    assert {path: path.read_bytes() for path in (tmp_path / 'far').rglob('*.*')} == stored


def test_given_a_bag_that_the_store_lost_then_storing_again_names_it(campaign, tmp_path):
    far = local_store(tmp_path / 'far')
    taxinet('bag', 'fetch', campaign)
    assert taxinet('bag', 'store', campaign, far).returncode == 0
    lost = bags(campaign)[1].name
    shutil.rmtree(tmp_path / 'far' / 'search' / lost)
    done = taxinet('bag', 'store', campaign, far)
    assert (done.returncode, done.stdout, done.stderr.count('\n')) == (2, '', 1)
    assert f'{far}/search/{lost}/' in done.stderr
    assert 'is missing in the store and here' in done.stderr
    assert '2 other bags are stored, 0 uploaded now' in done.stderr


def test_given_shards_with_stores_then_they_merge_and_their_bags_are_found(s3, made, tmp_path):
    shards = []
    for number in (1, 2):
        shards.append(tmp_path / f'shard-{number}')
        done = taxinet(*SEARCH, '--out', shards[-1], '--shard', f'{number}/2', '--store', STORE)
        assert done.returncode in (0, 1), done.stderr
    out = tmp_path / 'merged'
    assert taxinet('merge', *shards, '--out', out).returncode == 0
    tables = [read_table(folder).drop(columns=list(WALL_CLOCK_COLUMNS)) for folder in (made, out)]
    pd.testing.assert_frame_equal(*tables)
    assert all(taxinet('bag', 'doctor', bag).returncode == 0 for bag in bags(out))
    assert taxinet('doctor', out).returncode == 0


def test_given_a_store_that_fails_then_the_campaign_goes_on_and_the_line_says_how_to_store_it(
    tmp_path
):
    far = tmp_path / 'far'
    far.mkdir()
    (far / 'search').write_text('a file where the folder has to be')
    done = taxinet(*SEARCH, '--out', tmp_path / 'search', '--store', f'file://{far}')
    assert (done.returncode, done.stderr.count('\n')) == (4, 1), done.stderr
    assert f'continue with: taxinet bag store {tmp_path}/search file://{far}' in done.stderr
    assert all((bag / f'{bag.name}_0.mcap').is_file() for bag in bags(tmp_path / 'search'))
    (far / 'search').unlink()
    again = taxinet('bag', 'store', tmp_path / 'search', f'file://{far}')
    assert (again.returncode, again.stdout) == (
        0, f'3 bags in file://{far}/search/, 3 uploaded now\n'
    )


@pytest.mark.parametrize(('store', 'said'), [
    ('s3://user:hunter2@bucket/x', 'must not contain credentials'), ('bags', 'expected an address'),
])
def test_given_a_bad_address_then_nothing_is_begun(store, said, tmp_path):
    done = taxinet(*SEARCH, '--out', tmp_path / 'c', '--store', store)
    assert (done.returncode, done.stderr.count('\n')) == (2, 1)
    assert said in done.stderr
    assert 'hunter2' not in done.stderr
    assert not (tmp_path / 'c').exists()
