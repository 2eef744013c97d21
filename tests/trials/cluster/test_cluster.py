"""A campaign on a cluster of processes: the rows of the local pool, whatever happens to workers."""

from __future__ import annotations

import gc
import re
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import dask.config
import falsify_samples as toy
import psutil
import pytest
import yaml
from dask_processes import DaskProcesses, kill

import taxinet_ros
from taxinet_ros.core.provenance import provenance
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.cluster import pool
from taxinet_ros.trials.cluster.machine import OUT
from taxinet_ros.trials.cluster.pool import campaign_cluster, check_cluster
from taxinet_ros.trials.engine import Engine, run_search
from taxinet_ros.trials.record.facts import STACKS, read_facts
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.search import Search
from taxinet_ros.trials.worker_pool import WorkerPool

pytestmark = [
    pytest.mark.nightly,
    # Dask leaves a socket unclosed where a scheduler dies while it connects.
    pytest.mark.filterwarnings('ignore:unclosed <socket:ResourceWarning'),
]
TOY = Path(__file__).with_name('toy_worker.py')
SCALING = Path(__file__).parents[3] / 'docs' / 'scaling.md'
# Key and certificate, signed by itself, for these tests only:
# openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 36500
CERTIFICATE = Path(__file__).parents[2] / 'data' / 'tls.pem'
RUNS = 40
Acts = dict[int, Callable[[Engine[Search]], object]]


@pytest.fixture(autouse=True, scope='module')
def _sockets() -> Iterator[None]:
    yield
    gc.collect()  # of what Dask has left here, no later test is told


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)


@pytest.fixture(scope='module')
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskProcesses]:
    """A cluster of two workers, which tests leave as they found it."""
    with DaskProcesses(tmp_path_factory.mktemp('dask')) as started:
        started.add_worker()
        started.add_worker()
        yield started


@pytest.fixture
def here(tmp_path: Path) -> Callable[..., Path]:
    """What makes the campaign with the local pool, for comparison."""
    def make(out: Path = tmp_path / 'here', **changes: Any) -> Path:
        chosen = options(out, **changes)
        with Engine(chosen, ('perception',)) as search, WorkerPool(
            [sys.executable, str(TOY), str(out), str(tmp_path)], min(2, chosen.lag), out / 'logs',
        ) as pool:
            run_search(search, pool)
        return out

    return make


def options(out: Path, **changes: Any) -> Search:
    return toy.options(out, **{'runs': RUNS, **changes})


def there(
    where: str, out: Path, told: list[str], acts: Acts | None = None, **changes: Any
) -> Engine[Search]:
    """Make the campaign on a cluster."""
    chosen = options(out, cluster=where, **changes)
    acts, kept = acts or {}, list[int]()

    def on_row(row: RunRow) -> None:
        kept.append(row.index)
        for act in [acts.pop(n) for n in list(acts) if len(search.rows) >= n]:
            act(search)

    with (
        campaign_cluster(chosen.campaign, where, tell=told.append) as cluster,
        Engine(chosen, ('perception',), on_row) as search,
        cluster.making(
            [sys.executable, str(TOY), OUT, str(out.parent)], search.book.facts,
            search.book.add_machine,
        ),
    ):
        run_search(search, cluster)
    assert acts == {}
    assert len(kept) == len(set(kept)), 'each run has one result'
    return search


def check_whole(out: Path, other: Path) -> None:
    """Every run has its bag, as in the other campaign, and nothing is left over."""
    toy.same_table(out, other)
    bags = {path.parent.name for path in out.glob('*/bag')}
    assert bags == set(read_table(out).query("outcome != 'REJECTED'")['run_id'])
    assert not (out / 'logs' / 'cluster').exists() or not list(out.glob('logs/cluster/*/*/bag'))


