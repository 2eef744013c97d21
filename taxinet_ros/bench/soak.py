"""A soak: very many runs in one process, or a process that works elsewhere, watched for growth.

A leak of a kilobyte a run is nothing to a test and a gigabyte to a campaign of a million runs.
"""

from __future__ import annotations

import gc
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from taxinet_ros.bench.machine import machine_facts
from taxinet_ros.bench.soak_sample import Holdings, holdings
from taxinet_ros.bench.soak_trend import FLAT, GROWS, Series, Trend, trend
from taxinet_ros.campaign.interrupts import interrupts
from taxinet_ros.core.errors import InfraError, UsageError
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.outcome import RunRequest, RunResult
from taxinet_ros.core.scenario import CLOUDS, RAIN_CLOUDS, Scenario
from taxinet_ros.nodes.graph import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS

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
                specs=(SHIPPED['phi_eventually'].text,),
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
        heading_rad=math.radians(float(rng.uniform(-30, 30))), clouds=clouds, rain=rain,
        time_of_day_s=float(rng.uniform(6, 18)) * 3600, duration_s=duration_s,
    )
