"""What makes a machine unfit for a campaign, and what is no cluster at all."""

from __future__ import annotations

import dataclasses
import http.server
import json
import os
import socket
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import distributed.utils
import psutil
import pytest
from dask_processes import free_port

import taxinet_ros
from taxinet_ros.core.provenance import provenance
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.cluster import connection
from taxinet_ros.trials.cluster.connection import Cluster, check_cluster
from taxinet_ros.trials.cluster.machine import (
    Machine,
    Needs,
    code_digest,
    describe,
    difference,
    to_json,
)
from taxinet_ros.trials.cluster.task import Job, check_worker

NEEDS = Needs(
    perception='taxinet', controller='steering', gains={}, world='kmwh', graph=True,
    folder=os.getcwd(),
)
HERE = Machine(
    record={**provenance(), 'processor_features': 'avx2 fma avx512f'}, code='c' * 64, lacking='',
    parts={'perception': 'a' * 64, 'controller': '', 'world': ''},
)


def with_record(**changes: str) -> Machine:
    record = {name: value for name, value in {**HERE.record, **changes}.items() if value}
    return dataclasses.replace(HERE, record=record)


@pytest.mark.parametrize(('there', 'named'), [
    (dataclasses.replace(HERE, lacking='AVX2'),
     'processor class: its processor lacks AVX2, the one here has all of x86-64-v3'),
    (with_record(python='3.12.1'), f'python 3.12.1, here {HERE.record["python"]}'),
    (with_record(libc='glibc 2.31'), f'libc glibc 2.31, here {HERE.record["libc"]}'),
    (with_record(numpy=''), f'numpy missing, here {HERE.record["numpy"]}'),
    (with_record(taxinet_ros='9.9'), f'taxinet_ros 9.9, here {HERE.record["taxinet_ros"]}'),
    (with_record(plugins='theirs 1.0'), 'plugins theirs 1.0, here missing'),
    (with_record(environment='GLIBC_TUNABLES=x'),
     'environment GLIBC_TUNABLES=x, here missing'),
    (dataclasses.replace(HERE, code='d' * 64),
     'taxinet_ros of other files (dddddddddddd…, here cccccccccccc…)'),
    (dataclasses.replace(HERE, parts={**HERE.parts, 'perception': 'b' * 64}),
     'perception taxinet is bbbbbbbbbbbb…, here aaaaaaaaaaaa…'),
    (dataclasses.replace(HERE, parts={**HERE.parts, 'world': 'b' * 64}),
     'world kmwh is bbbbbbbbbbbb…, here none…'),
])
def test_given_another_machine_then_the_first_difference_is_named(there, named):
    assert difference(HERE, there, NEEDS) == named


@pytest.mark.parametrize('there', [
    HERE, with_record(processor='another', processor_features='avx2 fma', pixels='avx2'),
    with_record(commit='0' * 40),
])
def test_given_what_changes_no_bit_then_the_machine_is_fit(there):
    assert difference(HERE, there, NEEDS) == ''


def test_given_a_network_whose_bits_depend_on_the_processor_then_its_features_must_be_the_same():
    there = with_record(processor_features='avx2 fma')
    for word, named in (
        ('taxinet', ''), ('some.safetensors', ''), ('truth', ''),
        ('their.onnx', 'processor_features avx2 fma, here avx2 fma avx512f'),
        ('my_file.py:look', 'processor_features avx2 fma, here avx2 fma avx512f'),
    ):
        assert difference(HERE, there, dataclasses.replace(NEEDS, perception=word)) == named


def test_given_runs_without_ros_then_a_machine_need_not_have_it():
    there = with_record(rclpy='')
    assert difference(HERE, there, dataclasses.replace(NEEDS, graph=False)) == ''
    assert difference(HERE, there, NEEDS).startswith('rclpy missing, here ')


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


def test_given_this_machine_then_it_describes_itself_and_misses_a_folder_or_a_network(tmp_path):
    """In a process that starts as runs do; this is what every worker does first."""
    needs = to_json(dataclasses.replace(NEEDS, perception='truth'))
    described = describe(needs)
    assert described.record == provenance()
    assert described.parts == {'perception': '', 'controller': '', 'world': ''}
    job = Job(campaign='c', needs=needs, here=to_json(described))
    assert json.loads(check_worker(json.dumps(dataclasses.asdict(job)))) == {
        'unfit': '', 'record': {},
    }
    probe = tmp_path / 'probe'
    for text, seen in (('other', False), ('right', True)):
        probe.write_text(text)
        asked = dataclasses.replace(job, probe=(str(probe), 'right'))
        told = json.loads(check_worker(json.dumps(dataclasses.asdict(asked))))
        assert told['unfit'] == ('' if seen else (
            f'does not see {tmp_path}, where the bags go; use an --out that all machines share'
        ))
    with pytest.raises(UsageError, match=r'gone\.safetensors'):
        describe(to_json(dataclasses.replace(NEEDS, perception='gone.safetensors')))


def test_given_local_workers_then_nobody_elsewhere_can_reach_them_and_nothing_is_left(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    needs = dataclasses.replace(NEEDS, perception='truth')
    with Cluster('local:2', needs, out=tmp_path / 'out') as cluster:
        assert cluster.threads == 2
        listening = {
            one.laddr.ip for one in psutil.Process().net_connections()
            if one.status == psutil.CONN_LISTEN
        }
        assert listening <= {'127.0.0.1', '::1'}
    assert list(tmp_path.iterdir()) == []


def test_given_a_machine_that_is_slow_to_make_folders_then_dask_s_warning_reaches_nobody(
    tmp_path, monkeypatch
):
    parse = distributed.utils._parse_timedelta
    monkeypatch.setattr(  # of the second from which on Dask warns
        distributed.utils, '_parse_timedelta',
        lambda text, *more: -1.0 if text == '1s' else parse(text, *more),
    )
    needs = dataclasses.replace(NEEDS, perception='truth')
    with Cluster('local:1', needs, out=tmp_path / 'out') as cluster:
        assert cluster.threads == 1


@pytest.mark.parametrize(('where', 'named'), [
    ('local:0', 'expected local:N'), ('local:', 'expected local:N'), ('local:x', 'expected'),
    ('local:9999', r'within 1\.\.256'), ('tcp://host', 'expected tcp://HOST:PORT'),
    ('tcp://host:0', 'expected tcp'), ('tcp://host:99999', 'expected tcp'),
    ('http://host:80', 'expected tcp'), ('tcp://a b:1', 'expected tcp'),
    ('no/such/file', 'No such file'), ('.', 'Is a directory'),
])
def test_given_no_address_of_a_cluster_then_it_is_refused(where, named):
    with pytest.raises(UsageError, match=rf'--cluster {where}.*{named}'):
        check_cluster(where)


@pytest.mark.parametrize('content', ['', 'x', '[]', '{}', '{"address": 7}', '{"address": "x"}'])
def test_given_a_file_that_is_no_scheduler_file_then_it_is_refused(content, tmp_path):
    file = tmp_path / 'scheduler.json'
    file.write_text(content)
    with pytest.raises(UsageError, match=r'no scheduler file|expected tcp'):
        check_cluster(str(file))


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
    monkeypatch.setattr(connection, '_CONNECT_S', 0.5)
    for port in strangers:
        where = f'tcp://127.0.0.1:{port}'
        cluster = Cluster(where, NEEDS, out=tmp_path / 'out')
        named = rf'--cluster {where}: no Dask scheduler answers there'
        with pytest.raises(UsageError, match=named), cluster:
            pass
    assert list(tmp_path.iterdir()) == []
