"""Recorded runs judged once more, or by a requirement that nobody had thought of when they ran.

The monitor, its inputs and their order are those of the run, so a formula that judged the run
gets the recorded robustness to the last bit. Many bags are judged by several processes; how
many does not show in the result.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

from taxinet_ros.bag.errors import BagError, BagForeign
from taxinet_ros.bag.limits import limited_reading
from taxinet_ros.bag.run.samples import (
    RecordedInterval,
    RunSamples,
    read_run_samples,
    same_bits,
    topics_of_signals,
)
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.loop import MAX_GAP_NS
from taxinet_ros.core.mtl import Assumptions, Monitor, Reading, Spec, parse_spec, signal_names
from taxinet_ros.core.mtl.lint import check_windows
from taxinet_ros.core.mtl.specs import MOST_UNUSABLE_SHARE
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.processes.pool import process_pool


class BagVerdict(enum.StrEnum):
    """What a bag says of a requirement. Only SATISFIED is a success."""

    SATISFIED = 'SATISFIED'
    VIOLATED = 'VIOLATED'
    MARGINAL = 'MARGINAL'
    """Robustness zero, or zero at best; counts as a failure."""
    INCOMPLETE = 'INCOMPLETE'
    """The run ends early, or the bag is damaged: there is an interval, and no verdict."""
    INVALID = 'INVALID'
    """A sample was not finite, or one is missing amid the others; the interval ends before it."""
    UNCLEAR = 'UNCLEAR'
    """The formula's windows hold no sample of this run, so nothing was judged."""

    @property
    def failed(self) -> bool:
        """Whether the run was judged and has not satisfied the requirement."""
        return self in (BagVerdict.VIOLATED, BagVerdict.MARGINAL)

    @property
    def judged(self) -> bool:
        """Whether there is a verdict at all."""
        return self.failed or self is BagVerdict.SATISFIED


@dataclass(frozen=True, kw_only=True)
class SpecVerdict:
    """One requirement, put to one bag.

    Attributes:
        spec: the requirement.
        verdict: what the bag says of it.
        lower, upper: ends of the robust satisfaction interval; both rho where the run was whole.
        decided_s: first moment from which zero is out of the interval [s], or None.
        recorded: ends of the interval that the bag itself has for this formula, or None.
        same: whether that is the interval found here, to the last bit; None where it has none, or
            where other assumptions make an interval that is still open another one, or a topic
            that it reads is missing.
        breach_s: when a sample broke what is vouched for [s], or None; from then on the interval
            is that without assumptions.
        why: why the verdict is UNCLEAR, in a line, or ''.
    """

    spec: Spec
    verdict: BagVerdict
    lower: float
    upper: float
    decided_s: float | None
    recorded: tuple[float, float] | None
    same: bool | None
    breach_s: float | None
    why: str = ''


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
    """Judge every run in a bag. What is wrong with it is told in the result, not raised.

    Args:
        path: a bag's folder or an ``.mcap`` file.
        specs: requirements; where empty, those that judged each run.
        assumptions: what is vouched for; where None, what was then.

    Raises:
        UsageError: there is nothing at ``path``.
    """
    try:
        with limited_reading(path):
            runs = read_run_samples(path, signals_of_specs(specs) if specs else None)
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


def signals_of_specs(specs: Sequence[Spec]) -> set[str]:
    """Names of all signals that some requirements read."""
    return {name for spec in specs for name in signal_names(spec.formula)}


def judge_spec(
    samples: RunSamples, spec: Spec, assumptions: Assumptions | None = None
) -> tuple[SpecVerdict, list[Reading]]:
    """What a run says of one requirement, and the readings on the way there.

    Args:
        samples: the run's.
        spec: the requirement.
        assumptions: what is vouched for; where None, what was then.

    Raises:
        UsageError: the run was to last no time at all.
    """
    vouched = samples.assumptions if assumptions is None else assumptions
    samples = samples.seen_by(spec)
    readings = _readings_of(samples, spec, vouched)
    alike = vouched == samples.assumptions or readings[-1].final
    return _spec_verdict(samples, spec, readings, alike=alike), readings


def _readings_of(samples: RunSamples, spec: Spec, vouched: Assumptions) -> list[Reading]:
    """The reading after each sample, as during the run; one that knows nothing if there is none."""
    monitor = Monitor(
        spec, samples.duration_ns, vouched.bounds, vouched.rates, max_gap_ns=MAX_GAP_NS
    )
    pairs = zip(samples.stamps_ns, samples.samples, strict=True)
    return [monitor.push(stamp, sample) for stamp, sample in pairs] or [monitor.reading]


def _spec_verdict(
    samples: RunSamples, spec: Spec, readings: Sequence[Reading], *, alike: bool
) -> SpecVerdict:
    last = readings[-1]
    moments = list(zip(samples.stamps_ns, readings, strict=False))
    # What was decided on an assumption that broke later, was not.
    decided = (
        stamp for stamp, reading in moments
        if _decided(reading) and reading.trusted is last.trusted
    )
    broken = (stamp for stamp, reading in moments if not reading.trusted)
    recorded = samples.recorded.get(spec.text)
    why = _why_unclear(samples, spec)
    verdict = _verdict(samples, last)
    return SpecVerdict(
        spec=spec,
        verdict=BagVerdict.UNCLEAR if why and verdict.judged else verdict,
        why=why,
        lower=last.lower,
        upper=last.upper,
        decided_s=_seconds(next(decided, None)),
        breach_s=_seconds(next(broken, None)),
        recorded=None if recorded is None else (recorded.lower, recorded.upper),
        same=_matches_recorded(samples, readings, recorded)
        if recorded is not None and alike
        else None,
    )


def _seconds(stamp_ns: int | None) -> float | None:
    return None if stamp_ns is None else stamp_ns / NS_PER_S


def _verdict(samples: RunSamples, last: Reading) -> BagVerdict:
    if samples.trouble:
        return BagVerdict.INCOMPLETE
    if not last.valid:
        return BagVerdict.INVALID
    if samples.flaws or not (last.final or samples.stopped_early) or not _decided(last):
        return BagVerdict.INCOMPLETE
    if last.lower > 0:
        return BagVerdict.SATISFIED
    return BagVerdict.VIOLATED if last.upper < 0 else BagVerdict.MARGINAL


def _why_unclear(samples: RunSamples, spec: Spec) -> str:
    try:
        check_windows(spec, samples.duration_ns, CONTROL_PERIOD_NS)
    except UsageError as error:
        return str(error)
    return ''


def _decided(reading: Reading) -> bool:
    return reading.lower > 0 or reading.upper <= 0


def _matches_recorded(
    samples: RunSamples, readings: Sequence[Reading], recorded: RecordedInterval
) -> bool | None:
    if recorded.stamp_ns not in samples.stamps_ns:
        return None if samples.flaws else False
    here = readings[samples.stamps_ns.index(recorded.stamp_ns)]
    return same_bits((recorded.lower, recorded.upper), (here.lower, here.upper))


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
    with process_pool(workers, 'judging worker') as pool:
        for runs in pool.map(
            judge_runs, paths, repeat(tuple(specs)), repeat(assumptions), chunksize=_CHUNK
        ):
            yield from runs
