"""Many recorded runs judged, by several processes; how many does not show in the result."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import repeat
from pathlib import Path

from taxinet_ros.bag.judged_bag import JudgedBag, judge_runs
from taxinet_ros.core.errors import InfraError
from taxinet_ros.core.mtl import Assumptions, Spec
from taxinet_ros.core.pool_workers import end_with_parent, interrupts_blocked

_CHUNK = 8
"""Bags handed to a process at a time; fewer than two chunks are not worth starting one."""


def judge_bags(
    paths: Sequence[Path], specs: Sequence[Spec], workers: int,
    assumptions: Assumptions | None = None,
) -> Iterator[JudgedBag]:
    """Judge bags, see :func:`.judged_bag.judge_runs`, all runs of each, in their paths' order.

    Args:
        paths: run folders or ``.mcap`` files.
        specs: requirements; where empty, those that judged each run.
        workers: processes to do it in; 1 is this one.
        assumptions: what is vouched for; where None, what was when a run was made.

    Raises:
        UsageError: there is nothing at a path.
        InfraError: a worker process died.
    """
    if workers == 1 or len(paths) < 2 * _CHUNK:
        for path in paths:
            yield from judge_runs(path, specs, assumptions)
        return
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(workers, context, end_with_parent) as pool:
        try:
            with interrupts_blocked():
                answers = pool.map(
                    judge_runs, paths, repeat(tuple(specs)), repeat(assumptions), chunksize=_CHUNK
                )
            for runs in answers:
                yield from runs
        except BrokenProcessPool as error:
            raise InfraError('died', 'judging worker', -1, 'see the messages above') from error
        finally:
            pool.shutdown(cancel_futures=True)
