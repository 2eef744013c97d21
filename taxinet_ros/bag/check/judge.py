"""Bags judged, all runs of each, by the requirements of then or by others.

Several processes may judge many bags; the result does not depend on their number.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

from taxinet_ros.bag.errors import BagError, BagForeign
from taxinet_ros.bag.limits import limited_reading
from taxinet_ros.bag.run.judging import SpecVerdict, judge_spec, signals_of_specs
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.samples import RunSamples, run_samples, topics_of_signals
from taxinet_ros.core.mtl import Assumptions, Spec, parse_spec
from taxinet_ros.core.mtl.specs import MOST_UNUSABLE_SHARE
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.processes.pool import process_pool


@dataclass(frozen=True, kw_only=True)
class JudgedBag:
    """A bag and what it says of some requirements.

    Attributes:
        path: as given.
        run: name of the run among others in the bag; '' where it is the only one.
        verdicts: one for each requirement, in order; none where nothing could be read.
        end_s: simulated time of the last sample [s], -1 without any.
        duration_s: how long the run was to last [s]; NaN where the bag does not tell.
        stopped_early: the run was ended on purpose, because its verdict was in.
        blind: number of frames without a usable estimate where they are more than the requirement
            ``usable`` allows, else 0; and ``frames`` of how many.
        trouble: one line on what of the bag is damaged or missing, or ''.
        note: one line on what else the recording tells of, or ''.
        timing: when answers took effect, likewise in words; '' where each did at once.
        foreign: it is no bag, or no run of this package.
    """

    path: Path
    run: str = ''
    verdicts: tuple[SpecVerdict, ...] = ()
    end_s: float = -1.0
    duration_s: float = math.nan
    stopped_early: bool = False
    blind: int = 0
    frames: int = 0
    trouble: str = ''
    note: str = ''
    timing: str = ''
    foreign: bool = False

    @property
    def name(self) -> str:
        """Name of the run, as far as its place tells."""
        place = self.path.stem if self.path.is_file() else self.path.name
        return f'{place} {self.run}' if self.run else place

    @property
    def sound(self) -> bool:
        """Whether every requirement has a verdict, and the same that was recorded, if any was."""
        return bool(self.verdicts) and all(
            one.verdict.judged and one.same is not False for one in self.verdicts
        )


def judge_runs(
    path: Path, specs: Sequence[Spec] = (), assumptions: Assumptions | None = None
) -> list[JudgedBag]:
    """Judge every run in a bag. Damage is reported in the result, not raised.

    Args:
        path: a bag's folder or an ``.mcap`` file.
        specs: requirements; empty: each run's own.
        assumptions: assumptions; None: the recorded ones.

    Raises:
        UsageError: there is nothing at ``path``.
    """
    try:
        with limited_reading(path):
            names = signals_of_specs(specs) if specs else None
            runs = run_samples(open_recording(path), names)
    except BagError as error:
        return [JudgedBag(path=path, trouble=str(error), foreign=isinstance(error, BagForeign))]
    return [_judge_run(path, samples, specs, assumptions) for samples in runs]


def _judge_run(
    path: Path, samples: RunSamples, specs: Sequence[Spec], assumptions: Assumptions | None
) -> JudgedBag:
    if not samples.duration_ns and samples.trouble:
        return JudgedBag(path=path, run=samples.run, trouble=samples.trouble)
    chosen = specs or [parse_spec(text) for text in samples.specs]
    needed = topics_of_signals(signals_of_specs(chosen))
    flaws = '; '.join(line for topic, line in samples.flaws.items() if topic in needed)
    unusable = samples.unusable_estimates
    return JudgedBag(
        path=path, run=samples.run,
        verdicts=tuple(judge_spec(samples, spec, assumptions)[0] for spec in chosen),
        end_s=samples.stamps_ns[-1] / NS_PER_S if samples.stamps_ns else -1.0,
        duration_s=samples.duration_ns / NS_PER_S,
        stopped_early=samples.stopped_early,
        blind=unusable if unusable > MOST_UNUSABLE_SHARE * len(samples.stamps_ns) else 0,
        frames=len(samples.stamps_ns),
        trouble=samples.trouble or flaws,
        note=samples.note, timing=samples.timing,
    )


_CHUNK = 8
"""Bags handed to a process at a time; fewer than two chunks are not worth starting one."""


def judge_bags(
    paths: Sequence[Path], specs: Sequence[Spec], workers: int,
    assumptions: Assumptions | None = None,
) -> Iterator[JudgedBag]:
    """Judge bags, see :func:`judge_runs`, all runs of each, in their paths' order.

    Args:
        paths: run folders or ``.mcap`` files.
        specs: requirements; empty: each run's own.
        workers: processes to do it in; 1 is this one.
        assumptions: assumptions; None: the recorded ones.

    Raises:
        UsageError: there is nothing at a path.
        InfraError: a worker process died.
    """
    if workers == 1 or len(paths) < 2 * _CHUNK:
        for path in paths:
            yield from judge_runs(path, specs, assumptions)
        return
    with process_pool(workers, 'judging worker') as pool:
        for runs in pool.map(
            judge_runs, paths, repeat(tuple(specs)), repeat(assumptions), chunksize=_CHUNK
        ):
            yield from runs
