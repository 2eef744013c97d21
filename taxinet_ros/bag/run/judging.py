"""Evaluate any requirement on a recorded run.

Monitor, inputs and their order are the same as in the run, so the run's own formulas reproduce the
recorded robustness bit for bit.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence
from dataclasses import dataclass

from taxinet_ros.bag.run.samples import RecordedReading, RunSamples, same_bits
from taxinet_ros.core.control_step import max_gap_ns
from taxinet_ros.core.mtl import (
    Assumptions,
    Monitor,
    Reading,
    RobustnessInterval,
    Spec,
    signal_names,
)
from taxinet_ros.core.mtl.explain import Explanation, explain
from taxinet_ros.core.mtl.lint import check_windows
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError


class BagVerdict(enum.StrEnum):
    """Verdict of a requirement on a bag. Only SATISFIED is a success."""

    SATISFIED = 'SATISFIED'
    VIOLATED = 'VIOLATED'
    MARGINAL = 'MARGINAL'
    """Robustness zero, or at best zero; counts as a failure."""
    INCOMPLETE = 'INCOMPLETE'
    """The run ends early, or the bag is damaged: there is an interval but no verdict."""
    INVALID = 'INVALID'
    """A sample is not finite or is missing between others; the interval ends before it."""
    UNCLEAR = 'UNCLEAR'
    """The formula's windows contain no sample of this run, so nothing was evaluated."""

    @property
    def failed(self) -> bool:
        """Whether the run was judged and did not satisfy the requirement."""
        return self in (BagVerdict.VIOLATED, BagVerdict.MARGINAL)

    @property
    def judged(self) -> bool:
        """Whether there is a verdict."""
        return self.failed or self is BagVerdict.SATISFIED


@dataclass(frozen=True, kw_only=True)
class SpecVerdict:
    """Verdict of one requirement on one bag.

    Attributes:
        spec: the requirement.
        verdict: verdict on the bag.
        interval: robustness interval; exact if the run is complete.
        decided_s: time at which the sign of the robustness was decided [s], or None.
        recorded: the recorded interval for this formula, or None.
        same: whether it equals ``interval`` bit for bit; None if there is none, if other
            assumptions may change an undecided interval, or if a required topic is missing.
        breach_s: time at which a sample violated the assumptions [s], or None; from then on the
            interval is computed without them.
        why: reason for UNCLEAR in one line, or ''.
        explanation: which part of the formula and which sample decide, if that was asked for; None
            also without any sample.
    """

    spec: Spec
    verdict: BagVerdict
    interval: RobustnessInterval
    decided_s: float | None
    recorded: RobustnessInterval | None
    same: bool | None
    breach_s: float | None
    why: str = ''
    explanation: Explanation | None = None


def signals_of_specs(specs: Sequence[Spec]) -> set[str]:
    """Names of all signals that requirements read."""
    return {name for spec in specs for name in signal_names(spec.formula)}


def judge_spec(
    samples: RunSamples, spec: Spec, assumptions: Assumptions | None = None, *,
    explained: bool = False,
) -> tuple[SpecVerdict, list[Reading]]:
    """Judge a run by one requirement; return the verdict and the reading of each sample.

    ``assumptions``: None for the recorded ones.
    """
    vouched = samples.assumptions if assumptions is None else assumptions
    samples = samples.seen_by(spec)
    monitor = Monitor(
        spec, samples.duration_ns, vouched.bounds, vouched.rates,
        max_gap_ns=max_gap_ns(samples.period_ns),
    )
    readings = _readings(samples, monitor)
    alike = vouched == samples.assumptions or readings[-1].final
    verdict = _spec_verdict(samples, spec, readings, alike=alike)
    if explained and monitor.reading.samples:
        verdict = dataclasses.replace(verdict, explanation=explain(monitor))
    return verdict, readings


def _readings(samples: RunSamples, monitor: Monitor) -> list[Reading]:
    """Reading after each sample, as during the run; the initial reading if there are none.

    A formula holds at the first step. If that is lost, nothing is known, whatever came after it.
    """
    if samples.stamps_ns and samples.stamps_ns[0] > 0:
        return [monitor.reading] * len(samples.stamps_ns)
    pairs = zip(samples.stamps_ns, samples.samples, strict=True)
    return [monitor.push(stamp, sample) for stamp, sample in pairs] or [monitor.reading]


def _spec_verdict(
    samples: RunSamples, spec: Spec, readings: Sequence[Reading], *, alike: bool
) -> SpecVerdict:
    last = readings[-1]
    moments = list(zip(samples.stamps_ns, readings, strict=False))
    # A decision based on an assumption that was violated later does not count.
    decided = (
        stamp for stamp, reading in moments
        if reading.interval.decided and reading.trusted is last.trusted
    )
    broken = (stamp for stamp, reading in moments if not reading.trusted)
    recorded = samples.recorded.get(spec.text)
    why = _why_unclear(samples, spec)
    verdict = _verdict(samples, last)
    return SpecVerdict(
        spec=spec,
        verdict=BagVerdict.UNCLEAR if why and verdict.judged else verdict,
        why=why,
        interval=last.interval,
        decided_s=_seconds(next(decided, None)),
        breach_s=_seconds(next(broken, None)),
        recorded=None if recorded is None else recorded.interval,
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
    if samples.flaws or not (last.final or samples.stopped_early) or not last.interval.decided:
        return BagVerdict.INCOMPLETE
    if last.lower > 0:
        return BagVerdict.SATISFIED
    return BagVerdict.VIOLATED if last.upper < 0 else BagVerdict.MARGINAL


def _why_unclear(samples: RunSamples, spec: Spec) -> str:
    try:
        check_windows(spec, samples.duration_ns, samples.period_ns)
    except UsageError as error:
        return str(error)
    return ''


def _matches_recorded(
    samples: RunSamples, readings: Sequence[Reading], recorded: RecordedReading
) -> bool | None:
    if recorded.stamp_ns not in samples.stamps_ns:
        return None if samples.flaws else False
    here = readings[samples.stamps_ns.index(recorded.stamp_ns)]
    return same_bits(recorded.interval, here.interval)
