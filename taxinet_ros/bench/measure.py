"""Comparable time measurements: warmed up, repeated, with all subjects in turns.

A machine's speed drifts with its load and temperature. So the subjects take turns, and a drift
affects all of them. Results are medians and quartiles, since times have long tails; the minimum is
the time on an undisturbed machine. A report adds the facts of the machine.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from taxinet_ros.core.provenance import provenance

LOAD = 'load_average'
"""Fact that differs in every report."""


def machine_facts() -> dict[str, Any]:
    """Facts of the machine by name, for use after measuring: torch must be loaded by then."""
    torch = sys.modules.get('torch')
    return {
        **provenance(),
        'cores': os.cpu_count(),
        'cores_allowed': len(os.sched_getaffinity(0)),
        'system': f'{platform.system()} {platform.release()}',
        'opencv_threads': cv2.getNumThreads(),
        'torch_threads': torch.get_num_threads() if torch else None,
        LOAD: [round(load, 2) for load in os.getloadavg()],
    }


_QUARTILES = (0.25, 0.5, 0.75)

Clock = Callable[[], int]
"""Nanoseconds since an arbitrary moment."""
Progress = Callable[[int, int], None]
"""Called with the number of turns done and their total."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Subject:
    """A measured operation.

    Attributes:
        name: name of its figure, words separated by slashes.
        run: performs it once. It returns None, or the times of parts that it has measured itself
            [ns]; then each part has a figure, named after the subject and the part, and the whole
            has none.
        before: called before every run, unmeasured.
        calls: operations per call of ``run``; figures are per operation.
        warm_ups: unmeasured runs at the beginning.
        most: maximum number of runs, for operations that take seconds; None for no limit.
        simulated_s: simulated time that passes in one operation [s], if any.
        cpu: clock of the processor time [ns], if other processes work too.
    """

    name: str
    run: Callable[[], Mapping[str, int] | None]
    before: Callable[[], object] | None = None
    calls: int = 1
    warm_ups: int = 2
    most: int | None = None
    simulated_s: float | None = None
    cpu: Clock | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """Measurement of one subject, per operation.

    Attributes:
        median_s, q1_s, q3_s, min_s: wall time [s]: median, quartiles, minimum.
        cpu_s: median of the processor time of all threads [s]; None for parts.
        repeats: number of runs.
        real_time_factor: simulated time per median wall time, if time is simulated.
        cpu_q1_s, cpu_q3_s: quartiles of the processor time [s].
        real_time_per_core: simulated time per median processor time.
    """

    median_s: float
    q1_s: float
    q3_s: float
    min_s: float
    cpu_s: float | None
    repeats: int
    real_time_factor: float | None = None
    cpu_q1_s: float | None = None
    cpu_q3_s: float | None = None
    real_time_per_core: float | None = None


@dataclass
class _Samples:
    """Times of one figure, in nanoseconds."""

    subject: Subject
    wall: list[int] = field(default_factory=list)
    cpu: list[int] = field(default_factory=list)

    def figure(self) -> Figure:
        per_call, simulated = 1e9 * self.subject.calls, self.subject.simulated_s
        q1, median, q3 = (np.quantile(self.wall, _QUARTILES) / per_call).tolist()
        cpu = [None, None, None]
        if self.cpu:
            cpu = (np.quantile(self.cpu, _QUARTILES) / per_call).tolist()
        return Figure(
            median_s=median, q1_s=q1, q3_s=q3,
            min_s=min(self.wall) / per_call, repeats=len(self.wall),
            cpu_q1_s=cpu[0], cpu_s=cpu[1], cpu_q3_s=cpu[2],
            real_time_factor=simulated / median if simulated and median > 0 else None,
            real_time_per_core=simulated / cpu[1] if simulated and cpu[1] else None,
        )


def measure(
    subjects: Sequence[Subject],
    repeats: int,
    progress: Progress = lambda done, total: None,
    *,
    wall: Clock = time.perf_counter_ns,
    cpu: Clock = time.process_time_ns,
) -> dict[str, Figure]:
    """Measure all subjects in turns.

    Args:
        subjects: subjects with distinct names.
        repeats: turns, each with one run of every subject that has not reached its maximum.
        progress: called with the progress.
        wall: wall clock [ns].
        cpu: clock of the process's processor time [ns].

    Returns:
        Figures by name, in the order of the subjects and of their parts.
    """
    for subject in subjects:
        for _ in range(subject.warm_ups):
            subject.run()
    samples: dict[str, _Samples] = {}
    for turn in range(repeats):
        progress(turn, repeats)
        for subject in subjects:
            if subject.most is None or turn < subject.most:
                _take(subject, samples, wall, cpu)
    progress(repeats, repeats)
    return {name: taken.figure() for name, taken in samples.items()}


def _take(subject: Subject, samples: dict[str, _Samples], wall: Clock, cpu: Clock) -> None:
    """Run a subject once and store its times."""
    if subject.before is not None:
        subject.before()
    cpu = subject.cpu or cpu
    start_cpu, start = cpu(), wall()
    parts = subject.run()
    elapsed, elapsed_cpu = wall() - start, cpu() - start_cpu
    if parts is None:
        whole = samples.setdefault(subject.name, _Samples(subject))
        whole.wall.append(elapsed)
        whole.cpu.append(elapsed_cpu)
        return
    for part, taken in parts.items():
        samples.setdefault(f'{subject.name}/{part}', _Samples(subject)).wall.append(taken)
