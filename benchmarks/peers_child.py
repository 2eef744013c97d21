"""Measure third-party monitors in their own environment, for :mod:`monitors`.

Started by its path, in a Python that need not have taxinet_ros, and imports nothing of it. It reads
one JSON line ``{"times_s": [...], "cte_m": [...], "formulas": {name: [text, windowed]}}`` and
answers the names that it can measure; then it answers each name read with the nanoseconds of a
call.
"""

from __future__ import annotations

import functools
import importlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any

Job = Callable[[], object]


def rtamt_jobs(trace: dict[str, Any]) -> dict[str, Job]:
    """rtamt, discrete time, offline; a specification can be used for one trace only."""
    rtamt = importlib.import_module('rtamt')

    def evaluate(text: str) -> None:
        spec = rtamt.StlDiscreteTimeSpecification()
        spec.declare_var('cte', 'float')
        spec.set_sampling_period(100, 'ms', 0.1)
        spec.spec = text
        spec.parse()
        spec.evaluate({'time': list(trace['times_s']), 'cte': list(trace['cte_m'])})

    return {
        f'rtamt {name} offline': functools.partial(evaluate, text)
        for name, (text, _) in trace['formulas'].items()
    }


def sentil_jobs(trace: dict[str, Any]) -> dict[str, Job]:
    """SENTIL, offline, and its online monitor, which never resolves an unbounded formula."""
    sentil = importlib.import_module('sentil')
    jobs: dict[str, Job] = {}

    def evaluate(formula: Any) -> None:
        samples = sentil.Trace(trace['times_s'], {'cte': trace['cte_m']})
        sentil.Monitor(formula).robustness(samples)

    def follow(formula: Any) -> None:
        monitor = sentil.OnlineMonitor(formula)
        for time_s, cte_m in zip(trace['times_s'], trace['cte_m'], strict=True):
            monitor.update(time_s, {'cte': cte_m})

    for name, (text, _) in trace['formulas'].items():
        formula = sentil.parse(text.replace(':', ','))
        jobs[f'sentil {name} offline'] = functools.partial(evaluate, formula)
        jobs[f'sentil {name} run online'] = functools.partial(follow, formula)
    return jobs


def mtl_jobs(trace: dict[str, Any]) -> dict[str, Job]:
    """metric-temporal-logic, the tool of the paper, whose windows are half open."""
    mtl = importlib.import_module('mtl')
    samples = zip(trace['times_s'], trace['cte_m'], strict=True)
    near = [(time_s, 1.5 - abs(cte_m)) for time_s, cte_m in samples]
    return {
        f'py-mtl {name} offline': functools.partial(
            mtl.parse(windowed), {'near': near}, quantitative=True
        )
        for name, (_, windowed) in trace['formulas'].items()
    }


def main() -> None:
    """Serve until the input ends."""
    trace = json.loads(sys.stdin.readline())
    jobs: dict[str, Job] = {}
    for make in (rtamt_jobs, sentil_jobs, mtl_jobs):
        try:
            jobs.update(make(trace))
        except ImportError:
            continue
    print(json.dumps(list(jobs)), flush=True)
    for line in sys.stdin:
        job = jobs[line.strip()]
        start = time.perf_counter_ns()
        job()
        print(time.perf_counter_ns() - start, flush=True)


if __name__ == '__main__':
    main()
