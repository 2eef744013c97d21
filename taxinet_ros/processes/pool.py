"""Pool of worker processes for functions that make no runs; ends with its parent.

Workers are spawned, because the threads of torch and onnxruntime do not survive a fork.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any, ParamSpec, TypeVar

from taxinet_ros.errors import InfraError, InfraKind

_T = TypeVar('_T')
_P = ParamSpec('_P')

SPAWN = multiprocessing.get_context('spawn')
"""Context that creates the events and queues shared with the workers."""


class ProcessPool(ProcessPoolExecutor):
    """Process pool whose workers ignore Ctrl-C: the parent handles it and ends them."""

    def submit(
        self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs
    ) -> Future[_T]:
        """Call a function in a worker; the first call starts the workers."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def process_pool(
    workers: int | None, name: str, start: Callable[..., object] | None = None, *arguments: Any
) -> Iterator[ProcessPool]:
    """Context with worker processes that call functions; pending calls are dropped at its end.

    Args:
        workers: number of workers; None for the number of cores.
        name: name of a worker, for the message if it dies.
        start: function called first in each worker.
        arguments: arguments of ``start``.

    Raises:
        InfraError: a worker died.
    """
    with ProcessPool(workers, SPAWN, _begin_worker, (start, *arguments)) as pool:
        try:
            yield pool
        except BrokenProcessPool as error:
            raise InfraError(InfraKind.DIED, name, -1, 'see the messages above') from error
        finally:
            pool.shutdown(cancel_futures=True)


def _begin_worker(start: Callable[..., object] | None, *arguments: Any) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if start is not None:
        start(*arguments)


def _end_with_parent() -> None:
    """End this worker when its parent has died; a killed parent cannot stop it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
