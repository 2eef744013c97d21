"""Soak test: detect resource growth over many runs, or in a running process.

A sample counts memory, open files, threads and shared memory of a process and its descendants. A
robust slope through the samples after the warm-up shows whether one of them grows.
"""

from __future__ import annotations

import gc
import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from common import count, leave, make_table, options, page_console, positive

import cv2
import numpy as np
import psutil
from rich.console import Console
from scipy import stats

from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import ExitCode, InfraError, UsageError
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.processes.interrupts import interrupts

_SHARED = '/dev/shm/'


class Holdings(NamedTuple):
    """Resources held by one process, or by several together.

    Attributes:
        memory: resident memory [bytes]; shared memory counts in each process.
        files: number of open file descriptors.
        threads: number of threads.
        segments: number of distinct ``/dev/shm`` files mapped into memory; Fast DDS communicates
            through them.
        processes: number of processes.
    """

    memory: int
    files: int
    threads: int
    segments: int
    processes: int


def holdings(pid: int) -> Holdings | None:
    """Resources that a process and its descendants hold now; None once it has ended.

    Raises:
        UsageError: it belongs to another user, so Linux denies access.
    """
    try:
        process = psutil.Process(pid)
        if process.status() in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD):
            return None
        family = [process, *process.children(recursive=True)]
    except psutil.NoSuchProcess:
        return None
    found = [told for member in family if (told := _process_holdings(member)) is not None]
    if not found:
        return None
    memory, files, threads, names = zip(*found, strict=True)
    return Holdings(
        sum(memory), sum(files), sum(threads), len(frozenset[str]().union(*names)), len(found)
    )


def _process_holdings(process: psutil.Process) -> tuple[int, int, int, frozenset[str]] | None:
    """Memory, files, threads and shared-memory names of one process; None if it ends meanwhile."""
    try:
        with process.oneshot():
            shared = frozenset(
                part.path for part in process.memory_maps() if part.path.startswith(_SHARED)
            )
            return process.memory_info().rss, process.num_fds(), process.num_threads(), shared
    except psutil.NoSuchProcess:
        return None
    except psutil.AccessDenied:
        raise UsageError(
            f"--pid {process.pid}: is another user's, so Linux does not tell what it holds"
        ) from None


WARM_UP = 0.2
"""Initial share of the runs, or of the time, that is ignored because caches fill."""
LEAST_SAMPLES = 12
"""Minimum number of samples after the warm-up for a conclusion."""
MOST_SAMPLES = 400
"""Maximum number of samples kept; beyond it every other one is dropped, to bound the cost."""
FLAT, GROWS, UNSETTLED = 'flat', 'grows', 'too short to tell'


@dataclass(frozen=True, kw_only=True)
class Trend:
    """Trend of one quantity.

    Attributes:
        first, warm, last, most: values at the beginning, after the warm-up, at the end; maximum.
        slope: slope after the warm-up, per run or per second.
        growth: growth from the warm-up to the end by this slope.
        verdict: :data:`FLAT`, :data:`GROWS` or :data:`UNSETTLED`.
    """

    first: float
    warm: float
    last: float
    most: float
    slope: float
    growth: float
    verdict: str


class Series:
    """Samples along an axis, thinned evenly to bound their number."""

    def __init__(self) -> None:
        """Create an empty series."""
        self.at: list[float] = []
        self.rows: list[tuple[float, ...]] = []
        self._every = 1
        self._asked = 0

    def add(self, at: float, row: Sequence[float]) -> None:
        """Add a sample, unless it is one of those thinned out."""
        if self._asked % self._every == 0:
            self.at.append(at)
            self.rows.append(tuple(row))
        self._asked += 1
        if len(self.at) > MOST_SAMPLES:
            self.at, self.rows = self.at[::2], self.rows[::2]
            self._every *= 2


