"""What makes a machine unfit for a campaign, and what is no cluster at all."""

from __future__ import annotations

import contextlib
import dataclasses
import http.server
import socket
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import distributed
import distributed.utils
import falsify_samples as toy
import psutil
import pytest
from dask_processes import free_port
from waiting import wait_for

import taxinet_ros
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.cluster import pool
from taxinet_ros.trials.cluster.machine import (
    OUT,
    PYTHON,
    code_digest,
    describe,
    difference,
    ignored_facts,
)
from taxinet_ros.trials.cluster.pool import campaign_cluster, check_cluster, connection
from taxinet_ros.trials.cluster.task import Job, check_worker, run_task
from taxinet_ros.trials.options import GRAPH, CampaignOptions

HERE = {
    **provenance(), 'instructions': 'x86-64-v3', 'processor_features': 'avx2 fma avx512f',
    'files of taxinet_ros': 'c' * 64, 'perception taxinet': 'a' * 64, 'world kmwh': '',
}


def campaign(**changes: object) -> CampaignOptions:
    made = toy.options(Path('out')).campaign
    return dataclasses.replace(made, **{'perception': 'taxinet', **changes})


@pytest.mark.parametrize(('changes', 'named'), [
    ({'instructions': 'without AVX2'}, 'instructions without AVX2, here x86-64-v3'),
    ({'python': '3.12.1'}, f'python 3.12.1, here {HERE["python"]}'),
    ({'libc': 'glibc 2.31'}, f'libc glibc 2.31, here {HERE["libc"]}'),
    ({'numpy': ''}, f'numpy missing, here {HERE["numpy"]}'),
    ({'taxinet_ros': '9.9'}, f'taxinet_ros 9.9, here {HERE["taxinet_ros"]}'),
    ({'plugins': 'theirs 1.0'}, 'plugins theirs 1.0, here missing'),
    ({'environment': 'GLIBC_TUNABLES=x'}, 'environment GLIBC_TUNABLES=x, here missing'),
    ({'files of taxinet_ros': 'd' * 64},
     f'files of taxinet_ros {"d" * 64}, here {"c" * 64}'),
    ({'perception taxinet': 'b' * 64}, f'perception taxinet {"b" * 64}, here {"a" * 64}'),
    ({'world kmwh': 'b' * 64}, f'world kmwh {"b" * 64}, here missing'),
    ({'processor': 'another', 'processor_features': 'avx2 fma', 'pixels': 'avx2'}, ''),
    ({'commit': '0' * 40}, ''),
])
def test_given_another_machine_then_the_first_difference_that_counts_is_named(changes, named):
    assert difference(HERE, {**HERE, **changes}, ignored_facts(campaign())) == named


ROS, FEATURES = {'rclpy', 'ros-fastrtps'}, {'processor_features'}


@pytest.mark.parametrize(('changes', 'ignored'), [
    ({'perception': 'taxinet'}, ROS | FEATURES), ({'perception': 'truth'}, ROS | FEATURES),
    ({'perception': 'some.safetensors'}, ROS | FEATURES),
    ({'perception': 'their.onnx'}, ROS), ({'perception': 'my_file.py:look'}, ROS),
    ({'engine': GRAPH}, FEATURES), ({'audit_percent': 1.0}, FEATURES),
    ({'audit_percent': 1.0, 'bags': False}, ROS | FEATURES),
])
def test_given_runs_whose_bits_do_not_depend_on_ros_or_processor_then_these_may_differ(
    changes, ignored
):
    """A network of one's own may round by the processor; runs of the loop need no ROS."""
    chosen = campaign(**{'engine': 'loop', 'audit_percent': 0.0, **changes})
    assert ignored_facts(chosen) & (ROS | FEATURES) == ignored


def test_given_a_changed_new_or_renamed_file_then_the_code_is_another(tmp_path):
    digests = set()
    for names in (['a.py'], ['b.py'], ['a.py', 'b.py'], ['a.py', 'c.so', 'd.pyc']):
        folder = tmp_path / str(len(digests)) / '-'.join(names)
        folder.mkdir(parents=True)
        for name in names:
            (folder / name).write_text('x = 1\n')
        digests.add(code_digest(folder))
    assert len(digests) == 3  # what is compiled does not count
    assert code_digest(Path(taxinet_ros.__file__).parent) not in digests


def test_given_this_machine_then_it_describes_itself_and_lacks_an_unknown_network():
    """In a process that starts as runs do; this is what every worker does first."""
    parts = ['truth', 'steering', '{}', 'kmwh']
    described = describe(parts, None)
    assert described.items() >= provenance().items()
    assert (described['perception truth'], described['instructions']) == ('', 'x86-64-v3')
    assert len(described['files of taxinet_ros']) == 64
    with pytest.raises(UsageError, match=r'gone\.safetensors: no such file'):
        describe(['gone.safetensors', *parts[1:]], None)


