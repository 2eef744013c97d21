"""Evaluation of formulas on a stretch of live time: the run of a monitor without explicit start.

A stretch begins with the first sample and ends at its horizon, if it has one. The state of each
formula is reported to an operator as a level and a line.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

from taxinet_ros.core.mtl import (
    NO_ASSUMPTIONS,
    Assumptions,
    Monitor,
    Reading,
    Spec,
    Verdict,
    signal_names,
)
from taxinet_ros.core.mtl.explain import explain
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.extras.live_monitor.sample_hold import Sample

_ENDLESS_NS = 2**62
"""Horizon used for an unlimited stretch [ns]: 146 years."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Standing:
    """State of one formula.

    Attributes:
        reading: its newest reading.
        decided: verdict reached while the stretch was valid, or UNKNOWN. It stays when the stretch
            becomes invalid later: no completion could have changed it.
        decided_s: time of that verdict since the start of the stretch [s], or -1.
        trouble: what made the stretch invalid for this formula, or ''.
        breach: how a sample violated the assumptions, or ''. An earlier verdict is then withdrawn,
            because it may depend on them.
        parts: robustness of each part of the formula at that verdict, one line each, with the
            predicate and the sample that decide.
    """

    reading: Reading
    decided: Verdict = Verdict.UNKNOWN
    decided_s: float = -1.0
    trouble: str = ''
    breach: str = ''
    parts: tuple[str, ...] = ()


class Stretch:
    """Monitors formulas on one stretch.

    Args:
        specs: the formulas.
        horizon_ns: length of the stretch [ns]; 0: unlimited, and a formula that only the end can
            decide stays undecided.
        max_gap_ns: longest time without a sample [ns]; 0: unlimited.
        assumptions: assumed bounds and rates of signals.
    """

    def __init__(
        self, specs: Sequence[Spec], *, horizon_ns: int = 0, max_gap_ns: int = 0,
        assumptions: Assumptions = NO_ASSUMPTIONS,
    ) -> None:
        self._horizon_ns = horizon_ns or _ENDLESS_NS
        self._max_gap_ns = max_gap_ns
        self._monitors = [
            self._monitor(spec, assumptions.about(signal_names(spec.formula))) for spec in specs
        ]
        self._start_ns: int | None = None
        self._newest_ns = 0
        self.standings = tuple(Standing(reading=each.reading) for each in self._monitors)

    def _monitor(self, spec: Spec, assumptions: Assumptions) -> Monitor:
        return Monitor(
            spec, self._horizon_ns, assumptions.bounds, assumptions.rates,
            max_gap_ns=self._max_gap_ns or None,
        )

    @property
    def begun(self) -> bool:
        """Whether the first sample has arrived."""
        return self._start_ns is not None

    @property
    def length_s(self) -> float:
        """Time from the first sample to the newest, at most the horizon [s]."""
        start_ns = self._start_ns if self._start_ns is not None else self._newest_ns
        return min(self._newest_ns - start_ns, self._horizon_ns) / NS_PER_S

    @property
    def ended(self) -> bool:
        """Whether the horizon is reached."""
        return self._start_ns is not None and (
            self._newest_ns - self._start_ns >= self._horizon_ns
        )

    def beyond(self, stamp_ns: int) -> bool:
        """Whether a sample at this time would be after the end of the stretch."""
        return self._start_ns is not None and stamp_ns - self._start_ns > self._horizon_ns

    def push(self, sample: Sample) -> list[bool]:
        """Process a sample; return for each formula whether its state has changed.

        State: verdict, validity, finality and trust of the reading.
        """
        if self._start_ns is None:
            self._start_ns = self._newest_ns = sample.stamp_ns
        before = self.standings
        self.standings = tuple(
            self._standing(monitor, old, sample)
            for monitor, old in zip(self._monitors, before, strict=True)
        )
        self._newest_ns = max(self._newest_ns, sample.stamp_ns)
        return [_face(a) != _face(b) for a, b in zip(before, self.standings, strict=True)]

    def _standing(self, monitor: Monitor, old: Standing, sample: Sample) -> Standing:
        assert self._start_ns is not None
        elapsed_ns = sample.stamp_ns - self._start_ns
        reading = monitor.push(elapsed_ns, sample.values)
        decided, decided_s, trouble = old.decided, old.decided_s, old.trouble
        parts = old.parts
        if monitor.breach and not old.breach:
            decided, decided_s, parts = Verdict.UNKNOWN, -1.0, ()
        if reading.verdict is not Verdict.UNKNOWN and decided is Verdict.UNKNOWN:
            decided, decided_s = reading.verdict, min(elapsed_ns, self._horizon_ns) / NS_PER_S
            parts = tuple(explain(monitor, over_time=False).lines())
        if not reading.valid and not trouble:
            trouble = f'at {elapsed_ns / NS_PER_S:g} s: {self._trouble(monitor.spec, sample)}'
        return Standing(
            reading=reading, decided=decided, decided_s=decided_s, trouble=trouble,
            breach=monitor.breach, parts=parts,
        )

    def _trouble(self, spec: Spec, sample: Sample) -> str:
        """Reason why the monitor rejected a sample or the stretch became invalid."""
        step_s = (sample.stamp_ns - self._newest_ns) / NS_PER_S
        if step_s < 0:
            return f'stamps went back by {-step_s:g} s'
        troubles = [sample.troubles[n] for n in signal_names(spec.formula) if n in sample.troubles]
        if troubles:
            return '; '.join(troubles)
        if self._max_gap_ns and step_s * NS_PER_S > self._max_gap_ns:
            return f'no sample for {step_s:g} s (max_age {self._max_gap_ns / NS_PER_S:g} s)'
        return 'a stamp came twice' if step_s == 0 else 'a predicate is not finite'


def _face(standing: Standing) -> tuple[Verdict, bool, bool, bool]:
    reading = standing.reading
    return reading.verdict, reading.valid, reading.final, reading.trusted


class Level(enum.IntEnum):
    """Severity of a formula's state; values as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


def standing_level(standing: Standing) -> Level:
    """Level of a state: ERROR if violated or invalid, else WARN, else OK.

    WARN: the robustness can be 0 at best, nothing was evaluated, or an assumption was violated.
    """
    reading = standing.reading
    if not reading.valid or standing.decided is Verdict.VIOLATED:
        return Level.ERROR
    at_best_marginal = reading.upper == 0 or standing.decided is Verdict.MARGINAL
    unclear = reading.final and standing.decided is Verdict.UNKNOWN
    return Level.WARN if at_best_marginal or unclear or standing.breach else Level.OK


def standing_line(standing: Standing) -> str:
    """State in words, e.g. ``violated at 3.2 s, rho within [-inf, -0.5]``."""
    words = _verdict(standing)
    if standing.reading.samples:
        words += f', {standing.reading.interval.words(".4g")}'
    if standing.reading.final:
        words += ' (final)'
    if standing.breach:
        words += f'; an assumption broke {standing.breach}'
    return f'not valid, {standing.trouble}; before that {words}' if standing.trouble else words


def _verdict(standing: Standing) -> str:
    if standing.decided is Verdict.UNKNOWN:
        return 'unclear, no sample in its windows' if standing.reading.final else 'open'
    return f'{standing.decided.name.lower()} at {standing.decided_s:g} s'