def trend(at: Sequence[float], values: Sequence[float], *, per_unit: float, once: float) -> Trend:
    """Compute the trend of one quantity.

    Args:
        at: runs or seconds, ascending, one or more.
        values: one value for each.
        per_unit: greatest slope that counts as flat.
        once: greatest growth that counts as flat, whatever the slope.
    """
    x, y = np.asarray(at, float), np.asarray(values, float)
    warm = x >= x[0] + WARM_UP * (x[-1] - x[0])
    x, y = x[warm], y[warm]
    # Theil-Sen estimator: the median slope between pairs of points, robust to a few outliers.
    slope = float(stats.theilslopes(y, x).slope) if x[-1] > x[0] else 0.0
    growth = slope * float(x[-1] - x[0])
    if len(x) < LEAST_SAMPLES:
        verdict = UNSETTLED
    else:
        verdict = GROWS if slope > per_unit and growth > once else FLAT
    return Trend(
        first=float(values[0]), warm=float(y[0]), last=float(y[-1]), most=float(max(values)),
        slope=slope, growth=growth, verdict=verdict,
    )


RUNS = 1000
DURATION_S = 3.0
"""Simulated length of a run [s]: short, since leaks occur per run or per step."""
SEED = 0
RUNS_PER_SAMPLE = 5
LEAST_PERIOD_S = 1.0
SAMPLES_WATCHED = 300
RUN, SECOND = 'run', 's'
"""Units of the sample axis: runs of our own graph, or seconds of a watched process."""
OBJECTS = 'python objects'
QUANTITIES = ('memory', 'files', 'threads', 'segments')
_FLAT_SLOPES = {
    RUN: {'memory': 1024.0, OBJECTS: 0.1},
    SECOND: {'memory': 10 * 2**20 / 3600},
}
"""Greatest slopes that count as flat; 0 for countable quantities."""
_FLAT_GROWTH = {'memory': 2.0**20, OBJECTS: 500.0}
"""Greatest growth that counts as flat; half of one for countable quantities."""
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Soak:
    """Result of a soak test.

    Attributes:
        what: description of what was tested.
        unit: :data:`RUN` or :data:`SECOND`.
        amount: number of these units.
        wall_s: duration [s].
        trends: by quantity: those of :class:`.Holdings`; for our own runs also Python objects.
        machine: facts of the machine.
        outcomes: number of our own runs by outcome.
        interrupted: whether it was stopped early.
    """

    what: str
    unit: str
    amount: float
    wall_s: float
    trends: dict[str, Trend]
    machine: dict[str, Any]
    outcomes: dict[str, int] = field(default_factory=dict)
    interrupted: bool = False
    samples: int = 0

    @property
    def verdict(self) -> str:
        """``grows`` if any quantity does, ``flat`` if all are, else ``too short to tell``."""
        verdicts = {trend.verdict for trend in self.trends.values()}
        if GROWS in verdicts or verdicts == {FLAT}:
            return GROWS if GROWS in verdicts else FLAT
        return next(iter(verdicts - {FLAT}))

    def report(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return {**asdict(self), 'verdict': self.verdict}


def soak_runs(
    runs: int, minutes: float | None, progress: Progress, duration_s: float = DURATION_S
) -> Soak:
    """Run short scenes one after the other through one composed graph in this process.

    OpenCV uses one thread from here on, for the rest of the process.

    Args:
        runs: number of runs.
        minutes: limit of wall time [min].
        progress: called with the number of runs done and their total.
        duration_s: simulated length of each run [s].

    Raises:
        InfraError: a run has no verdict.
    """
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory(prefix='taxinet-soak-') as folder:
        work = _Runs(runs, minutes, duration_s, Path(folder), progress)
        options = GraphOptions(perception='taxinet', out=work.bags, images='none')
        with composed_graph(options) as graph, interrupts(work.stop):
            work.interrupt = graph.interrupt
            graph.run(work.requests(), work.take)
    return work.found()


class _Runs:
    """The runs of a soak test, and the samples taken between them."""

    def __init__(
        self, runs: int, minutes: float | None, duration_s: float, bags: Path, progress: Progress
    ) -> None:
        self.bags = bags
        self.interrupt: Callable[[], None] = lambda: None
        self._runs = runs
        self._most_s = math.inf if minutes is None else minutes * 60
        self._duration_s = duration_s
        self._progress = progress
        self._begun = time.monotonic()
        self._series = Series()
        self._outcomes: dict[str, int] = {}
        self._done = 0
        self._stopped = False

    def stop(self) -> None:
        """End after the current run."""
        self._stopped = True
        self.interrupt()

    def requests(self) -> Iterator[RunRequest]:
        """Yield random scenes in the world of S_falsif."""
        rng = np.random.default_rng(SEED)
        for number in range(self._runs):
            yield RunRequest(
                run_id=f'soak-{number}', index=number, program='', seed=SEED,
                scenario=_scenario(rng, self._duration_s), participants=PARTICIPANTS,
                judging=Judging(specs=(SHIPPED['phi_eventually'].text,)),
            )

    def take(self, request: RunRequest, result: RunResult) -> bool:
        """Sample this process every few runs; return False to end the soak test."""
        shutil.rmtree(self.bags / request.run_id, ignore_errors=True)
        if self._stopped:
            return False
        if not result.outcome.judged:
            raise InfraError(result.kind, result.who, result.last_seq, result.detail)
        self._outcomes[result.outcome] = self._outcomes.get(result.outcome, 0) + 1
        self._done += 1
        if self._done % RUNS_PER_SAMPLE == 1:
            gc.collect()  # count only objects that cannot be freed
            held = holdings(os.getpid())
            assert held is not None
            self._series.add(self._done, (*held, len(gc.get_objects())))
        self._progress(self._done, self._runs)
        return time.monotonic() - self._begun < self._most_s

    def found(self) -> Soak:
        """Result so far.

        Raises:
            UsageError: it was stopped before its first run ended.
        """
        return _found(
            self._series, (*Holdings._fields, OBJECTS), RUN, self._done, self._begun,
            what=f'runs of {self._duration_s:g} s with the shipped network in one process',
            outcomes=dict(self._outcomes), interrupted=self._stopped,
        )


def watch(pid: int, minutes: float, progress: Progress) -> Soak:
    """Sample a running process and its descendants until the time is over or it has ended.

    Args:
        pid: id of the process.
        minutes: duration [min].
        progress: called with the seconds elapsed and their total.

    Raises:
        UsageError: there is no such process, or it belongs to another user.
    """
    begun, all_s = time.monotonic(), minutes * 60
    period_s = max(LEAST_PERIOD_S, all_s / SAMPLES_WATCHED)
    series, asked = Series(), []
    with interrupts(lambda: asked.append(True)):
        while not asked and (now_s := time.monotonic() - begun) <= all_s:
            held = holdings(pid)
            if held is None:
                break
            series.add(now_s, held)
            progress(int(now_s), int(all_s))
            time.sleep(min(period_s, max(0.0, all_s - now_s) + 1e-3))
    if not series.at:
        raise UsageError(f'--pid {pid}: no such process is running')
    return _found(
        series, Holdings._fields, SECOND, series.at[-1], begun,
        what=f'process {pid} and its descendants', interrupted=bool(asked),
    )


def _found(
    series: Series, names: tuple[str, ...], unit: str, amount: float, begun: float, **facts: Any
) -> Soak:
    if not series.at:
        raise UsageError('soak: stopped before the first run had ended')
    columns = dict(zip(names, zip(*series.rows, strict=True), strict=True))
    trends = {
        name: trend(
            series.at, columns[name], per_unit=_FLAT_SLOPES[unit].get(name, 0.0),
            once=_FLAT_GROWTH.get(name, 0.5),
        )
        for name in (*QUANTITIES, OBJECTS) if name in columns
    }
    return Soak(
        unit=unit, amount=amount, wall_s=time.monotonic() - begun, trends=trends,
        machine=machine_facts(), samples=len(series.at), **facts,
    )


def _scenario(rng: np.random.Generator, duration_s: float) -> Scenario:
    clouds = str(rng.choice(CLOUDS))
    rain = float(rng.uniform(0.25, 1.0)) if clouds in RAIN_CLOUDS and rng.random() < 0.5 else 0.0
    return Scenario(
        cross_track_m=float(rng.uniform(-8, 8)), distance_m=float(rng.uniform(0, 2000)),
        heading_rad=math.radians(float(rng.uniform(-30, 30))), clouds=clouds, rain_fraction=rain,
        time_of_day_s=float(rng.uniform(6, 18)) * 3600, duration_s=duration_s,
    )


MINUTES_WATCHED = 10.0
_NAMES = {
    'memory': 'resident memory', 'files': 'open files', 'threads': 'threads',
    'segments': 'shared-memory segments', OBJECTS: 'Python objects',
}


def show(found: Soak) -> None:
    """Print a table of the trends."""
    console = page_console()
    amount = f'{found.amount:.0f}' if found.unit == RUN else f'{found.amount:.0f} s of'
    took = f', {found.wall_s:.0f} s' if found.unit == RUN else ''
    console.print(f'{amount} {found.what}{took}, {found.samples} samples', soft_wrap=True)
    units, per = (100, 'per 100 runs') if found.unit == RUN else (3600, 'per hour')
    table = make_table(('',), ('first', 'warm', 'last', 'most', per, ''))
    for name, trend in found.trends.items():
        table.add_row(_NAMES[name], *_cells(name, trend, units))
    console.print(table)
    console.print(f'warm: after {WARM_UP:.0%} of it; the slope is from there on', style='dim')
    if found.interrupted:
        console.print('stopped early')
    console.print(f'verdict: {found.verdict}')


def _cells(name: str, trend: Trend, units: int) -> list[str]:
    levels = (trend.first, trend.warm, trend.last, trend.most)
    slope = trend.slope * units
    if name == 'memory':
        return [*(f'{level / 2**20:.1f} MB' for level in levels), f'{slope / 1024:+.1f} kB',
                trend.verdict]
    return [*(f'{level:,.0f}' for level in levels), f'{slope:+.2f}', trend.verdict]


def main(words: Sequence[str] | None = None) -> int:
    """Run the soak test and print the results.

    Returns:
        Exit code: 0, 1 if something grows, 130 after an interrupt.
    """
    parser = options(__doc__)
    parser.add_argument('--runs', type=count, help=f'number of runs (default {RUNS})')
    parser.add_argument('--duration', type=positive, metavar='S',
                        help=f'simulated length of each run (default {DURATION_S:g}) [s]')
    parser.add_argument('--minutes', type=positive, metavar='M',
                        help=f'limit of wall time (default {MINUTES_WATCHED:g} with --pid) [min]')
    parser.add_argument('--pid', type=count,
                        help='watch this process and its descendants instead')
    given = parser.parse_args(words)
    if given.pid is not None and (given.runs is not None or given.duration is not None):
        parser.error('--pid watches a running process; leave out --runs and --duration')
    with stage_bars(Console(stderr=given.json)) as bars:
        step = partial(bars, 'soaking')
        if given.pid is not None:
            found = watch(given.pid, given.minutes or MINUTES_WATCHED, step)
        else:
            found = soak_runs(given.runs or RUNS, given.minutes, step, given.duration or DURATION_S)
    print(json.dumps(found.report(), indent=2)) if given.json else show(found)
    if found.interrupted:
        return ExitCode.INTERRUPTED
    return ExitCode.VIOLATED if found.verdict == GROWS else ExitCode.OK


if __name__ == '__main__':
    leave(main)