def test_given_a_worker_then_it_is_checked_and_its_child_lives_as_long_as_the_check(
    tmp_path, monkeypatch
):
    monkeypatch.setattr('taxinet_ros.trials.cluster.task.describe', lambda parts, folder: HERE)
    job = Job(
        campaign='c', folder=tmp_path, bags=None,
        command=[PYTHON, str(Path(__file__).with_name('toy_worker.py')), OUT, str(tmp_path)],
    )
    request = RunRequest(
        run_id='r', index=0, program='', seed=0, scenario=Scenario(cross_track_m=3.0),
        judging=Judging(specs=('always(abs(cte) <= 1)',)), participants=(),
    )

    def children() -> list[psutil.Process]:
        found = []
        for one in psutil.Process().children():
            with contextlib.suppress(psutil.Error):  # it has just ended
                found += [one] * ('toy_worker' in str(one.cmdline()))
        return found

    with connection('local:1', print) as client:
        def checked(here: dict[str, str], probe: Path) -> distributed.Future:
            future = client.submit(check_worker, job, [], here, ['commit'], probe, pure=False)
            wait_for(future.done)
            return future

        unfit = checked({**HERE, 'python': '2'}, tmp_path).exception()
        assert str(unfit) == f'python {HERE["python"]}, here 2'
        blind = checked(HERE, tmp_path / 'gone' / 'probe').exception()
        assert str(blind).startswith(f'does not see {tmp_path}/gone, where the bags go')
        lease = checked({**HERE, 'commit': 'another'}, tmp_path)
        assert lease.status == 'finished'
        result, bag, record = client.submit(run_task, job, request, pure=False).result()
        assert (result.outcome, bag, record) == (
            Outcome.PASS, None, {name: HERE[name] for name in provenance()}
        )
        assert len(children()) == 1
        del lease
        wait_for(lambda: not children())


def test_given_local_workers_then_nobody_elsewhere_can_reach_them_and_nothing_is_left(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    parse = distributed.utils._parse_timedelta
    monkeypatch.setattr(  # of the second from which on Dask warns of slow folders
        distributed.utils, '_parse_timedelta',
        lambda text, *more: -1.0 if text == '1s' else parse(text, *more),
    )
    with campaign_cluster(campaign(out=tmp_path / 'out'), 'local:2') as cluster:
        assert cluster.threads == 2
        listening = {
            one.laddr.ip for one in psutil.Process().net_connections()
            if one.status == psutil.CONN_LISTEN
        }
        assert listening <= {'127.0.0.1', '::1'}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(('where', 'content', 'named'), [
    *((where, None, 'expected local:N') for where in ('local:0', 'local:', 'local:x')),
    ('local:9999', None, r'within 1\.\.256'),
    *((where, None, 'expected tcp://HOST:PORT') for where in (
        'tcp://host', 'tcp://host:0', 'tcp://host:99999', 'http://host:80', 'tcp://a b:1',
    )),
    ('no/such/file', None, 'No such file'), ('.', None, 'Is a directory'),
    *(('file', text, 'no scheduler file') for text in ('', 'x', '[]', '{}')),
    *(('file', text, 'expected tcp') for text in ('{"address": 7}', '{"address": "x"}')),
])
def test_given_no_address_of_a_cluster_then_it_is_refused(
    where, content, named, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path(where).write_text(content)
    with pytest.raises(UsageError, match=rf'cluster {where}.*{named}'):
        check_cluster(where)


@pytest.fixture
def strangers() -> Iterator[list[int]]:
    """Ports at which something else answers, nothing does, or nobody listens."""
    web = http.server.ThreadingHTTPServer(('127.0.0.1', 0), http.server.BaseHTTPRequestHandler)
    threading.Thread(target=web.serve_forever, daemon=True).start()
    with socket.create_server(('127.0.0.1', 0)) as quiet:
        yield [web.server_port, quiet.getsockname()[1], free_port()]
    web.shutdown()
    web.server_close()


def test_given_an_address_without_a_scheduler_then_that_is_said_and_nothing_is_begun(
    strangers, tmp_path, monkeypatch
):
    monkeypatch.setattr(pool, '_CONNECT_S', 0.5)
    for port in strangers:
        where = f'tcp://127.0.0.1:{port}'
        named = rf'cluster {where}: no Dask scheduler answers there'
        with (
            pytest.raises(UsageError, match=named),
            campaign_cluster(campaign(out=tmp_path / 'out'), where),
        ):
            pass
    assert list(tmp_path.iterdir()) == []
