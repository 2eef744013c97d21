"""What every test shares: strict messages, discovery on this machine only, no leftovers."""

from __future__ import annotations

import collections
import gc
import os
import signal
import sys

import forkserver
import psutil
import pytest
from hypothesis import HealthCheck, settings

import taxinet_ros  # noqa: F401 (before numpy, which it restricts)

os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
# How often a command says how far it is depends on how busy the machine is.
os.environ['TAXINET_HEARTBEAT_S'] = '0'

# A shell that starts tests in the background has them, and all that they start, ignore Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

forkserver.install()

# How long an example takes is the machine's affair; pytest's timeout ends what hangs. Examples are
# the same each time, so that a change is judged by itself; --hypothesis-profile=search draws
# others.
TIMELESS = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile('same', TIMELESS, derandomize=True)
settings.register_profile('search', TIMELESS)
settings.load_profile('same')


# All that a worker collects stays: six thousand tests, and what they import. To look for garbage in
# it takes a fifth of the time, and as much again each time later.
if 'PYTEST_XDIST_WORKER' in os.environ:
    gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Three at once for two cores: those that start processes wait for them much of their time."""
    return (3 * (psutil.cpu_count() or 1) + 1) // 2


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave cases to the nightly tier, and begin the files with long tests first.

    Lest one of them is left for the end.
    """
    cases = collections.Counter[str]()
    for item in items:
        for marker in item.iter_markers('one_in'):
            function = item.nodeid.partition('[')[0]
            if cases[function] % marker.args[0]:
                item.add_marker('nightly')
            cases[function] += 1
    long = {item.path for item in items for _ in item.iter_markers('ros')}
    items.sort(key=lambda item: item.path not in long)


@pytest.fixture
def taxinet(monkeypatch, capfd, tmp_path):
    """Call the command in an empty folder; exit code, output, complaints."""
    from taxinet_ros.cli.main import main

    monkeypatch.chdir(tmp_path)

    def call(*words) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, 'argv', ['taxinet', *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
        out, err = capfd.readouterr()
        return int(end.value.code or 0), out, err

    return call
