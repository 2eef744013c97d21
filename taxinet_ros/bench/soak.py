"""Soak test: many runs, or a running process, sampled for what grows.

A sample counts memory, open files, threads and shared memory of a process and its descendants; a
robust slope through the samples after the warm-up tells whether one of them grows.
"""

from __future__ import annotations

import gc
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import psutil
from scipy import stats

from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.core.judging import Judging
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.outcome import RunRequest, RunResult
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.processes.interrupts import interrupts

_SHARED = '/dev/shm/'


class Holdings(NamedTuple):
    """What one process, or several together, hold.

    Attributes:
        memory: resident memory [bytes]; what processes share counts in each of them.
        files: open file descriptors.
        threads: threads.
        segments: different files of ``/dev/shm`` mapped into memory; Fast DDS talks through them.
        processes: how many they are.
    """

    memory: int
    files: int
    threads: int
    segments: int
    processes: int


def holdings(pid: int) -> Holdings | None:
    """What a process and all its descendants hold now; None once it is gone.

    Raises:
        UsageError: it is another user's, so Linux does not tell.
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
"""Share of the runs, or of the time, at the beginning that do not count: caches fill there."""
LEAST_SAMPLES = 12
"""Samples after the warm-up without which nothing is concluded."""
MOST_SAMPLES = 400
"""Samples that are kept; beyond them every other one goes, so that looking costs nothing more."""
FLAT, GROWS, UNSETTLED = 'flat', 'grows', 'too short to tell'


@dataclass(frozen=True, kw_only=True)
class Trend:
    """How one quantity went.

    Attributes:
        first, warm, last, most: at the beginning, after the warm-up, at the end, and at most.
        slope: after the warm-up, per run or per second.
        growth: by this slope, from the warm-up to the end.
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
    """Samples along an axis, evenly thinned out so that there are never very many."""

    def __init__(self) -> None:
        """Begin without samples."""
        self.at: list[float] = []
        self.rows: list[tuple[float, ...]] = []
        self._every = 1
        self._asked = 0

    def add(self, at: float, row: Sequence[float]) -> None:
        """Take a sample, unless it would be one of those that are thinned out."""
        if self._asked % self._every == 0:
            self.at.append(at)
            self.rows.append(tuple(row))
        self._asked += 1
        if len(self.at) > MOST_SAMPLES:
            self.at, self.rows = self.at[::2], self.rows[::2]
            self._every *= 2


def trend(at: Sequence[float], values: Sequence[float], *, per_unit: float, once: float) -> Trend:
    """The trend of one quantity.

    Args:
        at: runs or seconds, ascending, one or more.
        values: as many.
        per_unit: slope that still counts as flat.
        once: growth that still counts as flat, however steep.
    """
    x, y = np.asarray(at, float), np.asarray(values, float)
    warm = x >= x[0] + WARM_UP * (x[-1] - x[0])
    x, y = x[warm], y[warm]
    # Theil's and Sen's: the median slope between pairs of points, which a few outliers do not move.
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
"""Simulated length of a run [s]: short, for what leaks leaks by the run or by the step."""
SEED = 0
RUNS_PER_SAMPLE = 5
LEAST_PERIOD_S = 1.0
SAMPLES_WATCHED = 300
RUN, SECOND = 'run', 's'
"""What samples are counted in: runs of our own, or seconds of somebody else's."""
OBJECTS = 'python objects'
QUANTITIES = ('memory', 'files', 'threads', 'segments')
_FLAT_SLOPES = {
    RUN: {'memory': 1024.0, OBJECTS: 0.1},
    SECOND: {'memory': 10 * 2**20 / 3600},
}
"""Slopes that still count as flat; of what is counted by the piece, none does."""
_FLAT_GROWTH = {'memory': 2.0**20, OBJECTS: 500.0}
"""Growth that still counts as flat; of what is counted by the piece, less than half of one."""
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Soak:
    """What a soak has found.

    Attributes:
        what: what was soaked, in words.
        unit: :data:`RUN` or :data:`SECOND`.
        amount: how many of them there were.
        wall_s: how long it took [s].
        trends: by quantity: those of :class:`.Holdings`, and Python objects of a soak of our own.
        machine: facts on it.
        outcomes: runs of our own by how they ended.
        interrupted: whether somebody stopped it early.
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
        """``grows`` where anything does, ``flat`` where all is, else ``too short to tell``."""
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

    OpenCV keeps to one thread from here on, for all of the process.

    Args:
        runs: how many.
        minutes: of wall time after which it ends all the same.
        progress: is told how many are done, and of how many.
        duration_s: simulated length of each.

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
    """The runs of a soak, and what is seen between them."""

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
        """End with the run at hand."""
        self._stopped = True
        self.interrupt()

    def requests(self) -> Iterator[RunRequest]:
        """Scenes of S_falsif's world, drawn one by one."""
        rng = np.random.default_rng(SEED)
        for number in range(self._runs):
            yield RunRequest(
                run_id=f'soak-{number}', index=number, program='', seed=SEED,
                scenario=_scenario(rng, self._duration_s), participants=PARTICIPANTS,
                judging=Judging(specs=(SHIPPED['phi_eventually'].text,)),
            )

    def take(self, request: RunRequest, result: RunResult) -> bool:
        """Look at this process every few runs; False ends the soak."""
        shutil.rmtree(self.bags / request.run_id, ignore_errors=True)
        if self._stopped:
            return False
        if not result.outcome.judged:
            raise InfraError(result.kind, result.who, result.last_seq, result.detail)
        self._outcomes[result.outcome] = self._outcomes.get(result.outcome, 0) + 1
        self._done += 1
        if self._done % RUNS_PER_SAMPLE == 1:
            gc.collect()  # so that what is counted is what cannot be freed
            held = holdings(os.getpid())
            assert held is not None
            self._series.add(self._done, (*held, len(gc.get_objects())))
        self._progress(self._done, self._runs)
        return time.monotonic() - self._begun < self._most_s

    def found(self) -> Soak:
        """The soak so far.

        Raises:
            UsageError: it was stopped before its first run had ended.
        """
        return _found(
            self._series, (*Holdings._fields, OBJECTS), RUN, self._done, self._begun,
            what=f'runs of {self._duration_s:g} s with the shipped network in one process',
            outcomes=dict(self._outcomes), interrupted=self._stopped,
        )


def watch(pid: int, minutes: float, progress: Progress) -> Soak:
    """Look at a running process and its descendants until the time is over, or it is gone.

    Args:
        pid: of the process.
        minutes: how long.
        progress: is told how many seconds are over, and of how many.

    Raises:
        UsageError: there is no such process, or it is another user's.
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