@pytest.mark.parametrize('changes', [
    {'sampler': 'ce'},
    {'sampler': 'ce', 'lag': 3},
    {'sampler': 'halton'},
], ids=['adaptive', 'another lag', 'by index'])
def test_given_a_cluster_then_it_makes_the_rows_of_the_local_pool(
    processes, here, tmp_path, changes
):
    told: list[str] = []
    there(processes.address, tmp_path / 'there', told, **changes)
    check_whole(tmp_path / 'there', here(**changes))
    assert told == []
    assert list(read_facts(tmp_path / 'there')[STACKS].values()) == [dict(provenance())]


def test_given_a_scheduler_file_and_an_interrupt_then_a_pool_here_goes_on(
    processes, here, tmp_path
):
    file, pace, out = tmp_path / 'scheduler.json', tmp_path / 'pace', tmp_path / 'there'
    file.write_text(f'{{"address": "{processes.address}"}}')
    pace.write_text('0.05')
    ended = there(check_cluster(str(file)), out, [], {12: Engine.interrupt})
    assert ended.interrupted
    running = [one.info['cmdline'] or [] for one in psutil.process_iter(['cmdline'])]
    assert not [words for words in running if str(tmp_path) in words]
    assert not (out / 'logs' / 'cluster').exists()
    assert 12 <= len(read_table(out)) < RUNS
    assert set(read_table(out)['outcome']) <= {'PASS', 'FAIL', 'REJECTED'}
    pace.unlink()
    check_whole(here(out, resume=True), here())


def test_given_two_campaigns_at_once_then_each_has_its_own_rows(processes, here, tmp_path):
    outs = [tmp_path / 'one', tmp_path / 'two']
    (tmp_path / 'pace').write_text('0.01')
    failed: list[BaseException] = []

    def make(out: Path) -> None:
        try:
            there(processes.address, out, [])
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=make, args=(out,)) for out in outs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    whole = here()
    for out in outs:
        check_whole(out, whole)


def test_given_a_worker_and_a_child_killed_during_the_campaign_then_nothing_is_lost_or_doubled(
    processes, here, tmp_path
):
    """One of three workers is killed; and a child, in whose place its worker starts another."""
    (tmp_path / 'pace').write_text('0.2')  # it has two tasks when the first result comes
    third = processes.add_worker()
    told: list[str] = []
    (tmp_path / 'deadly-38').write_text('')
    search = there(
        processes.address, tmp_path / 'there', told, {1: lambda search: kill(third)},
        sampler='halton',
    )
    assert told == []
    retried = [row.index for row in search.rows if row.retries]
    assert retried == [38]
    (tmp_path / 'pace').unlink()
    (tmp_path / 'deadly-38').write_text('')
    check_whole(tmp_path / 'there', here(sampler='halton'))


def test_given_a_scheduler_that_dies_then_the_campaign_ends_and_another_cluster_goes_on(
    here, tmp_path
):
    """The other one, too, has one worker, and loses it to another."""
    (tmp_path / 'dask').mkdir()
    (tmp_path / 'pace').write_text('0.03')
    out = tmp_path / 'there'
    with DaskProcesses(tmp_path / 'dask') as processes:
        processes.add_worker()
        with pytest.raises(InfraError, match=r'cluster tcp.* lost .*; resume it: all'):
            there(
                processes.address, out, [], {8: lambda search: kill(processes.scheduler)},
                sampler='halton',
            )
    assert 8 <= len(read_table(out)) < RUNS
    with DaskProcesses(tmp_path / 'dask') as processes:
        only = processes.add_worker()

        def replace(search: Search) -> None:
            time.sleep(0.2)  # with results that have come and are not taken, and runs that wait
            kill(only)
            time.sleep(0.2)
            processes.add_worker()

        there(processes.address, out, [], {20: replace}, sampler='halton', resume=True)
    (tmp_path / 'pace').unlink()
    check_whole(out, here(sampler='halton'))


