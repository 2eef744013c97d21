"""An S3-compatible server in this process, and the local file system, as stores of bags."""

from __future__ import annotations

import contextlib
import os
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest

KEYS = {
    'AWS_ACCESS_KEY_ID': 'AKIATAXIWAY', 'AWS_SECRET_ACCESS_KEY': 'apron/secret+7',
    'AWS_DEFAULT_REGION': 'us-east-1', 'AWS_EC2_METADATA_DISABLED': 'true',
    'AWS_CONFIG_FILE': '/nonexistent', 'AWS_SHARED_CREDENTIALS_FILE': '/nonexistent',
}


@contextlib.contextmanager
def s3_server() -> Iterator[str]:
    """A server with one bucket ``taxi``, which the environment leads to; gives its address."""
    pytest.importorskip('s3fs', reason='the extra store is not installed')
    server = pytest.importorskip('moto.server', reason='moto is not installed')
    running = server.ThreadedMotoServer(ip_address='127.0.0.1', port=0, verbose=False)
    running.start()
    try:
        host, port = running.get_host_and_port()
        address = f'http://{host}:{port}'
        # What an earlier server of this process has been given is still there.
        urllib.request.urlopen(f'{address}/moto-api/reset', data=b'').close()
        with mock.patch.dict(os.environ, {**KEYS, 'AWS_ENDPOINT_URL': address}):
            import s3fs

            s3fs.S3FileSystem.clear_instance_cache()
            s3fs.S3FileSystem().mkdir('taxi')
            yield address
            s3fs.S3FileSystem.clear_instance_cache()
    finally:
        running.stop()


def local_store(folder: Path) -> str:
    """The address of a folder of this machine."""
    folder.mkdir(parents=True, exist_ok=True)
    return f'file://{folder}'
