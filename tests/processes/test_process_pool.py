from __future__ import annotations

import os
import signal

import pytest

from taxinet_ros.errors import InfraError
from taxinet_ros.processes.pool import process_pool


def interrupt_is_blocked(_: int) -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_given_a_pool_then_answers_come_in_order_from_workers_deaf_to_ctrl_c() -> None:
    with process_pool(2, 'worker') as pool:
        assert list(pool.map(abs, [-3, -1, 2])) == [3, 1, 2]
        assert all(pool.map(interrupt_is_blocked, range(4)))
    assert not interrupt_is_blocked(0)


def test_given_a_start_then_it_is_called_first_in_every_worker() -> None:
    with process_pool(1, 'worker', os.chdir, '/') as pool:
        assert pool.submit(os.getcwd).result() == '/'


def test_given_a_worker_that_dies_then_the_bench_has_failed() -> None:
    with pytest.raises(InfraError, match='died: judging worker: see the messages above'), \
            process_pool(1, 'judging worker') as pool:
        pool.submit(die, 0).result()