def test_given_workers_that_would_make_other_runs_then_they_are_named_and_get_none(
    processes, here, tmp_path
):
    """One has a file of the program changed, the other a library without some instructions."""
    other = tmp_path / 'elsewhere' / 'taxinet_ros'
    package = Path(taxinet_ros.__file__).parent
    shutil.copytree(package, other, ignore=shutil.ignore_patterns('__pycache__'))
    changed = other / 'core' / 'topics.py'
    changed.write_text(changed.read_text() + '# changed\n')
    strange = [
        processes.add_worker(PYTHONPATH=str(other.parent)),
        processes.add_worker(NPY_DISABLE_CPU_FEATURES='X86_V3 X86_V4 AVX512_ICL AVX512_SPR'),
    ]
    told: list[str] = []
    (tmp_path / 'pace').write_text('0.1')
    try:
        there(processes.address, tmp_path / 'there', told, sampler='halton')
    finally:
        for process in strange:
            kill(process)
    assert len(told) == 2, told
    assert sum('files of taxinet_ros' in line for line in told) == 1, told
    assert sum('numpy_features X86_V2' in line for line in told) == 1, told
    assert all(line.endswith('; it gets no runs') for line in told)
    (tmp_path / 'pace').unlink()
    check_whole(tmp_path / 'there', here(sampler='halton'))


def test_given_a_client_that_asks_the_scheduler_by_itself_then_no_worker_seems_to_have_left(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(pool, '_LOOK_S', 0.0)
    campaign = options(tmp_path / 'there', cluster='local:2').campaign
    often = {'distributed.client.scheduler-info-interval': '1ms'}
    with dask.config.set(often), campaign_cluster(campaign, 'local:2') as cluster:
        for _ in range(300):
            assert cluster.answers(0.0) == []
            assert cluster.threads == 2


def test_given_weights_that_change_on_a_worker_then_it_gets_no_more_runs(
    processes, tmp_path, monkeypatch
):
    told: list[str] = []
    out = tmp_path / 'there'
    (tmp_path / 'weights').write_text('0' * 64)
    chosen = options(out, cluster=processes.address)
    with (
        campaign_cluster(chosen.campaign, processes.address, tell=told.append) as cluster,
        Engine(chosen, ('perception',)) as search,
        cluster.making(
            [sys.executable, str(TOY), OUT, str(tmp_path)],
            {**search.book.facts, 'perception_sha256': '1' * 64},
        ),
    ):
        monkeypatch.setattr(pool, '_PATIENCE_S', 5.0)  # under load a worker takes a second
        with pytest.raises(InfraError, match='has another perception now'):
            run_search(search, cluster)
    assert len(told) == 2
    assert all('has another perception now (sha256 000000000000' in line for line in told)
    assert not [row for row in search.rows if row.outcome.judged]


def test_given_tls_by_dasks_own_configuration_then_only_who_has_a_certificate_takes_part(
    here, tmp_path, monkeypatch
):
    """As docs/scaling.md has it, with one certificate for all three."""
    for name in ('ca.pem', 'cert.pem', 'key.pem'):
        shutil.copy(CERTIFICATE, tmp_path / name)
    text = re.findall(r'```yaml\n(distributed:.*?)```', SCALING.read_text(), re.DOTALL)
    assert len(text) == 1
    configured = re.sub(r'/etc/dask/(\w+\.pem)', rf'{tmp_path}/\1', text[0])
    config = tmp_path / 'dask.yaml'
    config.write_text(configured)
    (tmp_path / 'dask').mkdir()
    with DaskProcesses(tmp_path / 'dask', 'tls', DASK_CONFIG=str(config)) as cluster:
        cluster.add_worker()
        assert cluster.address.startswith('tls://')
        asked = dask.config.merge(dask.config.config, yaml.safe_load(configured))
        with dask.config.set(asked):
            there(cluster.address, tmp_path / 'there', [], sampler='halton')
        monkeypatch.setattr(pool, '_CONNECT_S', 1.0)
        for address in (cluster.address, cluster.address.replace('tls', 'tcp')):
            with pytest.raises(UsageError, match='no Dask scheduler answers there'):
                there(address, tmp_path / 'never', [])
    assert not (tmp_path / 'never').exists()
    check_whole(tmp_path / 'there', here(sampler='halton'))
