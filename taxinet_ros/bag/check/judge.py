"""Judge all runs of bags by their recorded requirements or by others.

Bags may be judged in several processes; the result does not depend on their number.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

from taxinet_ros.bag.errors import BagError, BagForeign
from taxinet_ros.bag.run.judging import SpecVerdict, judge_spec, signals_of_specs
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.samples import RunSamples, run_samples, topics_of_signals
from taxinet_ros.core.mtl import Assumptions, Spec, parse_spec
from taxinet_ros.core.mtl.specs import MOST_UNUSABLE_SHARE
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.processes.pool import process_pool


@dataclass(frozen=True, kw_only=True)
class JudgedBag:
    """Verdicts of requirements on one run of a bag.

    Attributes:
        path: as given.
        run: name of the run if the bag has several, else ''.
        verdicts: one per requirement, in order; empty if nothing could be read.
        end_s: simulated time of the last sample [s]; -1 without samples.
        duration_s: requested length of the run [s]; NaN if unknown.
        stopped_early: the run was stopped early because its verdict was decided.
        blind: number of frames without a usable estimate if more than the requirement ``usable``
            allows, else 0.
        frames: number of all frames.
        trouble: one line about damaged or missing data, or ''.
        note: one line about other content of the recording, or ''.
        timing: timing of the answers in words; '' for immediate answers.
        foreign: not a bag, or not a run of this package.
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
        """Display name of the run, from its path."""
        place = self.path.stem if self.path.is_file() else self.path.name
        return f'{place} {self.run}' if self.run else place

    @property
    def sound(self) -> bool:
        """Whether every requirement has a verdict that matches the recorded one, if any."""
        return bool(self.verdicts) and all(
            one.verdict.judged and one.same is not False for one in self.verdicts
        )


def judge_runs(
    path: Path, specs: Sequence[Spec] = (), assumptions: Assumptions | None = None,
    explained: bool = False,
) -> list[JudgedBag]:
    """Judge every run in a bag. Damage is reported in the result, not raised.

    Args:
        path: a bag's folder or an ``.mcap`` file.
        specs: requirements; empty: each run's own.
        assumptions: assumptions; None: the recorded ones.
        explained: whether to say which part of a formula and which sample decide.
    """
    try:
        names = signals_of_specs(specs) if specs else None
        runs = run_samples(open_recording(path), names)
    except BagError as error:
        return [JudgedBag(path=path, trouble=str(error), foreign=isinstance(error, BagForeign))]
    return [_judge_run(path, samples, specs, assumptions, explained) for samples in runs]


def _judge_run(
    path: Path, samples: RunSamples, specs: Sequence[Spec], assumptions: Assumptions | None,
    explained: bool,
) -> JudgedBag:
    if not samples.duration_ns and samples.trouble:
        return JudgedBag(path=path, run=samples.run, trouble=samples.trouble)
    chosen = specs or [parse_spec(text) for text in samples.specs]
    needed = topics_of_signals(signals_of_specs(chosen))
    flaws = '; '.join(line for topic, line in samples.flaws.items() if topic in needed)
    unusable = samples.unusable_estimates
    return JudgedBag(
        path=path, run=samples.run,
        verdicts=tuple(
            judge_spec(samples, spec, assumptions, explained=explained)[0] for spec in chosen
        ),
        end_s=samples.stamps_ns[-1] / NS_PER_S if samples.stamps_ns else -1.0,
        duration_s=samples.duration_ns / NS_PER_S,
        stopped_early=samples.stopped_early,
        blind=unusable if unusable > MOST_UNUSABLE_SHARE * len(samples.stamps_ns) else 0,
        frames=len(samples.stamps_ns),
        trouble=samples.trouble or flaws,
        note=samples.note, timing=samples.timing,
    )


_CHUNK = 8
"""Number of bags per task; with fewer than two tasks no process is started."""


def judge_bags(
    paths: Sequence[Path], specs: Sequence[Spec], workers: int,
    assumptions: Assumptions | None = None, *, explained: bool = False,
) -> Iterator[JudgedBag]:
    """Judge all runs of several bags, in the order of the paths; see :func:`judge_runs`."""
    if workers == 1 or len(paths) < 2 * _CHUNK:
        for path in paths:
            yield from judge_runs(path, specs, assumptions, explained)
        return
    with process_pool(workers, 'judging worker') as pool:
        for runs in pool.map(
            judge_runs, paths, repeat(tuple(specs)), repeat(assumptions), repeat(explained),
            chunksize=_CHUNK,
        ):
            yield from runs
